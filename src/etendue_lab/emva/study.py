"""``etendue emva``: measure a sensor as EMVA 1288 release 4 (linear) measures a camera, and compare it with the
declarations of its stages.

In:  a pipeline as written, or an archive with raw frames of uniform light and of the dark at several exposure times.
Out: for each channel the photon transfer curve and the metrics of the standard with 95 % intervals, and their expected
     values.

For a pipeline, raw frames are taken on a virtual bench. The scene is replaced by a uniform lamp; everything that bends,
spreads or weakens light by position (lens, fall-off, vignetting, angular response) is removed; defective pixels are
repaired. A small window of the sensor is read, two frames at each exposure time, in the light and in the dark. The lamp
has the spectrum of the scene's light and fills the most sensitive channel in the camera's integration time; less
sensitive channels get longer times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from etendue.archive.checks.describe import describe_archive
from etendue.archive.read.stored import Stored
from etendue.archive.records.rerun import recorded
from etendue.archive.structure.naming import cell_name
from etendue.contract.capabilities import is_source
from etendue.contract.ports import Progress
from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of, writes_of
from etendue.errors import RequestError
from etendue.pipeline.derived import free_name, stage_in_front, wanting, with_values, without_stages
from etendue.pipeline.file import PipelineFile, StageEntry
from etendue.plan.model import CellRef, Plan
from etendue.plan.planner import make_plan
from etendue.session import Options, execute
from etendue.types.documents import Document
from etendue_camera.roles import LENS, FlatScene
from etendue_lab.compare.axis import one_camera
from etendue_lab.emva.levels import RAW, lit, of_plan, raw_node, saturation
from etendue_lab.emva.report import EmvaReport
from etendue_lab.noise.flat_field import in_front_of_grey

SIDE = 192  # pixels of the window, along y and x
BY_PLACE = frozenset({*LENS, "falloff", "vignetting", "angular response"})
SERIES = frozenset({"bracketing", "metering"})  # roles that set how a frame is exposed
BELOW = tuple(np.linspace(0.035, 0.7, 11))  # fractions of saturation: the photon transfer curve
ABOVE = (0.75, 0.8, 0.85, 0.9, 0.93, 0.96, 0.98, 1.0, 1.02, 1.05, 1.1, 1.3, 1.6, 2.0)
FRAMES = 2
# Largest fraction of the full well that dark current may fill, at saturation and at the longest exposure time.
AT_FIRST, AT_LAST = (
    0.05,
    0.3,
)
DIM = 1e-3  # sensitivity relative to the best channel, below which a channel counts as blind
Told = Callable[[Plan], Progress] | None


def of_pipeline(
    pipeline: PipelineFile,
    registry: Registry,
    pixels: int = SIDE,
    options: Options | None = None,
    progress: Told = None,
) -> EmvaReport:
    """Simulate frames with the sensor of a pipeline and measure the sensor.

    Parameters
    ----------
    pipeline : Pipeline
        A sweep is ignored.
    registry : Registry
    pixels : int
        Height and width of the window, at least 16.

    Raises
    ------
    RequestError
        The pipeline is invalid, or the camera has no raw frames or no light.
    """
    if pixels < 16:
        raise RequestError(f"--pixels {pixels}: must be at least 16")
    alone, notes = one_camera(pipeline)
    bench = _on_the_bench(alone, registry)
    small = _windowed(bench, registry, pixels)
    plan = make_plan(_asking(small, registry, (1.0,), ()), registry, leave_out_allowed=False)
    notes += plan.warnings
    plan = make_plan(_lamp(small, registry, plan, options, notes), registry, leave_out_allowed=False)
    outcome = execute(plan, None, options, progress(plan) if progress else None)
    if outcome.failed:
        report = outcome.failed[0]
        raise RequestError(f"stage {report.stage!r} failed: {report.message.splitlines()[-1]}", pipeline.file)
    found = of_plan(plan, lambda ref: outcome.arrays[ref][RAW], options)
    return EmvaReport(pipeline.name, found, notes)


def of_archive(folder: Path, registry: Registry) -> EmvaReport:
    """Measure a sensor from the raw frames of an archive.

    Raises
    ------
    ArchiveError
        The path is not an archive, or the archive is damaged.
    RequestError
        The archive holds no raw light and dark frames at several exposure times.
    """
    describe_archive(folder)  # raises an error if the folder is not an archive or is damaged
    stored = Stored(folder)
    pipeline = recorded(folder).pipeline()
    plan = make_plan(pipeline, registry)
    node = raw_node(plan)
    names = {cell.ref: cell_name(plan, cell.ref) for cell in plan.of(node.name)}
    there = {ref for ref, name in names.items() if name in stored.finished}
    if (node.name, RAW) not in plan.kept or not there:
        raise RequestError(
            f"{folder} holds no raw frames: add {node.name}.raw to 'keep', or run etendue emva FILE, which "
            "simulates the frames that it needs"
        )

    def read(ref: CellRef) -> Any:
        return stored.cell(names[ref]).read(RAW)

    notes = []
    if len(there) < len(names):
        notes.append(f"{len(names) - len(there)} of {len(names)} cells are missing; their levels are omitted")
    if not any(issubclass(one.kind, FlatScene) for n in plan.nodes if n.is_source for one in n.alternatives):
        notes.append("the scene is not uniform: its contrast counts as a fixed pattern of the sensor")
    return EmvaReport(pipeline.name, of_plan(plan, read, None, there), notes)


def _on_the_bench(pipeline: PipelineFile, registry: Registry) -> PipelineFile:
    """Return the pipeline of the virtual bench: a lamp in place of the scene, no stage that changes light by position,
    no defective pixels, and no stage after the raw frame.
    """
    kinds = {entry.name: registry.load(entry.use) for entry in pipeline.stages if entry.use in registry}
    raw = [name for name, kind in kinds.items() if any(d.variable == RAW for d in writes_of(kind).values())]
    if not raw:
        raise RequestError(
            "no stage of the pipeline writes raw: a sensor is measured from its raw frames", pipeline.file
        )
    grey = in_front_of_grey(pipeline, registry, 1.0, but=("centre_y", "centre_x", "light"))
    last = [entry.name for entry in grey.stages].index(raw[-1])
    front = replace(grey, stages=grey.stages[: last + 1])
    out = {name for name, kind in kinds.items() if kind.role in BY_PLACE | SERIES and not is_source(kind)}
    camera = {**pipeline.shared, **({"noise": "independent"} if "noise" in pipeline.shared else {})}
    return wanting(replace(without_stages(front, out), shared=camera))


def _windowed(pipeline: PipelineFile, registry: Registry, pixels: int) -> PipelineFile:
    """Return the pipeline with a window of ``pixels`` x ``pixels`` and a scene just large enough for it. The pipeline
    is unchanged if the pixel stage has no parameters rows and columns.
    """
    asked = replace(_asking(pipeline, registry, (1.0,), ()), wanted=("photocurrent",))
    plan = make_plan(asked, registry, leave_out_allowed=False)
    node = next(
        (n for n in plan.nodes if n.kind.role == "pixel" and {"rows", "columns"} <= set(parameters_of(n.kind))), None
    )
    if node is None:
        return pipeline
    pitch = float(getattr(plan.of(node.name)[0].stage, "pixel_pitch"))  # noqa: B009
    window = {"sensor_height", "sensor_width", "first_row", "first_column", "window_rows", "window_columns", "sampling"}
    size = {"width": (pixels + 2) * pitch, "height": (pixels + 2) * pitch, "spacing": pitch}
    for source in (n.name for n in plan.nodes if n.is_source):
        pipeline = with_values(pipeline, source, size)
    return with_values(pipeline, node.name, {"rows": pixels, "columns": pixels}, window)


def _asking(
    pipeline: PipelineFile, registry: Registry, shares: tuple[float, ...], reflectances: tuple[float, ...]
) -> PipelineFile:
    """Insert a stage that makes a series of frames before the exposure; their exposure times are multiples of the
    camera's exposure time. Sweep over a bright and a dark scene.
    """
    use = next(registry.fitting(lambda kind: kind.role == "bracketing" and "brackets" in parameters_of(kind)), "")
    if not use:
        raise RequestError("no installed stage of the role 'bracketing' takes brackets")
    kinds = {e.name: registry.load(e.use) for e in pipeline.stages if e.use in registry}
    exposure = next((name for name, kind in kinds.items() if kind.role == "exposure"), "")
    if not exposure:
        raise RequestError("the pipeline has no stage of the role 'exposure'", pipeline.file)
    name = free_name("series", [entry.name for entry in pipeline.stages])
    values = {"repeats": FRAMES, "brackets": [float(np.log2(s)) for s in shares]}
    series = StageEntry(name, use, values, {}, "the series of exposures")
    scene = next(name for name, kind in kinds.items() if is_source(kind))
    sweep: Document = {f"{scene}.reflectance": list(reflectances)} if reflectances else {}
    return replace(stage_in_front(pipeline, exposure, series), sweep=sweep, wanted=(RAW,), keep=None)


def _lamp(
    pipeline: PipelineFile, registry: Registry, plan: Plan, options: Options | None, notes: list[str]
) -> PipelineFile:
    """Set the lamp so that the most sensitive channel reaches its full well in the camera's integration time. Choose
    exposure times that take every channel to saturation.
    """
    rates = lit(plan, options)
    well, dark, time = saturation(plan)
    best = max(rates.values())
    if not best > 0:  # the comparison is false for NaN, an unknown rate
        raise RequestError("the scene's light produces no photoelectrons: nothing to measure", pipeline.file)
    if not 0 < well < np.inf:
        raise RequestError(
            "no stage of the sensor declares its full well or the range of its converter: exposures cannot be chosen"
        )
    short = min(time, AT_FIRST * well / dark) if dark > 0 else time
    if short < time:
        notes.append(
            f"exposures are shorter than the camera's {time:.4g} s: in that time dark current alone gives "
            f"{dark * time:.4g} electrons"
        )
    factor = (well - dark * short) / (best * short)
    longest = AT_LAST * well / (dark * short) if dark > 0 else np.inf
    shares = {
        float(f"{share * best / rate:.6g}")
        for rate in rates.values()
        if rate > DIM * best
        for share in (*BELOW, *ABOVE)
    }
    levels = sorted(share * short / time for share in shares if share <= longest)
    asked = _asking(pipeline, registry, tuple(levels), (0, 1))
    source = next(n for n in plan.nodes if n.is_source)
    stage = plan.of(source.name)[0].stage
    word = next((w for w in ("radiance", "white_luminance") if getattr(stage, w, 0.0)), "")
    if not word:
        raise RequestError(f"{source.alternatives[0].use} has no brightness parameter")
    return with_values(asked, source.name, {word: getattr(stage, word) * factor})
