"""Quantities that earlier cells have found, put in the place of what stood for them while planning.

In:  a ``Job`` and the results it reads.
Out: the same job with every stage made again, and the words of its random numbers complete.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from etendue.compute.job import Found, Job
from etendue.contract.stage import Stage, quantities_of
from etendue.plan.asking import made
from etendue.plan.model import CellRef
from etendue.plan.words import line, seed_of

if TYPE_CHECKING:
    from etendue.compute.joined.segments import Result


def with_found(job: Job, results: Mapping[CellRef, Result], at: tuple[int, ...] = ()) -> Job:
    """The job with what was found; ``at``: the slice that is computed, of quantities that have a value for each."""
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
    """The stage of a job with what was found for it, or for a slice of it."""
    return (
        _made_again(job.stage, job.waiting.found, results, job, at) if job.waiting and job.waiting.found else job.stage
    )


def seed_found(job: Job, results: Mapping[CellRef, Result], at: tuple[int, ...]) -> bytes:
    """The words of a job's random numbers, complete."""
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
    """Most frames of a burst have the same words."""
    return seed_of(seed, node, set(lines))


@lru_cache(256)
def _closed(seed: bytes) -> frozenset[str]:
    """The lines of a seed whose values were known before the run."""
    return frozenset(seed.decode().split("\n")) - {""}


def _made_again(stage: Stage, found: Found, results: Mapping[CellRef, Result], job: Job, at: tuple[int, ...]) -> Stage:
    """A stage with the values that were found.

    Raises
    ------
    ValueError
        One is beyond the range of the quantity, or the stage refuses it.
    """
    if not found:
        return stage
    values = {field.name: getattr(stage, field.name) for field in fields(stage)}
    allowed = quantities_of(type(stage))
    for name, ref, variable in found:
        value = values[name] = _value(results, ref, variable, job, at)
        low, high = allowed[name].held or (value, value)
        if not (allowed[name].allows(value) and low <= value <= high):
            raise ValueError(
                f"{name} = {value:g}, which {ref[0]!r} has found, is out of range: {allowed[name].shown_range()}"
            )
    return made(type(stage), values)


def _value(results: Mapping[CellRef, Result], ref: CellRef, variable: str, job: Job, at: tuple[int, ...]) -> Any:
    """What a cell has found: a number, of a slice its own; where slices have ended behind it, all of them."""
    array = results[ref].arrays[variable]
    if at and job.mapped:
        array = array[tuple(at[i] for i in job.mapped.leading[ref[0], variable])]
    return float(array) if array.ndim == 0 else tuple(map(float, array.ravel()))
