"""What each stage of an archived camera is owed of the lost contrast, SNR and colour, at one place of its sweep.

In:  the folder of an archive, values of its axes.
Out: the document of ``studies.losses`` for the camera that stands there, from the pipeline that the archive holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

from etendue.archive.again import recorded
from etendue.contract.registry import installed_stages
from etendue.contract.stage import parameters_of
from etendue.errors import EtendueError
from etendue.pipeline.derived import at_value
from etendue.pipeline.file import Pipeline
from etendue.result_files import finite
from etendue.types.documents import Document, Place
from etendue_lab.compare.axis import SENSOR
from etendue_lab.losses.study import RUNS, losses

ABOUT = (
    "The camera{at}: what a stage adds to a loss, averaged over all orders in which the stages of the ideal camera "
    "could be"
    " made real (Shapley values); the shares are of what is lost before others win it back, and a stage below 0 wins "
    "back. "
    "Contrast and signal-to-noise ratio are of a grey card, colour of the scene."
)


def losses_at(folder: Path, at: Place, told: Callable[[str], None] = lambda text: None, runs: int = RUNS) -> Document:
    """Shapley values of the camera at some values of its axes, ``{dim: value}``; ``why`` in their place where there are
    none.

    Only cameras of a grey card and, for colour, at most ``runs`` of the scene are computed; nothing of the archive is.
    """
    try:
        found: Document = finite(losses(camera_at(folder, at), installed_stages(), runs=runs, told=told).document())
    except EtendueError as error:
        return {"losses": [], "notes": [], "why": str(error).strip().split("\n")[-1]}
    shown = [{**loss, "value": loss["camera"]} for loss in found["losses"]]  # the word that whoever shows it knows
    return {**found, "losses": shown, "about": ABOUT, "why": ""}


def camera_at(folder: Path, at: Place) -> Pipeline:
    """The pipeline of an archive's last run without its sweep: every axis at one of its values.

    Raises
    ------
    ArchiveError
        Its record or an input is damaged or missing.
    RequestError
        The recorded pipeline cannot be read here.
    """
    run = recorded(folder)
    pipeline, axes = run.pipeline(), run.record["axes"]
    for key in sorted(pipeline.sweep, key=lambda key: key != SENSOR and not key.endswith(".use")):
        written, values = pipeline.sweep[key], list(axes.get(key, ()))  # what chooses first: the others are of that one
        value = at.get(key.removesuffix(".use").replace(".", "_"), values[0] if values else None)
        listed = isinstance(written, list) and value in values and len(written) == len(values)
        item = written[values.index(value)] if listed else Decimal(str(value)) if isinstance(value, float) else value
        if _taken(pipeline, key):
            pipeline = at_value(pipeline, key, item)
    return replace(pipeline, sweep={})


def _taken(pipeline: Pipeline, key: str) -> bool:
    """Whether there is a place for a value of an axis: of stages that another axis chooses, some may have none."""
    stage, _, name = key.rpartition(".")
    uses = [entry.use for entry in pipeline.stages if entry.name == stage]
    stages = installed_stages()
    return name == "use" or not any(use in stages and name not in parameters_of(stages.load(use)) for use in uses)
