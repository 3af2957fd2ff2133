"""Resolve the quantities that the stages of a pipeline share. A table of the file, or the preset it names, gives their
values.

In:  the alternatives at every stage, the pipeline's shared quantities and preset.
Out: ``Quantities``: their declarations, their values, and whether a stage writes them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from etendue.contract.stage import parameters_of, writes_of
from etendue.contract.values import quantities
from etendue.contract.values.late_bound import LateValue
from etendue.contract.values.parameter import MISSING, Parameter
from etendue.contract.values.units import as_written
from etendue.errors import nearest
from etendue.pipeline.stand_ins import standing_in
from etendue.plan.model import Axis
from etendue.plan.wiring.alternatives import Entries, meaning
from etendue.plan.wiring.parameters import Unfit, resolve
from etendue.plan.wiring.presets import preset_axes
from etendue.plan.wiring.request import Request
from etendue.types.documents import Document


class Declared(NamedTuple):
    """A shared quantity as declared by the first stage that takes it."""

    parameter: Parameter
    kind: Any
    default: Any
    use: str


@dataclass(frozen=True)
class Quantities:
    """All quantities that the stages of a pipeline share."""

    declared: Mapping[str, Declared]
    values: Document  # None if a required one is missing or swept
    written: frozenset[str]  # those that a stage of the pipeline writes
    presets: Mapping[str, Axis]  # those of swept presets, by the key that names them


def resolve_quantities(request: Request, entries: Entries) -> Quantities:
    """Return the values of shared quantities, for all stages at once."""
    declared = _declared_by(request, entries)
    written = frozenset(d.variable for made in entries.values() for one in made for d in writes_of(one.kind).values())
    axes = preset_axes(request, declared)
    settled = {name for axis in axes.values() for name in axis.gives}
    if len(axes) < len(request.pipeline.presets_swept):  # one of the presets is faulty
        settled = set(declared)
    values = _values_of(request, declared, written, settled)
    if not request.faults:  # whether every preset could be read
        _tell_stand_ins(request, declared)
    return Quantities(declared, values, written, axes)


def _tell_stand_ins(request: Request, used: Mapping[str, Declared]) -> None:
    """Add a note on values that no source gives; report a fault if the pipeline does not allow such values."""
    for preset, names in standing_in(request.pipeline, used).items():
        text = f"no source gives {', '.join(names)} of the {preset}: typical values are used"
        if request.pipeline.stand_ins:
            request.warnings.append(text)
        else:
            table = request.pipeline.table.name
            request.fault("stand_ins", f"{text}, and are not allowed; give your own under [{table}]")
    for word, own in request.pipeline.presets.items():
        kind, title = request.pipeline.table.kind_of(word), request.pipeline.named[word]
        for name in own if kind.find else ():
            if name in quantities.names() and quantities.declared(name).table and name not in used:
                request.warnings.append(f"{name} of the {word} {title} is not used by any stage of this pipeline")


def to_be_found(name: str, parameter: Parameter, ends: tuple[float | None, float | None] = (None, None)) -> LateValue:
    """Return the placeholder that stands, while planning, for a quantity that an earlier stage writes. Its range is the
    intersection of the ranges of the writing stage and of the parameter.
    """
    held = parameter.held or (-math.inf, math.inf)
    lowest = max(x for x in (ends[0], parameter.at_least, parameter.above, held[0]) if x is not None)
    highest = min(x for x in (ends[1], parameter.at_most, parameter.below, held[1]) if x is not None)
    return LateValue(name, lowest, highest)


def _declared_by(request: Request, entries: Entries) -> dict[str, Declared]:
    declared: dict[str, Declared] = {}
    named = {kind.preset for kind in request.pipeline.table.kinds()}
    for alternatives in entries.values():
        for one in alternatives:
            for name, (parameter, kind, default) in parameters_of(one.kind).items():
                if not parameter.shared:
                    continue
                if name in named:
                    text = f"takes a shared quantity {name!r}, which names a preset: its author must rename it"
                    request.fault(f"stages.{one.use}", text)
                first = declared.setdefault(name, Declared(parameter, kind, default, one.use))
                if first.parameter.units != parameter.units:
                    request.fault(
                        request.pipeline.table.place(name),
                        f"{one.use} takes it in {parameter.units}, but {first.use} in {first.parameter.units}",
                    )
    return declared


def _values_of(
    request: Request, declared: Mapping[str, Declared], written: frozenset[str], by_preset: set[str]
) -> Document:
    pipeline = request.pipeline
    values: Document = {}
    stated = pipeline.preset
    by = {name: word for word, own in pipeline.presets.items() for name in own}
    given = {**stated, **pipeline.shared}
    place = pipeline.table.place
    swept = {*pipeline.sweep, *by_preset}
    for name, value in given.items():
        if name not in declared:
            if name not in pipeline.shared:
                continue  # a preset may give quantities that this pipeline does not use
            if name in quantities.names():
                request.warnings.append(f"{place(name)} is not used by any stage of this pipeline")
            else:
                known = [*pipeline.table.words(), *declared, *quantities.names()]
                request.fault(place(name), f"unknown {pipeline.table.name} quantity{nearest(name, known)}")
            continue
        try:
            values[name] = resolve(value, declared[name].parameter, declared[name].kind, pipeline.folder)
        except Unfit as error:
            request.fault(place(name), str(error))
    for name in declared.keys() & stated.keys() - {*pipeline.shared, *swept}:
        other = quantities.declared(name).scales if name in quantities.names() else ""
        if other in declared.keys() & pipeline.shared.keys():
            request.warnings.append(
                f"{place(name)} = {as_written(stated[name])} comes from the {by[name]} {pipeline.named[by[name]]} and "
                f"is applied to {other}, which is given here; also give {name} if your value differs"
            )
    for name, one in declared.items():
        if name not in given:
            if one.default is MISSING and name not in swept and name not in written:
                request.fault(
                    place(name), f"{one.use} needs it under [{pipeline.table.name}]: {meaning(one.parameter)}"
                )
            values[name] = None if one.default is MISSING else one.default
    return values
