"""The values that the last run into an archive chose for open parameters of a pipeline. Later runs keep these values.

In:  a pipeline as written, the folder of an archive.
Out: the pipeline with these values, and a note on each value that would now be chosen finer.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.archive.records.rerun import recorded
from etendue.contract.discretised import Discretised
from etendue.contract.registry import Registry
from etendue.errors import ArchiveError, RequestError
from etendue.pipeline.file import PipelineFile
from etendue.plan.planner import make_plan
from etendue.plan.wiring.automatic import Open, left_open, settled, with_chosen
from etendue.types.documents import Document, DocumentView

NEAR = 1e-9  # relative: values closer than this are equal


def with_kept_choices(
    pipeline: PipelineFile, registry: Registry, folder: Path | None
) -> tuple[PipelineFile, list[str]]:
    """Return the pipeline with the last run's values for all open parameters, and notes."""
    values = kept_choices(pipeline, registry, folder) if folder is not None else {}
    if not values:
        return pipeline, []
    kept = with_chosen(pipeline, values)
    anew = {entry.name: entry.values for entry in settled(pipeline, registry)[0].stages}
    moved = {s: {n: v for n, v in own.items() if abs(v - anew[s][n]) > NEAR * abs(v)} for s, own in values.items()}
    return kept, _notes(kept, registry, moved, anew, left_open(pipeline, registry)) if any(moved.values()) else []


def _notes(
    kept: PipelineFile, registry: Registry, moved: DocumentView, anew: Mapping[str, DocumentView], open_: Open
) -> list[str]:
    """Return a note on each value that would now be chosen finer."""
    try:
        plan = make_plan(kept, registry)
    except RequestError:
        return []  # the run itself raises it
    notes = []
    for stage, own in moved.items():
        one = plan.of(stage)[0].stage if any(node.name == stage for node in plan.nodes) else None
        if not isinstance(one, Discretised):
            continue
        for name, value in own.items():
            step = one.finer(open_[stage][name]).get(name, value) - value
            if (anew[stage][name] - value) * step > 0:
                notes.append(
                    f"{stage}.{name}: {value:.6g}, as chosen by an earlier run into this archive; now it would be "
                    f"{anew[stage][name]:.6g}: run into another archive for that"
                )
    return notes


def kept_choices(pipeline: PipelineFile, registry: Registry, folder: Path) -> dict[str, dict[str, float]]:
    """Return, by stage and parameter, the values of the last run; empty if there is no readable record of a run."""
    open_ = left_open(pipeline, registry)
    try:
        stages: list[Document] = tomllib.loads(recorded(folder).text)["stages"] if open_ else []
    except (ArchiveError, OSError, ValueError, KeyError):
        return {}
    uses = {entry.name: entry.use for entry in pipeline.stages}
    found: dict[str, dict[str, float]] = {}
    for one in stages:
        stage = str(one.get("name"))
        if stage in open_ and one.get("use") == uses[stage]:
            own = {name: float(one[name]) for name in open_[stage] if _is_number(one.get(name))}
            found |= {stage: own} if own else {}
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
