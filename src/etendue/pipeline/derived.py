"""A pipeline derived from another: other values, other stages, fewer or more of them, other wanted variables.

In:  a pipeline as written, which is not changed.
Out: another pipeline of the same file.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

from etendue.pipeline.file import PipelineFile, StageEntry
from etendue.pipeline.presets import preset_at
from etendue.pipeline.zipped import SAMPLE
from etendue.types.documents import DocumentView


def given(entry: StageEntry, values: DocumentView, but: Collection[str] = ()) -> StageEntry:
    """Return a stage with these values added to its own, without the values named in ``but``."""
    own = {name: value for name, value in entry.values.items() if name not in but}
    return replace(entry, values={**own, **values})


def unswept(pipeline: PipelineFile) -> PipelineFile:
    """Return the pipeline without its sweep and design."""
    return replace(pipeline, sweep={}, zipped={}, design={}, rows={})


def with_rows(pipeline: PipelineFile, dim: str, rows: Sequence[int]) -> PipelineFile:
    """Return the pipeline with only these rows of a dim that several axes share."""
    if dim != SAMPLE:
        return replace(pipeline, rows={**pipeline.rows, dim: tuple(rows)})
    design = {**pipeline.design, "rows": list(rows)}
    saltelli = design.get("method") == "saltelli"
    per_point = 2 + sum(one.dim == SAMPLE for one in pipeline.zipped.values()) if saltelli else 1
    whole = list(rows) == list(range(len(rows))) and len(rows) % per_point == 0
    if whole and design.get("method") not in ("lhs", "list"):  # a shorter design has the first rows of a longer one
        del design["rows"]
        design["points"] = len(rows) // per_point
    return replace(pipeline, rows={**pipeline.rows, dim: tuple(rows)}, design=design)


def each(pipeline: PipelineFile, change: Callable[[StageEntry], StageEntry]) -> PipelineFile:
    """Return the pipeline with ``change`` applied to every stage."""
    return replace(pipeline, stages=tuple(map(change, pipeline.stages)))


def with_values(pipeline: PipelineFile, stage: str, values: DocumentView, but: Collection[str] = ()) -> PipelineFile:
    """Return the pipeline with these values for the named stage, as in ``given``."""
    return each(pipeline, lambda entry: given(entry, values, but) if entry.name == stage else entry)


def without_stages(pipeline: PipelineFile, names: Collection[str]) -> PipelineFile:
    """Return the pipeline without these stages, which must write the variable they read; later stages then read their
    input.
    """
    left = replace(pipeline, stages=tuple(entry for entry in pipeline.stages if entry.name not in names))
    return each(left, lambda entry: replace(entry, origin=origin_without(pipeline, entry, names)))


def origin_without(pipeline: PipelineFile, entry: StageEntry, names: Collection[str]) -> dict[str, str]:
    """Return the key ``from`` of a stage after its sources were removed: each removed source is replaced by the source
    from which it read, or left to the default.
    """
    by_name = {one.name: one for one in pipeline.stages}
    found = {}
    for port, source in entry.origin.items():
        while source in names:
            source = by_name[source].origin.get(port, "")
        if source:
            found[port] = source
    return found


def stage_in_front(pipeline: PipelineFile, stage: str, entry: StageEntry) -> PipelineFile:
    """Return the pipeline with one more stage in front of the named one."""
    at = [one.name for one in pipeline.stages].index(stage)
    return replace(pipeline, stages=(*pipeline.stages[:at], entry, *pipeline.stages[at:]))


def free_name(name: str, taken: Collection[str]) -> str:
    """Return a name that no stage has, by appending underscores."""
    while name in taken:
        name += "_"
    return name


def wanting(
    pipeline: PipelineFile, places: Iterable[tuple[str, str]] | None = None, kept: bool = False, exact: bool = False
) -> PipelineFile:
    """Return the pipeline with the wanted variables ``(stage, variable)``; None: the default variables. All computed
    variables are stored or, with ``kept``, only the wanted variables. ``exact``: everything is computed in 64 bits.
    """
    wanted = None if places is None else tuple(f"{stage}.{variable}" for stage, variable in places)
    precision = "float64" if exact else pipeline.precision
    return replace(pipeline, wanted=wanted, keep=wanted if kept else None, precision=precision)


def at_value(pipeline: PipelineFile, key: str, value: object) -> PipelineFile:
    """Return the pipeline with one value of an axis written where it belongs: a shared quantity, a preset, a stage or a
    parameter.

    If the value selects another implementation of a stage, the parameters in that stage's table of the file are
    dropped, because they belong to the previous one.
    """
    stage, _, name = key.rpartition(".")
    if stage:
        return each(pipeline, lambda entry: _standing(entry, name, value) if entry.name == stage else entry)
    word = key
    if word not in pipeline.table.words():
        return replace(pipeline, shared={**pipeline.shared, name: value})
    table = {word: value} if isinstance(value, str) else value
    if not isinstance(table, Mapping):
        return pipeline  # a fault, which the planner reports
    own = {k: v for k, v in table.items() if k not in (word, "label")}
    named = str(table.get(word, pipeline.named.get(word, "")))
    values = preset_at(named, pipeline.table.kind_of(word), pipeline.folder).values() if named else {}
    return replace(
        pipeline,
        named={**pipeline.named, word: named},
        presets={**pipeline.presets, word: values},
        shared={**pipeline.shared, **own},
    )


def _standing(entry: StageEntry, name: str, value: object) -> StageEntry:
    if name != "use":
        return given(entry, {name: value})
    table = dict(value) if isinstance(value, Mapping) else {"use": value}
    own = {k: v for k, v in table.items() if k not in ("use", "label")}
    use = str(table["use"])
    return replace(entry, use=use, values={**(entry.values if use == entry.use else {}), **own})
