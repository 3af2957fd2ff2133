"""Fit the table of a stage that an override has swapped: parameters that only the replaced stage takes are dropped.

In:  a pipeline with its overrides, the registry.
Out: the pipeline whose entries contain only parameters of their stages, and a note for each entry that lost some.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace

from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of
from etendue.errors import PluginError
from etendue.pipeline.file import PipelineFile, StageEntry


def fitted_to_overrides(pipeline: PipelineFile, registry: Registry) -> tuple[PipelineFile, list[str]]:
    """Return the pipeline in which swapped stages have only parameters that they accept, and notes on the dropped
    parameters. In a sweep of a ``.use``, all parameters in the table of the replaced stage are dropped; here the
    parameters that both stages accept are kept.

    A parameter that the stage of the file does not accept is also kept, so that it is reported as a fault.
    """
    notes: list[str] = []
    swapped = {key.removesuffix(".use") for key, _ in pipeline.overrides if key.endswith(".use")}
    if not swapped:
        return pipeline, notes
    before = _written(pipeline.text)
    entries = tuple(
        _fitted(one, before.get(one.name, ""), pipeline, registry, notes) if one.name in swapped else one
        for one in pipeline.stages
    )
    return replace(pipeline, stages=entries), notes


def _written(text: str) -> Mapping[str, str]:
    """Return the ``use`` that the file itself gives for each stage name."""
    stages = tomllib.loads(text).get("stages", [])
    return {str(one.get("name", one.get("use"))): str(one.get("use")) for one in stages if isinstance(one, dict)}


def _declared(use: str, registry: Registry) -> frozenset[str] | None:
    """Return the parameters of a stage; None if it cannot be loaded."""
    if use not in registry:
        return None
    try:
        return frozenset(parameters_of(registry.load(use)))
    except PluginError:
        return None


def _fitted(entry: StageEntry, before: str, pipeline: PipelineFile, registry: Registry, notes: list[str]) -> StageEntry:
    declared, former = _declared(entry.use, registry), _declared(before, registry)
    if declared is None:
        return entry
    given = {key for key, _ in pipeline.overrides}
    gone = [
        name
        for name in entry.values
        if name not in declared and (former is None or name in former) and f"{entry.name}.{name}" not in given
    ]
    if not gone:
        return entry
    left = {name: value for name, value in entry.values.items() if name not in gone}
    kept = [name for name in left if f"{entry.name}.{name}" not in given]
    notes.append(
        f"{entry.name}: {entry.use} has no {', '.join(gone)}, which the file gives to the stage it replaces: left out"
        + (f"; kept, as both have them: {', '.join(kept)}" if kept else "")
    )
    return replace(entry, values=left)
