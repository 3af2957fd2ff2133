"""Sort the raw frames of a plan into exposure levels: stacks of light and dark frames by exposure time, for each camera
of a sweep.

In:  a plan, and a function that reads the raw frames of its cells.
Out: a measurement for each channel, with the values that the sensor's stages declare.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from etendue.contract.capabilities import Datasheet
from etendue.contract.stage import Stage
from etendue.errors import RequestError
from etendue.plan.ancestry import ancestry
from etendue.plan.model import Cell, CellRef, Node, Plan
from etendue.session import Options, collect
from etendue_camera.electronics import emva
from etendue_camera.light import radiometry
from etendue_camera.sensor import cfa
from etendue_lab.emva.report import Expected, SensorChannel
from etendue_lab.noise.flat_field import several

RAW, TIME = "raw", "integration_time"
LIGHTS = frozenset({"reflectance", "white_luminance", "radiance"})  # parameters that are 0 in the dark
Read = Callable[[CellRef], Any]


def raw_node(plan: Plan) -> Node:
    """Return the last stage that writes raw frames."""
    found = [node for node in plan.nodes if RAW in node.writes]
    if not found:
        raise RequestError("no stage writes raw: a sensor is measured from its raw frames")
    return found[-1]


def of_plan(
    plan: Plan, read: Read, options: Options | None = None, there: Collection[CellRef] | None = None
) -> list[SensorChannel]:
    """Measure every channel of every camera of a sweep.

    Raises
    ------
    RequestError
        There are fewer than four exposure times with two light frames and two dark frames each.
    """
    node = raw_node(plan)
    exposures = {dim for one in plan.nodes if TIME in one.writes for dim in one.writes[TIME].dims}
    if why := several(plan, node, RAW, exposures):
        raise RequestError(f"the frames of a sensor may differ only in exposure: {why}")
    keys = {dim: plan.axis(dim).key for dim in node.axes}
    light = [dim for dim, key in keys.items() if key.rpartition(".")[2] in LIGHTS and 0 in plan.axis(dim).values]
    cells = [cell for cell in plan.of(node.name) if there is None or cell.ref in there]
    if len(light) != 1 or not cells:
        raise RequestError(
            "a sensor is measured in the light and in the dark: sweep the reflectance of a uniform scene over 0 and 1, "
            "as pipelines/emva.toml does, or run etendue emva FILE, which simulates the frames that it needs"
        )
    timed = [dim for dim, key in keys.items() if key == TIME]
    times = _times(plan, cells, options)
    found = []
    for camera, by_light in _by_camera(plan, cells, light[0], timed).items():
        dark = by_light.pop(0, [])
        for level, bright in sorted(by_light.items()):
            at = dict(camera) | ({light[0]: level} if len(by_light) > 1 else {})
            found += _measured(plan, at, bright, dark, times, read, options)
    if not found:
        raise RequestError("no level has frames of both light and dark")
    return found


def _by_camera(
    plan: Plan, cells: list[Cell], light: str, timed: list[str]
) -> dict[tuple[tuple[str, Any], ...], dict[Any, list[Cell]]]:
    """Group cells by camera (the values of all axes other than light and time), and for each camera by light level."""
    found: dict[tuple[tuple[str, Any], ...], dict[Any, list[Cell]]] = {}
    for cell in cells:
        labels = plan.labels(cell.ref)
        camera = tuple((dim, value) for dim, value in labels.items() if dim not in (light, *timed))
        found.setdefault(camera, {}).setdefault(labels[light], []).append(cell)
    return found


def _measured(
    plan: Plan,
    at: dict[str, Any],
    bright: list[Cell],
    dark: list[Cell],
    times: Mapping[CellRef, Any],
    read: Read,
    options: Options | None,
) -> list[SensorChannel]:
    stacks = [_stacks(cells, times, read) for cells in (bright, dark)]
    shared = sorted(set(stacks[0]) & set(stacks[1]))
    few = min((len(stacks[k][t]) for k in (0, 1) for t in shared), default=0)
    if len(shared) < 4 or few < 2:
        raise RequestError(
            f"found {len(shared)} exposure times with light and dark, with at least {few} frames each; four times with "
            "two frames each are needed: put the stage bracket with repeats = 2 before the exposure, or run etendue "
            "emva FILE, which simulates the frames that it needs"
        )
    stages = _stages(plan, bright[0])
    mask = mask_of(stages)
    grid = bright[0].grids[RAW]
    first = tuple(round(grid.line(dim).start) for dim in ("y", "x"))
    sheet, photons, rates = (
        known(stages),
        photon_flux(plan, bright[0], options),
        photon_rates(plan, bright[0], mask, options),
    )
    found = []
    for channel in mask.channels:
        light, black = (
            [cfa.frames_of_channel(np.stack(own[t]), mask, channel, *first) for t in shared] for own in stacks
        )
        try:
            measurement = emva.measure(shared, light, black, photons * np.array(shared) if photons else None)
        except ValueError as error:
            found.append(SensorChannel(at, channel, None, tuple(shared), {}, str(error)))
            continue
        own = {**sheet, "quantum_efficiency": rates[channel] / photons} if photons else sheet
        expected = Expected.of(own, shared[measurement.pattern_level])
        found.append(SensorChannel(at, channel, measurement, tuple(shared), expected))
    return found


def _stacks(cells: list[Cell], times: Mapping[CellRef, Any], read: Read) -> dict[float, list[Any]]:
    """Return the frames of each exposure time (s)."""
    found: dict[float, list[Any]] = {}
    for cell in cells:
        raw, own = read(cell.ref), np.atleast_1d(times[cell.ref])
        frames = raw.reshape(-1, *raw.shape[-2:])
        for time, frame in zip(np.broadcast_to(own, len(frames)), frames, strict=True):
            found.setdefault(float(time), []).append(frame)
    return found


def _times(plan: Plan, cells: list[Cell], options: Options | None) -> dict[CellRef, Any]:
    """Return the exposure time (s) of every cell: from the stage that sets it for each frame, else from the sweep axis,
    else from the camera.
    """
    series = [node for node in plan.nodes if TIME in node.writes]
    if not series:
        return {cell.ref: plan.labels(cell.ref).get(TIME) or _camera_time(plan, cell) for cell in cells}
    refs = {cell.ref: _at(plan, series[-1], cell) for cell in cells}
    found = collect(plan, {ref: [TIME] for ref in refs.values()}, options).arrays
    return {ref: found[own][TIME] for ref, own in refs.items()}


def _camera_time(plan: Plan, cell: Cell) -> float:
    labels = plan.labels(cell.ref)
    axis = next((dim for dim in labels if plan.axis(dim).key == TIME), None)
    if axis is not None:
        return float(labels[axis])
    return float(
        next((t for s in reversed(_stages(plan, cell)) if (t := getattr(s, TIME, None)) is not None), math.nan)
    )


def _at(plan: Plan, node: Node, cell: Cell) -> CellRef:
    """Return the cell of ``node`` that the given cell depends on."""
    behind = ancestry(plan, [cell.ref])
    return next(own.ref for own in plan.of(node.name) if own.ref in behind)


def _stages(plan: Plan, cell: Cell) -> list[Stage]:
    """Return the stage of a cell and all stages before it, in order."""
    behind = ancestry(plan, [cell.ref])
    return [own.stage for node in plan.nodes for own in plan.of(node.name) if own.ref in behind]


def mask_of(stages: list[Stage]) -> cfa.Mask:
    """Return the colour filter array that the stages share."""
    return cfa.read(next((p for s in reversed(stages) if isinstance(p := getattr(s, "pattern", None), str)), "mono"))


def known(stages: list[Stage]) -> dict[str, float]:
    """Combine what stages declare about their sensor. Variances of noise and patterns are added, as are dark currents;
    gains are multiplied; the smallest full well is used.
    """
    found: dict[str, float] = {}
    for stage in stages:
        if isinstance(stage, Datasheet):
            for name, value in stage.datasheet().items():
                if name not in found:
                    found[name] = value
                elif name == "full_well":
                    found[name] = min(found[name], value)
                elif name == "gain":
                    found[name] *= value
                else:
                    found[name] = found[name] + value if name == "dark_current" else math.hypot(found[name], value)
    return found


def photon_rates(plan: Plan, cell: Cell, mask: cfa.Mask, options: Options | None) -> dict[str, float]:
    """Return the photoelectrons per second of each channel, for the pixels that a cell reads; NaN if no stage writes
    photocurrent.
    """
    own = _last(plan, cell, "photocurrent")
    if own is None:
        return dict.fromkeys(mask.channels, math.nan)
    current = collect(plan, {own.ref: ["photocurrent"]}, options).arrays[own.ref]["photocurrent"]
    first = tuple(round(own.grids["photocurrent"].line(dim).start) for dim in ("y", "x"))
    return {c: float(cfa.frames_of_channel(current, mask, c, *first).mean()) for c in mask.channels}


def photon_flux(plan: Plan, cell: Cell, options: Options | None) -> float:
    """Return the photons per second that fall on the area of a pixel, over all wavelengths; 0 if unknown."""
    own = _last(plan, cell, "irradiance")
    pitch = next((p for s in _stages(plan, cell) if isinstance(p := getattr(s, "pixel_pitch", None), float)), 0.0)
    if own is None or not pitch:
        return 0.0
    bands = own.grids["irradiance"].bands()
    light = (
        collect(plan, {own.ref: ["irradiance"]}, options)
        .arrays[own.ref]["irradiance"]
        .mean(axis=(1, 2), dtype=np.float64)
    )
    power = light * np.diff(bands.edges) * (pitch * 1e-6) ** 2
    return float(radiometry.photons_from_energy(power, 1e-3 * np.array(bands.values())).sum())


def _last(plan: Plan, cell: Cell, variable: str) -> Cell | None:
    """Return the last cell that writes a variable, among those that a given cell depends on."""
    behind = ancestry(plan, [cell.ref])
    found = [own for node in plan.nodes if variable in node.writes for own in plan.of(node.name) if own.ref in behind]
    return found[-1] if found else None


def lit(plan: Plan, options: Options | None) -> dict[str, float]:
    """Return the photoelectrons per second of each channel in the light of the scene, before the lamp is scaled."""
    cell = plan.of(raw_node(plan).name)[0]
    return photon_rates(plan, cell, mask_of(_stages(plan, cell)), options)


def saturation(plan: Plan) -> tuple[float, float, float]:
    """Return the full well (electron), a dark current that few pixels exceed (electron/s), and the camera's integration
    time (s).
    """
    stages = _stages(plan, plan.of(raw_node(plan).name)[0])
    sheet = known(stages)
    time = next((t for s in stages if isinstance(t := getattr(s, TIME, None), float)), math.nan)
    return sheet.get("full_well", math.inf), sheet.get("dark_current", 0.0) + 3 * sheet.get("dark_spread", 0.0), time
