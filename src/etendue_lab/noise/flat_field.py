"""A camera viewing a grey card: the values of its mosaic, their noise as predicted from the parameters of the stages,
and the response of later stages to a pixel.

In:  a pipeline; a plan of it with a flat scene, and the arrays of a run.
Out: the mean of the mosaic and the predicted variance of its pixels by channel; the response of every later picture to
     one pixel.

Noise and fine detail after the mosaic follow from these responses for any stage, plugins included.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.compute.cell import compute
from etendue.compute.found import with_found
from etendue.compute.jobs import make_jobs
from etendue.compute.joined.segments import Result
from etendue.contract.capabilities import Noisy, is_random, is_source
from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of, writes_of
from etendue.errors import RequestError
from etendue.pipeline.derived import each, given, unswept
from etendue.pipeline.file import PipelineFile, StageEntry
from etendue.plan.model import CellRef, Node, Plan
from etendue.types.arrays import Array
from etendue_camera.roles import FlatScene, Scaled
from etendue_camera.sensor import cfa
from etendue_lab.compare import installed

PICTURES = ("rgb_camera", "xyz_scene", "rgb_linear", "xyz_display", "rgb_display")
# pixels: ignored border, half width of a response, largest side of the measured window
BORDER, REACH, LARGEST = (16, 20, 192)
STEP = 1e-4  # step of a response, relative to full scale
MOSAIC = "mosaic_linear"
FLAWS = frozenset({"defect_map", "stuck_map"})  # variables written by stages that make defective pixels


def in_front_of_grey(
    pipeline: PipelineFile, registry: Registry, reflectance: float, but: Collection[str] = ()
) -> PipelineFile:
    """Return the pipeline without defective pixels, and with a flat grey card of the same size and light in place of
    its scene.

    ``but``: parameters that are not copied from the scene to the card.
    """
    use = installed.made_for(registry, FlatScene)
    allowed = set(parameters_of(registry.load(use))) - {"reflectance", *but}

    def changed(entry: StageEntry) -> StageEntry:
        if entry.use in registry and is_source(registry.load(entry.use)):
            return replace(given(entry, {"reflectance": reflectance}, set(entry.values) - allowed), use=use)
        return _sound(entry, registry)

    return unswept(each(pipeline, changed))


def _sound(entry: StageEntry, registry: Registry) -> StageEntry:
    """If a stage makes pixels defective, return it with the shares of defective pixels set to 0; return other stages
    unchanged.
    """
    if entry.use not in registry or not FLAWS & set(writes_of(kind := registry.load(entry.use))):
        return entry
    shares = {
        name: 0.0
        for name, (p, of, _) in parameters_of(kind).items()
        if of is float and p.at_most == 0.5 and not p.shared
    }
    return given(entry, shares, {"file"})


def another(pipeline: PipelineFile, number: int) -> PipelineFile:
    """Return a camera with the same parameters but another seed and sensor serial, and therefore other noise and fixed
    patterns; number 0 is the camera itself.
    """
    if not number:
        return pipeline
    serial = {**pipeline.preset, **pipeline.shared}.get("sensor_serial", "")
    return replace(
        pipeline, seed=pipeline.seed + number, shared={**pipeline.shared, "sensor_serial": f"{serial}+{number}"}
    )


def several(plan: Plan, node: Node, variable: str, but: Collection[str] = ()) -> str:
    """Return a message if a node writes several pictures of a variable, with their number and the stage that causes it;
    '' if there is one picture. ``but``: dims along which several pictures are expected.
    """
    for dim in (dim for dim in node.writes[variable].dims[:-2] if dim not in but):
        maker = next(one.name for one in plan.nodes if any(dim in declared.dims for declared in one.writes.values()))
        many = plan.of(node.name)[0].grids[variable][dim].size
        return f"{maker} makes {many} of {node.name}.{variable}, along {dim!r}; remove {maker} from the file"
    return ""


def followed(plan: Plan, notes: list[str], what: str, file: str) -> list[str]:
    """Return the names of the picture variables made from the mosaic. If there are none, as for a sensor without colour
    filters, add a note.

    Raises
    ------
    RequestError
        The camera has no mosaic.
    """
    last = next((node.name for node in reversed(plan.nodes) if MOSAIC in node.writes), None)
    if last is None:
        raise RequestError(
            f"no stage of the pipeline writes {MOSAIC}, where {what} starts: add a converter and `linearise` after the "
            "noise, also for a grey sensor",
            file,
        )
    chosen = [name for name in PICTURES if any(name in node.writes for node in plan.nodes)]
    if not chosen:
        notes.append(f"no stage makes a picture of {MOSAIC}: {what} is followed up to {last}")
    return chosen


class FlatField:
    """The linear mosaic of a grey card, and the stages after it."""

    def __init__(
        self, plan: Plan, first: Node, arrays: list[dict[CellRef, dict[str, Array]]], notes: list[str]
    ) -> None:
        self.plan, self.first, self.arrays, self.notes = plan, first, arrays, notes
        self.ref: CellRef = (first.name, ())
        if why := several(plan, first, MOSAIC):
            raise RequestError(f"noise can be followed through a single picture only: {why}")
        self.rows, self.columns = arrays[0][self.ref][MOSAIC].shape
        side = min(self.rows, self.columns)
        if side < 2 * BORDER + 32 or side < 2 * REACH + 8:
            raise RequestError(
                f"the picture has {self.rows} x {self.columns} pixels: at least 64 x 64 are needed to measure noise"
            )
        self.mask = self._mask()
        self.jobs = make_jobs(plan, set(plan.cells), lambda cell: None, deliver_all=True)
        results = {ref: Result(arrays=dict(found)) for ref, found in arrays[0].items()}
        before = [node.name for node in plan.nodes if node.name in self.reaching(first.name)]
        self.before = {name: with_found(self.jobs[name, ()], results).stage for name in before}

    def _mask(self) -> Array:
        """Channel name at each position of the mosaic cell; the cell starts at the first pixel of the window."""
        pattern = self.plan.shared.get("pattern", "mono")
        mask = cfa.read(str(pattern))
        grid = self.plan.cells[self.ref].grids[MOSAIC]
        down, right = (round(grid.line(dim).start) for dim in ("y", "x"))
        cell = np.array([list(row) for row in mask.rows], dtype=object)
        return np.roll(cell, (-(down % cell.shape[0]), -(right % cell.shape[1])), (0, 1))

    def window(self, array: Any) -> Any:
        """Return the middle of a picture, starting at the first position of the mosaic cell."""
        slices = []
        for size, period in zip(array.shape[-2:], self.mask.shape, strict=True):
            side = min(size - 2 * BORDER, LARGEST) // period * period
            start = (size - side) // 2 // period * period
            slices.append(slice(start, start + side))
        return array[(..., *slices)]

    def signal(self, rows: slice = slice(None), columns: slice = slice(None)) -> dict[str, float]:
        """Return the mean charge by channel in the window or a part of it, electron."""
        ref = next((r for r, found in self.arrays[0].items() if "expected_charge" in found), None)
        if ref is None:
            return {}
        charge = self.window(self.arrays[0][ref]["expected_charge"])
        tiles = np.tile(self.mask, (charge.shape[0] // self.mask.shape[0], charge.shape[1] // self.mask.shape[1]))
        charge, tiles = charge[rows, columns], tiles[rows, columns]
        return {str(c): float(charge[tiles == c].mean()) for c in dict.fromkeys(self.mask.ravel())}

    def unsaid(self) -> str:
        """Return why the noise of the mosaic cannot be predicted; '' if every stage before it declares what is
        needed.
        """
        drawing = {name: type(stage) for name, stage in self.before.items() if is_random(type(stage))}
        silent = [
            name for name, kind in drawing.items() if not issubclass(kind, Noisy) and not FLAWS & set(writes_of(kind))
        ]
        if silent:
            return f"{silent[0]} draws random numbers but does not declare its noise"
        if not isinstance(self.before[self.first.name], Scaled):
            return f"{self.first.name} does not declare its scale"
        return "" if self.signal() else "no stage writes expected_charge"

    def noisy(self) -> dict[str, Noisy]:
        """Return the stages before the mosaic that add noise, in order."""
        return {name: stage for name, stage in self.before.items() if isinstance(stage, Noisy)}

    def model(self, signal: Mapping[str, float]) -> dict[str, float]:
        """Return the variance of a pixel of the linearised mosaic by channel, from the declarations of the stages
        before it.
        """
        scale = self.before[self.first.name]
        if self.unsaid() or not isinstance(scale, Scaled):
            return {}
        noisy = self.noisy().values()
        remark = "noise of whole rows and columns is treated as independent noise of each pixel"
        if any(stage.by_line and stage.variance(0.0) for stage in noisy) and remark not in self.notes:
            self.notes.append(remark)
        full = scale.electrons()
        return {channel: sum(stage.variance(charge) for stage in noisy) / full**2 for channel, charge in signal.items()}

    def flat_mosaic(self, mosaics: list[Array]) -> Array:
        """Return a mosaic with uniform channels, as large as the frame."""
        flat = np.empty((self.rows, self.columns))
        for y, x in np.ndindex(self.mask.shape):
            place = (slice(y, None, self.mask.shape[0]), slice(x, None, self.mask.shape[1]))
            flat[place] = np.mean([m[place].mean() for m in mosaics])
        return flat

    def places(self) -> list[tuple[tuple[int, int], float]]:
        """Return the mosaic cells at which responses are taken: the first pixel (row, column) of each, and its weight.
        They are far enough apart that responses do not overlap.

        The cells lie at Gauss-Legendre nodes. With three nodes per line, the weighted mean is exact for a gain that is
        a polynomial of fifth degree in position.
        """
        lines = []
        for size, period in zip((self.rows, self.columns), self.mask.shape, strict=True):
            side = min(size - 2 * BORDER, LARGEST) // period * period
            start = (size - side) // 2 // period * period
            apart = 2 * REACH + 4 + 2 * period
            count = next((n for n, share in ((3, 0.387), (2, 0.577)) if share * side >= apart), 1)
            nodes, weights = np.polynomial.legendre.leggauss(count)
            lines.append(
                [
                    (start + round(0.5 * (1 + x) * side) // period * period, w / 2)
                    for x, w in zip(nodes, weights, strict=True)
                ]
            )
        return [((y, x), float(v * w)) for y, v in lines[0] for x, w in lines[1]]

    def responses(
        self, flat: Array, found: Mapping[tuple[int, int], float], modelled: bool
    ) -> dict[tuple[str, str], list[tuple[Any, Any, float]]]:
        """Return three values for each picture at several places of the frame: the response to a step of one pixel
        (position in the mosaic cell, channel, y, x), the variance of the stepped pixels, and the weight of the place.
        """
        behind, (places, weights) = self.behind(), zip(*self.places(), strict=True)
        variance = [self.variance_at(place, found, modelled) for place in places]
        answers: dict[tuple[str, str], list[list[Any]]] = {}
        for y, x in np.ndindex(self.mask.shape):
            pair = []
            for sign in (1.0, -1.0):
                stepped = flat.copy()
                for place in places:
                    stepped[place[0] + y, place[1] + x] += sign * STEP
                pair.append(self.run(behind, stepped))
            for picture in pair[0]:
                step = (pair[0][picture] - pair[1][picture]) / (2 * STEP)
                for one, (row, column) in zip(answers.setdefault(picture, [[] for _ in places]), places, strict=True):
                    one.append(step[..., self._around(row, self.rows), self._around(column, self.columns)])
        return {
            picture: [(np.stack(one), v, w) for one, v, w in zip(own, variance, weights, strict=True)]
            for picture, own in answers.items()
        }

    @staticmethod
    def _around(middle: int, size: int) -> slice:
        return slice(max(0, middle - REACH), min(size, middle + REACH + 4))

    def variance_at(self, place: tuple[int, int], found: Mapping[tuple[int, int], float], modelled: bool) -> Array:
        """Return the variance of the pixels of a mosaic cell, from the light there."""
        order = list(np.ndindex(self.mask.shape))
        if not modelled:
            return np.array([found[p] for p in order])
        parts = []
        for at, size, period in zip(place, (self.rows, self.columns), self.mask.shape, strict=True):
            side = min(size - 2 * BORDER, LARGEST) // period * period
            inside = at - (size - side) // 2 // period * period
            parts.append(slice(max(0, inside - 4 * period), inside + 5 * period))
        model = self.model(self.signal(*parts))
        return np.array([model[str(self.mask[p])] for p in order])

    def reaching(self, name: str) -> set[str]:
        """Return a node and all nodes that it depends on."""
        needed = {name}
        for node in reversed(self.plan.nodes):
            needed |= {source for _, source, _ in node.inputs[0]} if node.name in needed else set()
        return needed

    def behind(self) -> list[str]:
        """Return the nodes that depend on the mosaic."""
        reached = {self.first.name}
        for node in self.plan.nodes:
            if not node.is_probe and {source for _, source, _ in node.inputs[0]} & reached:
                reached.add(node.name)
        return [node.name for node in self.plan.nodes if node.name in reached - {self.first.name}]

    def run(self, behind: list[str], mosaic: Array) -> dict[tuple[str, str], Any]:
        """Return the pictures that later stages make from another mosaic."""
        results = {ref: Result(arrays=dict(found)) for ref, found in self.arrays[0].items()}
        results[self.ref] = Result(arrays={**results[self.ref].arrays, MOSAIC: mosaic})
        found = {}
        for name in behind:
            ref: CellRef = (name, ())
            if ref not in self.jobs:
                continue
            results[ref], report = compute(self.jobs[ref], results)
            if report.status == "failed":
                raise RequestError(f"stage {name!r} failed on a flat field: {report.message.splitlines()[-1]}")
            for variable, array in results[ref].arrays.items():
                if variable in PICTURES:
                    found[name, variable] = np.asarray(array, np.float64)
        return found
