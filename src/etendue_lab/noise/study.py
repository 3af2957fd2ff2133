"""``etendue noise``: noise propagated through a camera's stages, predicted and measured, for a flat grey scene.

In:  a pipeline as written, the reflectance of its flat scene, a number of frames.
Out: for each stage after the linearised mosaic the standard deviation of every channel, the correlation between
     channels and between neighbours: predicted from the camera's parameters and measured in noise frames.

Prediction: the variance of a mosaic pixel follows from the noise that earlier stages declare (`Noisy`: shot noise, read
noise, fixed patterns, rounding) and from the mosaic's scale (`Scaled`). The effect of later stages follows from their
response to a small step of one pixel at each position of the colour filter array, which works for any stage, plugins
included. Responses and variances are taken at several places of the frame, because a shading correction has a different
gain at each. The prediction is linear about the flat field: a stage that adapts to its picture, such as an adaptive
demosaicer, also adapts to real noise, and then both columns differ. Defective pixels are left out, since they are not
noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from etendue.contract.capabilities import Noisy
from etendue.contract.ports import Progress
from etendue.contract.registry import Registry
from etendue.contract.stage import writes_of
from etendue.errors import RequestError
from etendue.pipeline.derived import wanting
from etendue.pipeline.file import PipelineFile
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.session import Options, execute
from etendue.types.arrays import Array
from etendue_camera.colour import noise_propagation as propagation
from etendue_camera.roles import Scaled
from etendue_lab.compare.axis import one_camera
from etendue_lab.noise.flat_field import MOSAIC, FlatField, another, followed, in_front_of_grey
from etendue_lab.noise.report import NoiseReport, StageNoise

FULL = 0.001  # share of clipped pixels above which the measured noise is too small
TREND = 4  # degree of the polynomial removed before noise is measured: fall-off over a wide field is not noise


def noise(
    pipeline: PipelineFile,
    registry: Registry,
    reflectance: float = 0.18,
    frames: int = 4,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
) -> NoiseReport:
    """Predict and measure the noise of a camera after every stage.

    Parameters
    ----------
    pipeline : Pipeline
        Its scene is replaced by a flat one of the same size and light; a sweep is ignored.
    registry : Registry
    reflectance : float
        Reflectance of the flat scene, greater than 0 and at most 1.
    frames : int
        Number of noise frames, at least 1, each with its own fixed patterns.

    Raises
    ------
    RequestError
        The pipeline is invalid, the camera has no mosaic, or the picture is too small.
    """
    if not 0 < reflectance <= 1:
        raise RequestError(f"--reflectance {reflectance:g}: must be greater than 0 and at most 1")
    if frames < 1:
        raise RequestError(f"--frames {frames}: must be at least 1")
    alone, notes = one_camera(pipeline)
    flat = in_front_of_grey(alone, registry, reflectance)
    plan = make_plan(flat, registry, leave_out_allowed=False)
    chosen = followed(plan, notes, "noise", pipeline.file)
    wanted = (*chosen, MOSAIC, "expected_charge")
    places = [(n.name, v) for n in plan.nodes for v in n.writes if v in wanted and not n.is_probe]
    notes += plan.warnings
    flat = wanting(flat, places, exact=True)
    runs = [make_plan(another(flat, number), registry, leave_out_allowed=False) for number in range(frames)]
    outcomes = [execute(run, None, options, progress(run) if progress else None) for run in runs]
    for outcome in outcomes:
        if outcome.failed:
            report = outcome.failed[0]
            raise RequestError(f"stage {report.stage!r} failed: {report.message.splitlines()[-1]}", pipeline.file)
    if not any(n.is_random for n in runs[0].nodes):
        raise RequestError("no stage of the pipeline draws noise", pipeline.file)
    first = next(n for n in runs[0].nodes if MOSAIC in n.writes and MOSAIC not in {v for _, _, v in n.inputs[0]})
    arrays = [{ref: found for ref, found in outcome.arrays.items()} for outcome in outcomes]
    return _Measurement(runs[0], first, arrays, notes).report(flat, reflectance)


class _Measurement(FlatField):
    """Predictions and measurements after one node."""

    def report(self, pipeline: PipelineFile, reflectance: float) -> NoiseReport:
        mosaics = [self.window(a[self.ref][MOSAIC]) for a in self.arrays]
        found: dict[tuple[int, int], float] = {}
        by_place: dict[tuple[int, int], Array] = {}
        for y, x in np.ndindex(self.mask.shape):
            planes = np.stack([m[y :: self.mask.shape[0], x :: self.mask.shape[1]] for m in mosaics])
            by_place[y, x] = propagation.without_trend(planes, TREND)
            # for independent noise: correct for the noise that the fitted trend removes
            free = 1 - propagation.terms(TREND) / planes[0].size
            found[y, x] = float(np.mean(by_place[y, x] ** 2)) / free
        model = self.model(self.signal())
        if not model:
            self.notes.append(f"{self.unsaid()}: predictions start from measured values")
        mosaic: dict[str, tuple[float | None, float, float]] = {}
        for channel in dict.fromkeys(str(c) for c in self.mask.ravel()):
            own = [p for p in by_place if str(self.mask[p]) == channel]
            error = propagation.standard_error_of_variance(
                np.concatenate([by_place[p][:, None] for p in own]), block=8
            )[0]
            value = float(np.mean([found[p] for p in own])) ** 0.5
            mosaic[channel] = (
                model[channel] ** 0.5 if model else None,
                value,
                float(error) / (2 * value) if value else 0.0,
            )
        codes = self._codes()
        if codes and min(value for _, value, _ in mosaic.values()) * codes < 0.5:
            least = min(value for _, value, _ in mosaic.values()) * codes
            self.notes.append(
                f"noise is only {least:.2g} DN: rounding is then not independent noise, and the prediction of the "
                "mosaic is inaccurate"
            )
        full = float(np.mean([np.mean(m >= 0.999) for m in mosaics]))
        if full > FULL:
            self.notes.append(
                f"{100 * full:.2g} % of the pixels saturate: their noise is clipped, which the "
                f"prediction does not include"
            )
        report = NoiseReport(pipeline.name, reflectance, len(self.arrays), self.signal(), mosaic, notes=self.notes)
        flat = self.flat_mosaic(mosaics)
        for (stage, variable), answers in self.responses(flat, found, bool(model)).items():
            report.rows.append(self._row(stage, variable, answers))
        return report

    def _codes(self) -> float:
        """Return the number of codes between black and a linear value of 1, derived from the rounding noise; 0 without
        a converter.
        """
        scale = self.before[self.first.name]
        codes = [
            s
            for s in self.before.values()
            if isinstance(s, Noisy) and any(d.dtype != "float" for d in writes_of(type(s)).values())
        ]
        return scale.electrons() / (12 * codes[0].variance(0.0)) ** 0.5 if codes and isinstance(scale, Scaled) else 0.0

    def _row(self, stage: str, variable: str, answers: list[tuple[Array, Array, float]]) -> StageNoise:
        labels = self.plan.cells[(stage, ())].grids[variable]["channel"]
        names = tuple(str(v) for v in labels.values())
        frames = np.stack([self.window(a[(stage, ())][variable]) for a in self.arrays])
        noise_of = propagation.without_trend(self._without_pattern(frames), TREND)
        slow = sum(w * propagation.slow_covariance(h, v) for h, v, w in answers)
        taken = slow * propagation.terms(TREND) / frames[0, 0].size  # noise removed with the trend
        carried, beside = (
            np.asarray(sum(w * propagation.carried_covariance(h, v, lag) for h, v, w in answers))
            for lag in ((0, 0), (0, 1))
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
            stage,
            variable,
            names,
            np.sqrt(spreads[0]).tolist(),
            np.sqrt(spreads[1]).tolist(),
            found_error.tolist(),
            {f"{names[i]} {names[j]}": (float(shared[0][i, j]), float(shared[1][i, j])) for i, j in pairs},
            [(float(next_to[0][i, i]), float(next_to[1][i, i])) for i in range(len(names))],
        )

    def _without_pattern(self, frames: Array) -> Array:
        """Subtract the pattern that repeats with the mosaic cell, which a demosaicer may leave on a flat field."""
        mean = frames.copy()
        for y, x in np.ndindex(self.mask.shape):
            place = (..., slice(y, None, self.mask.shape[0]), slice(x, None, self.mask.shape[1]))
            mean[place] -= mean[place].mean(axis=(-2, -1), keepdims=True)
        return mean
