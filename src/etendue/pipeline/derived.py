"""A pipeline made of a pipeline: other values, other stages, fewer or more of them, other variables asked for.

In:  a pipeline as written, which stays as it is.
Out: another, of the same file.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from etendue.pipeline.file import Pipeline, StageEntry
from etendue.pipeline.presets import preset
from etendue.types.documents import DocumentView


def given(entry: StageEntry, values: DocumentView, but: Collection[str] = ()) -> StageEntry:
    """A stage with these values beside its own, of which those named in ``but`` are left out."""
    own = {name: value for name, value in entry.values.items() if name not in but}
    return replace(entry, values={**own, **values})


def each(pipeline: Pipeline, change: Callable[[StageEntry], StageEntry]) -> Pipeline:
    """Every stage as ``change`` gives it."""
    return replace(pipeline, stages=tuple(map(change, pipeline.stages)))


def with_values(pipeline: Pipeline, stage: str, values: DocumentView, but: Collection[str] = ()) -> Pipeline:
    """The stage of a name with these values, as ``given``."""
    return each(pipeline, lambda entry: given(entry, values, but) if entry.name == stage else entry)


def without_stages(pipeline: Pipeline, names: Collection[str]) -> Pipeline:
    """Without the stages of these names, which write what they read: who read from them reads what they read."""
    left = replace(pipeline, stages=tuple(entry for entry in pipeline.stages if entry.name not in names))
    return each(left, lambda entry: replace(entry, origin=origin_without(pipeline, entry, names)))


def origin_without(pipeline: Pipeline, entry: StageEntry, names: Collection[str]) -> dict[str, str]:
    """``from`` of a stage without those that are gone: what those read, else nothing, for the nearest writer."""
    by_name = {one.name: one for one in pipeline.stages}
    found = {}
    for port, source in entry.origin.items():
        while source in names:
            source = by_name[source].origin.get(port, "")
        if source:
            found[port] = source
    return found


def stage_in_front(pipeline: Pipeline, stage: str, entry: StageEntry) -> Pipeline:
    """One stage more, in front of the one of a name."""
    at = [one.name for one in pipeline.stages].index(stage)
    return replace(pipeline, stages=(*pipeline.stages[:at], entry, *pipeline.stages[at:]))


def free_name(name: str, taken: Collection[str]) -> str:
    """A name that no stage has."""
    while name in taken:
        name += "_"
    return name


def wanting(
    pipeline: Pipeline, places: Iterable[tuple[str, str]] | None = None, kept: bool = False, exact: bool = False
) -> Pipeline:
    """Computed for the variables ``(stage, variable)``, None: for all there are; stored is what is computed, or with
    ``kept`` these alone; ``exact``: in 64 bits.
    """
    wanted = None if places is None else tuple(f"{stage}.{variable}" for stage, variable in places)
    precision = "float64" if exact else pipeline.precision
    return replace(pipeline, wanted=wanted, keep=wanted if kept else None, precision=precision)


def at_value(pipeline: Pipeline, key: str, value: Any) -> Pipeline:
    """One value of an axis in the place where a file says it: a shared quantity, a preset, a stage, its parameter.

    A stage's own table goes with its own implementation, and not with others.
    """
    stage, _, name = key.rpartition(".")
    if stage:
        return each(pipeline, lambda entry: _standing(entry, name, value) if entry.name == stage else entry)
    word = pipeline.table.preset
    if not word or key != word:
        return replace(pipeline, shared={**pipeline.shared, name: value})
    table = {word: value} if isinstance(value, str) else value
    if not isinstance(table, Mapping):
        return pipeline  # a fault, which the planner reports
    own = {k: v for k, v in table.items() if k not in (word, "label")}
    named = str(table.get(word, pipeline.preset_name))
    values = preset(named, pipeline.table).values() if named else {}
    return replace(pipeline, preset_name=named, preset=values, shared={**pipeline.shared, **own})


def _standing(entry: StageEntry, name: str, value: Any) -> StageEntry:
    if name != "use":
        return given(entry, {name: value})
    table = dict(value) if isinstance(value, Mapping) else {"use": value}
    own = {k: v for k, v in table.items() if k not in ("use", "label")}
    use = str(table["use"])
    return replace(entry, use=use, values={**(entry.values if use == entry.use else {}), **own})
