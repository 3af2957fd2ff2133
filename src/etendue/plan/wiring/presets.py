"""Presets as an axis: many shared quantities that change together.

In:  ``[sweep] PRESET = ["NAME", { PRESET = "NAME", label = "TEXT", QUANTITY = "4 um" }]``, the shared quantities of the
     stages.
Out: the axis: for each of its presets, a value of every quantity that any installed preset gives.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import TYPE_CHECKING, Any

from etendue.contract.values import quantities
from etendue.contract.values.parameter import MISSING
from etendue.contract.values.tables import Table
from etendue.contract.values.units import as_written
from etendue.errors import Fault, RequestError, nearest
from etendue.pipeline.presets import is_file, preset, preset_at, preset_names
from etendue.plan.model import Axis
from etendue.plan.wiring.parameters import Unfit, resolve
from etendue.plan.wiring.request import Request
from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    from etendue.plan.wiring.quantities import Declared


def preset_axes(request: Request, declared: Mapping[str, Declared]) -> dict[str, Axis]:
    """Return the axes whose values are presets, by the key of the preset. Presets with a fault are left out and
    reported.

    A value's own table overrides the pipeline's shared quantities, which override the named preset. A quantity with its
    own axis is set by that axis. The axis of presets covers every quantity that any installed preset gives, even if the
    presets on this axis agree on it. More presets can therefore be added to an archive later without changing which
    quantities the axis sets.
    """
    found = {kind.preset: _axis(request, declared, kind) for kind in request.pipeline.table.kinds()}
    axes = {word: axis for word, axis in found.items() if axis is not None}
    for first, second in combinations(axes.values(), 2):
        if both := sorted(first.gives.keys() & second.gives.keys()):
            request.fault(
                f"sweep.{second.key}",
                f"the axes {first.key} and {second.key} both give {', '.join(both[:3])}; sweep only one of them",
            )
    return axes


def _axis(request: Request, declared: Mapping[str, Declared], whose: Table) -> Axis | None:
    """Return the axis of one kind of presets; None if it is not swept, or a fault is reported."""
    word = whose.preset
    place, words = f"sweep.{word}", (word, "label")  # keys in the table of a value that are not quantities
    written = request.pipeline.sweep.get(word)
    if written is None:
        return None
    if not isinstance(written, list | tuple) or not written:
        request.fault(place, f"expected a list of {word}s, got {as_written(written)}")
        return None
    before = len(request.faults)
    tables = _tables(request, written, word)
    own = {name for table in tables.values() for name in table if name not in words}
    for name in sorted(own - {*declared, *quantities.names()}):
        request.fault(
            place, f"unknown {whose.name} quantity {name!r}{nearest(name, [*words, *declared, *quantities.names()])}"
        )
    named = _named(request, tables, whose)
    if named is None:
        return None
    taken = [name for name in declared if name in own or (name in named and name not in request.pipeline.shared)]
    taken = [name for name in taken if name not in request.pipeline.sweep]
    stated = _values(request, tables, whose)
    gives = {name: _column(request, name, declared[name], tables, whose, stated) for name in taken}
    for name in sorted(named & declared.keys() & request.pipeline.shared.keys() - own):
        request.warnings.append(f"{whose.place(name)} overrides every {word} of the sweep")
    return None if len(request.faults) > before else Axis(word, word, tuple(tables), "", gives)


def _named(request: Request, tables: Mapping[str, DocumentView], whose: Table) -> set[str] | None:
    """Return the quantities that installed presets give, and the files named here; None if a file is faulty."""
    word = whose.preset
    named = {name for known in preset_names(whose) for name in _stated(known, whose)}
    for table in tables.values():
        if word in table and (whose.find or is_file(str(table[word]))):
            try:
                named |= preset_at(str(table[word]), whose, request.pipeline.folder).values().keys()
            except RequestError as error:
                request.faults += [Fault(f"sweep.{word}", fault.message) for fault in error.faults]
                return None
    return named


def _tables(request: Request, written: Iterable[str], word: str) -> dict[str, DocumentView]:
    """Return the table of each value of the axis, by its label."""
    place, tables = f"sweep.{word}", dict[str, DocumentView]()
    for one in written:
        table = {word: one} if isinstance(one, str) else one
        if not isinstance(table, Mapping) or not (
            isinstance(table.get(word), str) or isinstance(table.get("label"), str)
        ):
            request.fault(
                place, f"expected a {word} name, or a table with '{word}', 'label' or both, got {as_written(one)}"
            )
            continue
        label = str(table.get("label", table.get(word)))
        if request.takes_label(place, label, tables):
            tables[label] = table
    return tables


def _stated(name: str, whose: Table) -> DocumentView:
    """Return the quantities of an installed preset; none if it cannot be read, which is reported where the preset is
    named.
    """
    try:
        return preset(name, whose).values()
    except RequestError:
        return {}


def _values(request: Request, tables: Mapping[str, DocumentView], whose: Table) -> dict[str, DocumentView]:
    """Return the values of every preset on an axis, by label; a preset that cannot be read is reported."""
    found = dict[str, DocumentView]()
    for label, table in tables.items():
        try:
            named = str(table.get(whose.preset, ""))
            found[label] = preset_at(named, whose, request.pipeline.folder).values() if named else {}
        except RequestError as error:
            for fault in error.faults:
                if fault.message not in [known.message for known in request.faults]:
                    request.fault(f"sweep.{whose.preset}", fault.message)
    return found


def _column(
    request: Request,
    name: str,
    one: Declared,
    tables: Mapping[str, DocumentView],
    whose: Table,
    stated: Mapping[str, DocumentView],
) -> tuple[Any, ...]:
    """Return the values of one quantity along the axis."""
    place = f"sweep.{whose.preset}"
    found = []
    for label, table in tables.items():
        if label not in stated:
            continue
        try:
            written = {**stated[label], **request.pipeline.shared, **table}
            value = one.default
            if name in written:
                value = resolve(written[name], one.parameter, one.kind, request.pipeline.folder)
        except Unfit as error:
            request.fault(place, f"{label}: {name}: {error}")
            continue
        if value is MISSING:
            request.fault(
                place,
                f"{label} gives no {name}, which {one.use} needs; give it in its table or under [{whose.name}]",
            )
        found.append(value)
    return tuple(found)
