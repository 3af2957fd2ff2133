"""A sensor as an axis: many camera quantities that change together.

In:  ``[sweep] sensor = ["NAME", { sensor = "NAME", label = "TEXT", pixel_pitch = "4 um" }]``, the camera's quantities.
Out: the axis, with what each of its sensors gives every quantity that sensors speak of.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from etendue.contract import quantities as standard_camera
from etendue.contract.parameter import MISSING
from etendue.contract.units import as_written
from etendue.errors import RequestError, nearest, unprintable
from etendue.pipeline.presets import preset, preset_names
from etendue.plan.model import Axis
from etendue.plan.parameters import Unfit, resolve
from etendue.plan.request import Request

if TYPE_CHECKING:
    from etendue.plan.quantities import Declared

SENSOR = "sensor"
PLACE = f"sweep.{SENSOR}"
WORDS = (SENSOR, "label")  # of a table, beside camera quantities


def sensor_axis(request: Request, declared: Mapping[str, Declared]) -> Axis | None:
    """The axis; None where no sensor is swept, or a fault comes of it.

    What a sensor's own table gives goes before ``[camera]``, which goes before what its name stands for; a quantity with an axis of its own
    is left to that. Whatever some installed sensor says is taken along the axis, also where those that are named agree: so an archive
    grows by further sensors.
    """
    written = request.pipeline.sweep.get(SENSOR)
    if written is None:
        return None
    if isinstance(written, str) or not isinstance(written, list | tuple) or not written:
        request.fault(PLACE, f"expected a list of sensors, got {as_written(written)}")
        return None
    before = len(request.faults)
    tables: dict[str, Mapping[str, Any]] = {}
    for one in written:
        table = {SENSOR: one} if isinstance(one, str) else one
        if not isinstance(table, Mapping) or not (isinstance(table.get(SENSOR), str) or isinstance(table.get("label"), str)):
            request.fault(PLACE, f"expected a sensor's name, or a table with 'sensor', 'label' or both, got {as_written(one)}")
            continue
        label = str(table.get("label", table.get(SENSOR)))
        if unprintable(label) or not label:
            request.fault(PLACE, f"the label {as_written(label)} is no plain name: text without control characters")
        elif label in tables:
            request.fault(PLACE, f"{label!r} stands twice; give one of them another 'label'")
        else:
            tables[label] = table
    own = {name for table in tables.values() for name in table if name not in WORDS}
    for name in sorted(own - {*declared, *standard_camera.names()}):
        request.fault(PLACE, f"unknown camera quantity {name!r}{nearest(name, [*WORDS, *declared, *standard_camera.names()])}")
    named = {name for known in preset_names() for name in _stated(known)}
    taken = [name for name in declared if name in own or (name in named and name not in request.pipeline.camera)]
    taken = [name for name in taken if name not in request.pipeline.sweep]
    gives = {name: _column(request, name, declared[name], tables) for name in taken}
    for name in sorted(named & declared.keys() & request.pipeline.camera.keys() - own):
        request.warnings.append(f"camera.{name} holds for every sensor of the sweep")
    return None if len(request.faults) > before else Axis(SENSOR, SENSOR, tuple(tables), "", gives)


def _stated(name: str) -> Mapping[str, Any]:
    """What an installed sensor gives; nothing where it cannot be read: whoever names it is told."""
    try:
        return preset(name).values()
    except RequestError:
        return {}


def _column(request: Request, name: str, one: Declared, tables: Mapping[str, Mapping[str, Any]]) -> tuple[Any, ...]:
    """A quantity of all sensors, in order."""
    found = []
    for label, table in tables.items():
        try:
            written = {**(preset(str(table[SENSOR])).values() if SENSOR in table else {}), **request.pipeline.camera, **table}
            value = resolve(written[name], one.parameter, one.kind, request.pipeline.folder) if name in written else one.default
        except Unfit as error:
            request.fault(PLACE, f"{label}: {name}: {error}")
            continue
        except RequestError as error:
            for fault in error.faults:
                if fault.message not in [known.message for known in request.faults]:
                    request.fault(PLACE, fault.message)
            continue
        if value is MISSING:
            request.fault(PLACE, f"{label} does not say its {name}, which {one.use} needs: give it in its table, or under [camera]")
        found.append(value)
    return tuple(found)
