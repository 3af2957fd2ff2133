"""Replace the placeholders used in planning by the quantities that earlier cells have found.

In:  a ``Job`` and the results it reads.
Out: the same job with its stages rebuilt and the words of its random seed complete.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from etendue.compute.job import Found, Job
from etendue.contract.stage import Stage, quantities_of
from etendue.plan.expansion.seed_words import line, seed_of
from etendue.plan.model import CellRef
from etendue.plan.stage_calls import made

if TYPE_CHECKING:
    from etendue.compute.joined.segments import Result


def with_found(job: Job, results: Mapping[CellRef, Result], at: tuple[int, ...] = ()) -> Job:
    """Return the job with the found values; ``at``: the slice being computed, for quantities with a value per slice."""
    if not job.awaited:
        return job
    segment, looking = job.segment, job.looking
    if segment and segment.found and segment.joined:
        segment = replace(segment, joined=_each(segment.joined, segment.found, results, job, at), found=())
    if looking and looking.found:
        looking = replace(looking, transfers=_each(looking.transfers, looking.found, results, job, at), found=())
    stage, seed = stage_found(job, results, at), seed_found(job, results, at)
    return replace(job, stage=stage, seed=seed, waiting=None, segment=segment, looking=looking)


def _each(
    stages: tuple[Stage, ...],
    found: tuple[Found, ...],
    results: Mapping[CellRef, Result],
    job: Job,
    at: tuple[int, ...],
) -> Any:
    return tuple(_made_again(stage, own, results, job, at) for stage, own in zip(stages, found, strict=True))


def stage_found(job: Job, results: Mapping[CellRef, Result], at: tuple[int, ...]) -> Stage:
    """Return the stage of a job with the values found for it, or for a slice of it."""
    return (
        _made_again(job.stage, job.waiting.found, results, job, at) if job.waiting and job.waiting.found else job.stage
    )


def seed_found(job: Job, results: Mapping[CellRef, Result], at: tuple[int, ...]) -> bytes:
    """Return a job's random seed, with the values that were unknown at planning filled in."""
    if not (job.waiting and job.waiting.words):
        return job.seed
    lines = set(_closed(job.seed))
    for word in job.waiting.words:
        value = _value(results, word.ref, word.variable, job, at)
        if value != word.default:
            lines.add(line(word.stage, word.name, value))
    return _seed_of(job.waiting.seed, job.ref[0], frozenset(lines))


@lru_cache(256)
def _seed_of(seed: int, node: str, lines: frozenset[str]) -> bytes:
    """Return the seed from its lines; cached, because most frames of a burst have the same words."""
    return seed_of(seed, node, set(lines))


@lru_cache(256)
def _closed(seed: bytes) -> frozenset[str]:
    """Return the lines of a seed whose values were known before the run."""
    return frozenset(seed.decode().split("\n")) - {""}


def _made_again(stage: Stage, found: Found, results: Mapping[CellRef, Result], job: Job, at: tuple[int, ...]) -> Stage:
    """Return a stage, made again with the quantities that earlier cells have computed.

    Raises
    ------
    ValueError
        A value is out of the range of the quantity, or the stage refuses it.
    """
    if not found:
        return stage
    values = {field.name: getattr(stage, field.name) for field in fields(stage)}
    allowed = quantities_of(type(stage))
    for name, ref, variable in found:
        value = values[name] = _value(results, ref, variable, job, at)
        low, high = allowed[name].held or (value, value)
        if not (allowed[name].allows(value) and low <= value <= high):
            raise ValueError(f"{name} = {value:g}, found by {ref[0]!r}, is out of range: {allowed[name].shown_range()}")
    return made(type(stage), values)


def _value(results: Mapping[CellRef, Result], ref: CellRef, variable: str, job: Job, at: tuple[int, ...]) -> Any:
    """Return what a cell has found, at this slice if it differs between slices: a number, or a tuple of numbers."""
    array = results[ref].arrays[variable]
    if at and job.mapped:
        array = array[tuple(at[i] for i in job.mapped.leading[ref[0], variable])]
    return float(array) if array.ndim == 0 else tuple(map(float, array.ravel()))
