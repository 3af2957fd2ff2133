"""Each stage's share of the lost contrast, SNR and colour of an archived camera, at one position of its sweep.

In:  the folder of an archive, values of its axes.
Out: the document of ``losses.study`` for that camera, from the pipeline that the archive holds.
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from pathlib import Path

from etendue.archive.records.rerun import recorded
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.errors import EtendueError
from etendue.pipeline.derived import at_value, unswept
from etendue.pipeline.file import PipelineFile
from etendue.plan.designs.drawing import with_design
from etendue.result_files import finite
from etendue.types.documents import AxisValues, Document
from etendue_lab.compare.axis import SENSOR
from etendue_lab.losses.study import RUNS, losses

ABOUT = (
    "Shares of the loss of the camera{at} are Shapley values: the loss that a stage adds, averaged over all "
    "orders in which ideal stages can be replaced by real ones. They are relative to the loss before other "
    "stages reduce it; a stage below 0 reduces the loss. Contrast and signal-to-noise ratio are computed for a "
    "grey card, colour for the scene."
)


def losses_at(
    folder: Path, at: AxisValues, told: Callable[[str], None] = lambda text: None, runs: int = RUNS
) -> Document:
    """Return the Shapley values of the camera at given values of its axes, ``{dim: value}``; if they cannot be
    computed, the reason under ``why``.

    One camera is run with a grey card and, for colour, at most ``runs`` cameras with the scene. The archive itself is
    not recomputed.
    """
    try:
        found: Document = finite(losses(camera_at(folder, at), installed_stages(), runs=runs, told=told).document())
    except EtendueError as error:
        return {"losses": [], "notes": [], "why": str(error).strip().split("\n")[-1]}
    shown = [{**loss, "value": loss["camera"]} for loss in found["losses"]]  # the key that the page and plots expect
    return {**found, "losses": shown, "about": ABOUT, "why": ""}


def camera_at(folder: Path, at: AxisValues) -> PipelineFile:
    """Return the pipeline of an archive's last run without its sweep: every axis at one of its values.

    Raises
    ------
    ArchiveError
        Its record or an input is damaged or missing.
    RequestError
        The recorded pipeline cannot be read here.
    """
    run = recorded(folder)
    pipeline, axes = with_design(run.pipeline(), installed_stages()), run.record["axes"]
    for key in sorted(pipeline.sweep, key=lambda key: key != SENSOR and not key.endswith(".use")):
        written, values = (
            pipeline.sweep[key],
            list(axes.get(key, ())),
        )  # choices of stages and presets first, because others refer to them
        if one := pipeline.zipped.get(key):
            row = at.get(one.dim, (axes.get(one.dim) or [0])[0])
            if _taken(pipeline, key):
                pipeline = at_value(pipeline, key, written[one.at[int(str(row))]])
            continue
        value = at.get(key.removesuffix(".use").replace(".", "_"), values[0] if values else None)
        listed = isinstance(written, list) and value in values and len(written) == len(values)
        item = written[values.index(value)] if listed else Decimal(str(value)) if isinstance(value, float) else value
        if _taken(pipeline, key):
            pipeline = at_value(pipeline, key, item)
    return unswept(pipeline)


def _taken(pipeline: PipelineFile, key: str) -> bool:
    """Return whether the value of an axis applies. It does not if another axis has chosen a stage without this
    parameter.
    """
    stage, _, name = key.rpartition(".")
    uses = [entry.use for entry in pipeline.stages if entry.name == stage]
    stages = installed_stages()
    return name == "use" or not any(use in stages and name not in parameters_of(stages.load(use)) for use in uses)
