"""``etendue noise``: noise carried through a camera's stages, predicted and found, of a flat grey scene.

In:  a pipeline as written, the reflectance of its flat scene, a number of frames.
Out: for each stage behind the linearised mosaic the standard deviation of every channel, the correlation between channels and
     between neighbours: predicted from the camera's own figures and found in frames of noise.

Prediction: the variance of a pixel of the mosaic follows from what the stages in front of it say of their noise (`Noisy`: shot noise,
read noise, fixed patterns, rounding) and from the mosaic's scale (`Scaled`); what the later stages make of it follows from what they
answer to a small step of one pixel at each place of the colour filter array, so that it holds for any stage, plugins too; answers and
variances are taken at several places of the frame, as a correction of shading has its own gain at each. The prediction is linear about
the flat field: a stage that adapts to its picture, such as an adaptive demosaicer, adapts to real noise as well, and then the two columns
differ. Defective pixels are left out: they are no noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from etendue.errors import RequestError
from etendue.physics.colour import noise_propagation as propagation
from etendue.physics.sensor import cfa
from etendue.plan.model import CellRef, Node, Plan
from etendue.plan.planner import make_plan
from etendue.registry import Registry
from etendue.run.cell import compute
from etendue.run.found import with_found
from etendue.run.jobs import make_jobs
from etendue.run.segments import Result
from etendue.session import Options, execute
from etendue.spec.capabilities import is_random, is_source
from etendue.spec.pipeline import Pipeline, StageEntry
from etendue.spec.ports import Progress
from etendue.spec.roles import FlatScene, Noisy, Scaled
from etendue.spec.stage import parameters_of, writes_of
from etendue.studies import installed
from etendue.studies.axis import without_sweep
from etendue.studies.noise_report import NoiseReport, StageNoise

PICTURES = ("rgb_camera", "xyz_scene", "rgb_linear", "xyz_display", "rgb_display")
BORDER, REACH, LARGEST = 16, 20, 192  # pixels: left out at the border, held by a response, side of the window that is measured
STEP = 1e-4  # of a response's step, of full scale
FULL = 0.001  # share of clipped pixels from which noise is cut off
TREND = 4  # degree of what is taken off before noise is measured: fall-off over a wide field is no noise
MOSAIC = "mosaic_linear"
FLAWS = frozenset({"defect_map", "stuck_map"})  # what stages write that make defective pixels


def noise(
    pipeline: Pipeline,
    registry: Registry,
    reflectance: float = 0.18,
    frames: int = 4,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
) -> NoiseReport:
    """Predict and measure the noise of a camera behind every stage.

    Parameters
    ----------
    pipeline : Pipeline
        Its scene is replaced by a flat one of the same size and light; a sweep is left out.
    registry : Registry
    reflectance : float
        Of the flat scene, above 0 and at most 1.
    frames : int
        How many frames of noise, at least 1, each with fixed patterns of its own.

    Raises
    ------
    RequestError
        Faults of the pipeline; a camera without a mosaic, or a picture too small to measure in.
    """
    if not 0 < reflectance <= 1:
        raise RequestError(f"--reflectance {reflectance:g}: expected a number above 0 and at most 1")
    if frames < 1:
        raise RequestError(f"--frames {frames}: expected at least 1")
    alone, taken = without_sweep(pipeline)
    notes = [f"instead of a sweep: {', '.join(f'{key} = {value}' for key, value in taken.items())}"] if taken else []
    flat = _flat(alone, registry, reflectance)
    plan = make_plan(flat, registry, leave_out_allowed=False)
    chosen = [name for name in PICTURES if any(name in node.writes for node in plan.nodes)]
    if not any(MOSAIC in node.writes for node in plan.nodes) or not chosen:
        raise RequestError("the pipeline has no mosaic_linear, or no picture made of it: there is no noise to follow", pipeline.file)
    wanted = tuple(f"{n.name}.{v}" for n in plan.nodes for v in n.writes if v in (*chosen, MOSAIC, "expected_charge") and not n.is_probe)
    notes += plan.warnings
    flat = replace(flat, wanted=wanted, keep=None, precision="float64")
    runs = [make_plan(replace(flat, seed=flat.seed + number), registry, leave_out_allowed=False) for number in range(frames)]
    outcomes = [execute(run, None, options, progress(run) if progress else None) for run in runs]
    for outcome in outcomes:
        if outcome.failed:
            report = outcome.failed[0]
            raise RequestError(f"the stage {report.stage!r} broke off: {report.message.splitlines()[-1]}", pipeline.file)
    if not any(n.is_random for n in runs[0].nodes):
        raise RequestError("no stage of the pipeline draws noise: there is none to follow", pipeline.file)
    first = next(n for n in runs[0].nodes if MOSAIC in n.writes and MOSAIC not in {v for _, _, v in n.inputs[0]})
    arrays = [{ref: found for ref, found in outcome.arrays.items()} for outcome in outcomes]
    return _Measurement(runs[0], first, arrays, notes).report(flat, reflectance)


def _flat(pipeline: Pipeline, registry: Registry, reflectance: float) -> Pipeline:
    """The pipeline in front of a flat grey card of the size and light of its scene."""
    use = installed.made_for(registry, FlatScene)
    allowed = set(parameters_of(registry.load(use))) - {"reflectance"}
    entries: list[StageEntry] = []
    for entry in pipeline.stages:
        if entry.use in registry and is_source(registry.load(entry.use)):
            values = {name: value for name, value in entry.values.items() if name in allowed}
            entry = replace(entry, use=use, values={**values, "reflectance": reflectance})
        entries.append(sound(entry, registry))
    return replace(pipeline, stages=tuple(entries), sweep={})


def sound(entry: StageEntry, registry: Registry) -> StageEntry:
    """A stage that makes defective pixels, making none."""
    if entry.use not in registry or not FLAWS & set(writes_of(kind := registry.load(entry.use))):
        return entry
    shares = {name: 0.0 for name, (p, of, _) in parameters_of(kind).items() if of is float and p.at_most == 0.5 and not p.camera}
    return replace(entry, values={**{k: v for k, v in entry.values.items() if k != "file"}, **shares})


class _Measurement:
    """What is predicted and found behind one node."""

    def __init__(self, plan: Plan, first: Node, arrays: list[dict[CellRef, dict[str, Any]]], notes: list[str]) -> None:
        self.plan, self.first, self.arrays, self.notes = plan, first, arrays, notes
        self.ref: CellRef = (first.name, ())
        if arrays[0][self.ref][MOSAIC].ndim != 2:
            raise RequestError("the mosaic has frames of its own (an exposure series): follow the noise of a single exposure")
        self.rows, self.columns = arrays[0][self.ref][MOSAIC].shape
        side = min(self.rows, self.columns)
        if side < 2 * BORDER + 32 or side < 2 * REACH + 8:
            raise RequestError(f"the picture has {self.rows} x {self.columns} pixels: at least 64 x 64 are needed to measure noise")
        self.mask = self._mask()
        self.jobs = make_jobs(plan, set(plan.cells), lambda cell: None, deliver_all=True)
        results = {ref: Result(arrays=dict(found)) for ref, found in arrays[0].items()}
        before = [node.name for node in plan.nodes if node.name in self._reaching(first.name)]
        self.before = {name: with_found(self.jobs[name, ()], results).stage for name in before}

    def _mask(self) -> Any:
        """Channel names by place in the cell, as the window sees them."""
        pattern = self.plan.camera.get("pattern", "mono")
        mask = cfa.read(str(pattern))
        grid = self.plan.cells[self.ref].grids[MOSAIC]
        down, right = (round(grid.line(dim).start) for dim in ("y", "x"))
        cell = np.array([list(row) for row in mask.rows], dtype=object)
        return np.roll(cell, (-(down % cell.shape[0]), -(right % cell.shape[1])), (0, 1))

    def window(self, array: Any) -> Any:
        """The middle of a picture, beginning at the cell's first place."""
        slices = []
        for size, period in zip(array.shape[-2:], self.mask.shape, strict=True):
            side = min(size - 2 * BORDER, LARGEST) // period * period
            start = (size - side) // 2 // period * period
            slices.append(slice(start, start + side))
        return array[(..., *slices)]

    def report(self, pipeline: Pipeline, reflectance: float) -> NoiseReport:
        mosaics = [self.window(a[self.ref][MOSAIC]) for a in self.arrays]
        found: dict[tuple[int, int], float] = {}
        by_place: dict[tuple[int, int], Any] = {}
        for y, x in np.ndindex(self.mask.shape):
            planes = np.stack([m[y :: self.mask.shape[0], x :: self.mask.shape[1]] for m in mosaics])
            by_place[y, x] = propagation.without_trend(planes, TREND)
            free = 1 - propagation.terms(TREND) / planes[0].size  # independent noise: the trend took its share of the pixels
            found[y, x] = float(np.mean(by_place[y, x] ** 2)) / free
        model = self._model(self._signal())
        if not model:
            self.notes.append(f"{self._unsaid()}: predictions start from what was found")
        mosaic: dict[str, tuple[float | None, float, float]] = {}
        for channel in dict.fromkeys(str(c) for c in self.mask.ravel()):
            own = [p for p in by_place if str(self.mask[p]) == channel]
            error = propagation.standard_error_of_variance(np.concatenate([by_place[p][:, None] for p in own]), block=8)[0]
            value = float(np.mean([found[p] for p in own])) ** 0.5
            mosaic[channel] = (model[channel] ** 0.5 if model else None, value, float(error) / (2 * value) if value else 0.0)
        codes = self._codes()
        if codes and min(value for _, value, _ in mosaic.values()) * codes < 0.5:
            least = min(value for _, value, _ in mosaic.values()) * codes
            self.notes.append(f"noise is {least:.2g} DN: rounding of so little is no noise of its own, and the mosaic's prediction is off")
        full = float(np.mean([np.mean(m >= 0.999) for m in mosaics]))
        if full > FULL:
            self.notes.append(
                f"{100 * full:.2g} % of the pixels are full or at the top code: their noise is cut off, which no prediction knows"
            )
        report = NoiseReport(pipeline.name, reflectance, len(self.arrays), self._signal(), mosaic, notes=self.notes)
        flat = self._flat_mosaic(mosaics)
        for (stage, variable), answers in self._responses(flat, found, bool(model)).items():
            report.rows.append(self._row(stage, variable, answers))
        return report

    def _signal(self, rows: slice = slice(None), columns: slice = slice(None)) -> dict[str, float]:
        """Mean charge by channel in the window or a part of it, electron."""
        ref = next((r for r, found in self.arrays[0].items() if "expected_charge" in found), None)
        if ref is None:
            return {}
        charge = self.window(self.arrays[0][ref]["expected_charge"])
        tiles = np.tile(self.mask, (charge.shape[0] // self.mask.shape[0], charge.shape[1] // self.mask.shape[1]))
        charge, tiles = charge[rows, columns], tiles[rows, columns]
        return {str(c): float(charge[tiles == c].mean()) for c in dict.fromkeys(self.mask.ravel())}

    def _unsaid(self) -> str:
        """Why the noise of the mosaic is not predicted; '' where every stage in front of it says what it needs to."""
        drawing = {name: type(stage) for name, stage in self.before.items() if is_random(type(stage))}
        silent = [name for name, kind in drawing.items() if not issubclass(kind, Noisy) and not FLAWS & set(writes_of(kind))]
        if silent:
            return f"{silent[0]} draws random numbers and does not say how much noise that is"
        if not isinstance(self.before[self.first.name], Scaled):
            return f"{self.first.name} does not say what its scale is"
        return "" if self._signal() else "no stage writes expected_charge"

    def _model(self, signal: Mapping[str, float]) -> dict[str, float]:
        """Variance of a pixel of the linearised mosaic by channel, from what the stages in front of it say."""
        scale = self.before[self.first.name]
        if self._unsaid() or not isinstance(scale, Scaled):
            return {}
        noisy = [stage for stage in self.before.values() if isinstance(stage, Noisy)]
        remark = "noise of whole rows and columns is counted as if each pixel had its own"
        if any(stage.by_line and stage.variance(0.0) for stage in noisy) and remark not in self.notes:
            self.notes.append(remark)
        full = scale.electrons()
        return {channel: sum(stage.variance(charge) for stage in noisy) / full**2 for channel, charge in signal.items()}

    def _codes(self) -> float:
        """Digital numbers between black and 1, from what rounding adds; 0 without a converter."""
        scale = self.before[self.first.name]
        codes = [s for s in self.before.values() if isinstance(s, Noisy) and any(d.dtype != "float" for d in writes_of(type(s)).values())]
        return scale.electrons() / (12 * codes[0].variance(0.0)) ** 0.5 if codes and isinstance(scale, Scaled) else 0.0

    def _flat_mosaic(self, mosaics: list[Any]) -> Any:
        """A mosaic of even channels, as large as the frame."""
        flat = np.empty((self.rows, self.columns))
        for y, x in np.ndindex(self.mask.shape):
            place = (slice(y, None, self.mask.shape[0]), slice(x, None, self.mask.shape[1]))
            flat[place] = np.mean([m[place].mean() for m in mosaics])
        return flat

    def _places(self) -> list[tuple[tuple[int, int], float]]:
        """First pixels of cells, in the frame, at which answers are taken, so far apart that they do not meet, and their weights.

        The nodes of Gauss: with three a line, a gain that grows with the fifth power of the distance has its true mean.
        """
        lines = []
        for size, period in zip((self.rows, self.columns), self.mask.shape, strict=True):
            side = min(size - 2 * BORDER, LARGEST) // period * period
            start = (size - side) // 2 // period * period
            apart = 2 * REACH + 4 + 2 * period
            count = next((n for n, share in ((3, 0.387), (2, 0.577)) if share * side >= apart), 1)
            nodes, weights = np.polynomial.legendre.leggauss(count)
            lines.append([(start + round(0.5 * (1 + x) * side) // period * period, w / 2) for x, w in zip(nodes, weights, strict=True)])
        return [((y, x), float(v * w)) for y, v in lines[0] for x, w in lines[1]]

    def _responses(
        self, flat: Any, found: Mapping[tuple[int, int], float], modelled: bool
    ) -> dict[tuple[str, str], list[tuple[Any, Any, float]]]:
        """By picture, for several places of the frame: its answers to a step of one pixel, (place in the cell, channel, y, x), the
        variance of these pixels, and the weight of the place."""
        behind, (places, weights) = self._behind(), zip(*self._places(), strict=True)
        variance = [self._variance_at(place, found, modelled) for place in places]
        answers: dict[tuple[str, str], list[list[Any]]] = {}
        for y, x in np.ndindex(self.mask.shape):
            pair = []
            for sign in (1.0, -1.0):
                stepped = flat.copy()
                for place in places:
                    stepped[place[0] + y, place[1] + x] += sign * STEP
                pair.append(self._run(behind, stepped))
            for picture in pair[0]:
                step = (pair[0][picture] - pair[1][picture]) / (2 * STEP)
                for one, (row, column) in zip(answers.setdefault(picture, [[] for _ in places]), places, strict=True):
                    one.append(step[..., self._around(row, self.rows), self._around(column, self.columns)])
        return {
            picture: [(np.stack(one), v, w) for one, v, w in zip(own, variance, weights, strict=True)] for picture, own in answers.items()
        }

    @staticmethod
    def _around(middle: int, size: int) -> slice:
        return slice(max(0, middle - REACH), min(size, middle + REACH + 4))

    def _variance_at(self, place: tuple[int, int], found: Mapping[tuple[int, int], float], modelled: bool) -> Any:
        """Variance of the pixels of a cell, from the light there."""
        order = list(np.ndindex(self.mask.shape))
        if not modelled:
            return np.array([found[p] for p in order])
        parts = []
        for at, size, period in zip(place, (self.rows, self.columns), self.mask.shape, strict=True):
            side = min(size - 2 * BORDER, LARGEST) // period * period
            inside = at - (size - side) // 2 // period * period
            parts.append(slice(max(0, inside - 4 * period), inside + 5 * period))
        model = self._model(self._signal(*parts))
        return np.array([model[str(self.mask[p])] for p in order])

    def _reaching(self, name: str) -> set[str]:
        """A node, and all that it depends on."""
        needed = {name}
        for node in reversed(self.plan.nodes):
            needed |= {source for _, source, _ in node.inputs[0]} if node.name in needed else set()
        return needed

    def _behind(self) -> list[str]:
        """The nodes that depend on the mosaic."""
        reached = {self.first.name}
        for node in self.plan.nodes:
            if not node.is_probe and {source for _, source, _ in node.inputs[0]} & reached:
                reached.add(node.name)
        return [node.name for node in self.plan.nodes if node.name in reached - {self.first.name}]

    def _run(self, behind: list[str], mosaic: Any) -> dict[tuple[str, str], Any]:
        """The pictures that the stages behind make of another mosaic."""
        results = {ref: Result(arrays=dict(found)) for ref, found in self.arrays[0].items()}
        results[self.ref] = Result(arrays={**results[self.ref].arrays, MOSAIC: mosaic})
        found = {}
        for name in behind:
            ref: CellRef = (name, ())
            if ref not in self.jobs:
                continue
            results[ref], report = compute(self.jobs[ref], results)
            if report.status == "failed":
                raise RequestError(f"the stage {name!r} broke off on a flat field: {report.message.splitlines()[-1]}")
            for variable, array in results[ref].arrays.items():
                if variable in PICTURES:
                    found[name, variable] = np.asarray(array, np.float64)
        return found

    def _row(self, stage: str, variable: str, answers: list[tuple[Any, Any, float]]) -> StageNoise:
        labels = self.plan.cells[(stage, ())].grids[variable]["channel"]
        names = tuple(str(v) for v in labels.values())
        frames = np.stack([self.window(a[(stage, ())][variable]) for a in self.arrays])
        noise_of = propagation.without_trend(self._without_pattern(frames), TREND)
        slow = sum(w * propagation.slow_covariance(h, v) for h, v, w in answers)
        taken = slow * propagation.terms(TREND) / frames[0, 0].size  # what the trend took with it
        carried, beside = (
            np.asarray(sum(w * propagation.carried_covariance(h, v, lag) for h, v, w in answers)) for lag in ((0, 0), (0, 1))
        )
        found, found_beside = (propagation.found_covariance(noise_of, lag) + taken for lag in ((0, 0), (0, 1)))
        spreads = np.diag(carried), np.diag(found)
        shared = [propagation.correlation(c, s) for c, s in zip((carried, found), spreads, strict=True)]
        next_to = [propagation.correlation(c, s) for c, s in zip((beside, found_beside), spreads, strict=True)]
        errors = propagation.standard_error_of_variance(noise_of)
        pairs = [(i, j) for i in range(len(names)) for j in range(i + 1, len(names))]
        with np.errstate(invalid="ignore", divide="ignore"):
            found_error = errors / (2 * np.sqrt(spreads[1]))
        return StageNoise(
            stage, variable, names, np.sqrt(spreads[0]).tolist(), np.sqrt(spreads[1]).tolist(), found_error.tolist(),
            {f"{names[i]} {names[j]}": (float(shared[0][i, j]), float(shared[1][i, j])) for i, j in pairs},
            [(float(next_to[0][i, i]), float(next_to[1][i, i])) for i in range(len(names))],
        )  # fmt: skip

    def _without_pattern(self, frames: Any) -> Any:
        """Minus what repeats with the cell: a demosaicer may leave the mosaic's own pattern on a flat field."""
        mean = frames.copy()
        for y, x in np.ndindex(self.mask.shape):
            place = (..., slice(y, None, self.mask.shape[0]), slice(x, None, self.mask.shape[1]))
            mean[place] -= mean[place].mean(axis=(-2, -1), keepdims=True)
        return mean
