"""The stages that can be used at one place of a pipeline, with their parameters: one stage, or several if ``.use`` is
swept.

In:  a stage's entry, its sweep, the registry.
Out: classes with resolved values, and the axis that chooses among them.
"""

from __future__ import annotations

from collections.abc import Mapping

from etendue.contract.capabilities import is_transfer
from etendue.contract.stage import Stage, parameters_of, writes_of
from etendue.contract.values import quantities
from etendue.contract.values.parameter import MISSING, Parameter
from etendue.contract.values.units import as_written
from etendue.errors import PluginError, nearest
from etendue.pipeline.file import StageEntry
from etendue.plan.identity.code import code_digest
from etendue.plan.model import Alternative, Axis
from etendue.plan.wiring.parameters import Unfit, expected, resolve
from etendue.plan.wiring.request import Request
from etendue.types.documents import Document, DocumentView

Entries = Mapping[str, tuple[Alternative, ...]]  # by name of the stage


def alternatives_of(request: Request, entry: StageEntry) -> tuple[tuple[Alternative, ...], Axis | None]:
    """Return the alternatives at an entry, () if none is valid, and the axis of its ``.use`` if that is swept."""
    key = f"{entry.name}.use"
    if key not in request.pipeline.sweep:
        one = _alternative(request, entry.name, entry.use, entry.use, entry.values, entry.place)
        return ((one,) if one else ()), None
    place = f"sweep.{key}"
    values = request.pipeline.sweep[key]
    if entry.use not in request.registry:
        request.fault(entry.place, _no_stage(request, entry.use))
    if not isinstance(values, list | tuple) or not values:
        request.fault(place, f"expected a list of stages, got {as_written(values)}")
        return (), None
    made, labels = list[Alternative](), list[str]()
    for value in values:
        table = {"use": value} if isinstance(value, str) else value
        if not isinstance(table, dict) or not isinstance(table.get("use"), str):
            request.fault(place, f"expected the name of a stage or a table with 'use', got {as_written(value)}")
            continue
        label = str(table.get("label", table["use"]))
        own = {k: v for k, v in table.items() if k not in ("use", "label")}
        if not request.takes_label(place, label, labels):
            continue
        labels.append(label)
        # Parameters in the table of the stage belong to the stage that its 'use' names.
        shared = entry.values if table["use"] == entry.use else {}
        one = _alternative(request, entry.name, table["use"], label, {**shared, **own}, place)
        if one:
            made.append(one)
    for other in made[1:]:
        for text in unlike((other.use, other.kind), (made[0].use, made[0].kind)):
            request.fault(place, text)
    return tuple(made), Axis(key, entry.name, tuple(labels))


def meaning(parameter: Parameter) -> str:
    """Describe the value that is missing: meaning, unit, range."""
    return f"{parameter.doc}{expected(parameter)}".removeprefix(", ").strip() or "it has no default"


def _alternative(
    request: Request, stage: str, use: str, label: str, written: DocumentView, place: str
) -> Alternative | None:
    kind = _load(request, use, place)
    if kind is None:
        return None
    declared = parameters_of(kind)
    own = [name for name, (parameter, _, _) in declared.items() if not parameter.shared]
    values: Document = {}
    for name, value in written.items():
        if name not in own:
            request.fault(f"{place}.{name}", _no_parameter(request, use, name, name in declared, own))
            continue
        parameter, type_, default = declared[name]
        try:
            values[name] = resolve(value, parameter, type_, request.pipeline.folder)
            if parameter.file and values[name] == "" and default is MISSING:
                raise Unfit("expected the path of a file, got ''")
        except Unfit as error:
            request.fault(f"{place}.{name}", str(error))
            values[name] = None
    swept = {key.partition(".")[2] for key in request.pipeline.sweep if key.partition(".")[0] == stage}
    for name in own:
        parameter, _, default = declared[name]
        if name not in values and name not in swept and default is MISSING:
            way = f"; --set {stage}.{name}=..." if f"{stage}.use" in dict(request.pipeline.overrides) else ""
            request.fault(place, f"{use} needs {name!r}: {meaning(parameter)}{way}")
        values.setdefault(name, None if default is MISSING else default)
    installed = request.registry.installed(use)
    try:
        code = code_digest(kind)
    except OSError as error:
        request.fault(
            place, f"{use} of {installed.origin}: its code cannot be read: {error.strerror or type(error).__name__}"
        )
        return None
    return Alternative(use, label, kind, values, installed.distribution, installed.version, code, frozenset(written))


def _no_parameter(request: Request, use: str, name: str, shared: bool, own: list[str]) -> str:
    """Return the reason why a stage does not accept a parameter of this name. ``shared``: the name is a shared quantity
    of the stage.
    """
    table = request.pipeline.table
    if shared:
        return f"{name} is shared by several stages; set it under [{table.name}], or by --set {table.place(name)}=VALUE"
    if name in quantities.names():
        hint = f"; {name} is a {table.name} quantity, set under [{table.name}]"
    else:
        hint = nearest(name, own) or ("; see: etendue stages " + use if own else "; it has no parameters")
    return f"{use} has no parameter {name!r}{hint}"


def _load(request: Request, use: str, place: str) -> type[Stage] | None:
    if use not in request.registry:
        request.fault(place, _no_stage(request, use))
        return None
    try:
        return request.registry.load(use)
    except PluginError as error:
        request.fault(place, str(error))
        return None


def _no_stage(request: Request, use: str) -> str:
    names = request.registry.names()
    hint = nearest(use, names) or f"; to list the {len(names)} installed stages, run: etendue stages"
    return f"unknown stage {use!r}{hint}{request.registry.found.missed('stages', use)}"


def unlike(*both: tuple[str, type[Stage]]) -> list[str]:
    """Return the reasons why two stages, given as (name, class), are not alternatives; an empty list if they are.

    Alternatives write the same variables. An optional variable is available if all alternatives have it.
    """
    writes = [{str(d) for d in writes_of(kind).values() if not d.optional} for _, kind in both]
    (one, first), (another, second) = both
    if lacking := [
        (a, b, own)
        for a, b, own in ((one, another, writes[0] - writes[1]), (another, one, writes[1] - writes[0]))
        if own
    ]:
        return [
            f"{a} writes {_some(own)}, which {b} does not; alternatives must write the same variables"
            for a, b, own in lacking
        ]
    if is_transfer(first) != is_transfer(second):
        return [f"only one of {one} and {another} is a transfer function; sweep them in two files"]
    return []


def _some(declarations: set[str]) -> str:
    """Return a text with the first of some declarations and the number of the others."""
    ordered = sorted(declarations)
    more = f" and {len(ordered) - 1} more" if len(ordered) > 1 else ""
    return f"'{ordered[0]}'{more}"
