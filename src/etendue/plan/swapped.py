"""A stage that an override has put in the place of another: what the file says of the other alone is left out.

In:  a pipeline with its overrides, the registry.
Out: the pipeline whose entries hold what their stages take, and a note for each that lost something.
"""

from __future__ import annotations

from dataclasses import replace

from etendue.errors import PluginError
from etendue.registry import Registry
from etendue.spec.pipeline import Pipeline, StageEntry
from etendue.spec.stage import parameters_of


def fitted_to_overrides(pipeline: Pipeline, registry: Registry) -> tuple[Pipeline, list[str]]:
    """As the sweep of a ``.use``, in which a stage's own table belongs to it alone; here what both stages take is kept."""
    notes: list[str] = []
    swapped = {key.removesuffix(".use") for key, _ in pipeline.overrides if key.endswith(".use")}
    if not swapped:
        return pipeline, notes
    entries = tuple(_fitted(one, pipeline, registry, notes) if one.name in swapped else one for one in pipeline.stages)
    return replace(pipeline, stages=entries), notes


def _fitted(entry: StageEntry, pipeline: Pipeline, registry: Registry, notes: list[str]) -> StageEntry:
    if entry.use not in registry:
        return entry
    try:
        declared = parameters_of(registry.load(entry.use))
    except PluginError:
        return entry
    given = {key for key, _ in pipeline.overrides}
    gone = [name for name in entry.values if name not in declared and f"{entry.name}.{name}" not in given]
    if not gone:
        return entry
    left = {name: value for name, value in entry.values.items() if name not in gone}
    kept = [name for name in left if f"{entry.name}.{name}" not in given]
    notes.append(
        f"{entry.name}: {entry.use} has no {', '.join(gone)}, which the file gives to the stage in its place: left out"
        + (f"; kept, as both have them: {', '.join(kept)}" if kept else "")
    )
    return replace(entry, values=left)
