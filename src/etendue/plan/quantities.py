"""Camera quantities: what the stages of a pipeline share, given under ``[camera]`` or by the sensor's preset.

In:  the alternatives at every stage, the pipeline's camera and preset.
Out: ``Quantities``: declared by whom, with which value, written by a stage or not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from etendue.contract import quantities as standard_camera
from etendue.contract.found import Found
from etendue.contract.parameter import MISSING, Parameter
from etendue.contract.stage import parameters_of, writes_of
from etendue.contract.units import as_written
from etendue.errors import nearest
from etendue.plan.alternatives import Entries, meaning
from etendue.plan.model import Axis
from etendue.plan.parameters import Unfit, resolve
from etendue.plan.request import Request
from etendue.plan.sensors import SENSOR, sensor_axis


class Declared(NamedTuple):
    """A camera quantity as the first stage that takes it declares it."""

    parameter: Parameter
    kind: Any
    default: Any
    use: str


@dataclass(frozen=True)
class Quantities:
    """The camera of a pipeline."""

    declared: Mapping[str, Declared]
    values: dict[str, Any]  # None where a required one is lacking, or swept
    written: frozenset[str]  # those that a stage of the pipeline writes
    sensors: Axis | None = None  # where the sensor is swept


def resolve_camera(request: Request, entries: Entries) -> Quantities:
    """The camera's values, for all stages at once."""
    declared = _declared_by(request, entries)
    written = frozenset(d.variable for made in entries.values() for one in made for d in writes_of(one.kind).values())
    axis = sensor_axis(request, declared)
    settled = set(axis.gives if axis else declared if SENSOR in request.pipeline.sweep else ())
    return Quantities(declared, _values_of(request, declared, written, settled), written, axis)


def to_be_found(name: str, parameter: Parameter, ends: tuple[float | None, float | None] = (None, None)) -> Found:
    """What stands for a quantity that an earlier stage writes, while planning: between the ends that the writer or its range gives."""
    held = parameter.held or (-math.inf, math.inf)
    lowest = max(x for x in (ends[0], parameter.at_least, parameter.above, held[0]) if x is not None)
    highest = min(x for x in (ends[1], parameter.at_most, parameter.below, held[1]) if x is not None)
    return Found(name, lowest, highest)


def _declared_by(request: Request, entries: Entries) -> dict[str, Declared]:
    declared: dict[str, Declared] = {}
    for alternatives in entries.values():
        for one in alternatives:
            for name, (parameter, kind, default) in parameters_of(one.kind).items():
                if not parameter.camera:
                    continue
                first = declared.setdefault(name, Declared(parameter, kind, default, one.use))
                if first.parameter.units != parameter.units:
                    request.fault(
                        f"camera.{name}",
                        f"{one.use} takes it in {parameter.units}, but {first.use} in {first.parameter.units}",
                    )
    return declared


def _values_of(request: Request, declared: Mapping[str, Declared], written: frozenset[str], by_sensor: set[str]) -> dict[str, Any]:
    pipeline = request.pipeline
    values: dict[str, Any] = {}
    given = {**({} if SENSOR in pipeline.sweep else pipeline.preset), **pipeline.camera}
    swept = {*pipeline.sweep, *by_sensor}
    for name, value in given.items():
        if name not in declared:
            if name not in pipeline.camera:
                continue  # a sensor has more sides than a pipeline may ask for
            if name in standard_camera.names():
                request.warnings.append(f"camera.{name} is not used by any stage of this pipeline")
            else:
                known = ["sensor", *declared, *standard_camera.names()]
                request.fault(f"camera.{name}", f"unknown camera quantity{nearest(name, known)}")
            continue
        try:
            values[name] = resolve(value, declared[name].parameter, declared[name].kind, pipeline.folder)
        except Unfit as error:
            request.fault(f"camera.{name}", str(error))
    if {"peak_qe", "sensitivity"} <= declared.keys() and "peak_qe" in pipeline.preset and "sensitivity" in pipeline.camera:
        if not {"peak_qe", SENSOR} & {*pipeline.camera, *swept}:
            request.warnings.append(
                f"camera.peak_qe = {as_written(pipeline.preset['peak_qe'])} is that of the sensor {pipeline.sensor}, while sensitivity is "
                "given: every column of it is scaled to that; give peak_qe too"
            )
    for name, one in declared.items():
        if name not in given:
            if one.default is MISSING and name not in swept and name not in written:
                request.fault(f"camera.{name}", f"{one.use} needs it under [camera]: {meaning(one.parameter)}")
            values[name] = None if one.default is MISSING else one.default
    return values
