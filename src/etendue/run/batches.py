"""Partition the jobs into batches: tasks of useful size without cyclic dependencies.

Each job is in exactly one batch. A job joins the batch of its newest input while that batch is small; otherwise it
starts a new batch after that batch, and its siblings join the new batch. Jobs whose newest inputs are in several
batches share one batch after all of these. Every batch has a level, and a batch has a higher level than all batches
from which it reads; cycles between batches are therefore impossible.
"""

from __future__ import annotations

import time
from array import array
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping, Set
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from etendue.compute.bands import elsewhere
from etendue.compute.cell import compute
from etendue.compute.given import Alike
from etendue.compute.job import Job
from etendue.compute.jobs import Jobs
from etendue.compute.joined.segments import Result
from etendue.compute.ownership import in_its_place, undisturbed
from etendue.compute.strips import walked
from etendue.contract.ports import CellReport
from etendue.errors import refused_by_the_machine
from etendue.plan.model import CellRef
from etendue.run.order import Needs
from etendue.types.arrays import CellArrays

TARGET_SECONDS = 0.1
LARGE = 1 << 20  # bytes of an array that is dropped after its last reader, before the others of its cell
Names = frozenset[str] | None  # variables of a cell; None for all
NOBODY: Mapping[CellRef, str] = MappingProxyType({})


@dataclass
class Batch:
    """Jobs that run one after the other in one task; ``of`` may create them on demand."""

    number: int
    level: int
    of: Mapping[CellRef, Job]
    refs: list[CellRef] = field(default_factory=list)
    seconds: float = 0.0
    inputs: set[int] = field(default_factory=set)
    exports: dict[CellRef, Names] = field(default_factory=dict)
    imports: dict[int, dict[CellRef, None]] = field(default_factory=dict)

    @property
    def jobs(self) -> list[Job]:
        return [self.of[ref] for ref in self.refs]

    @property
    def stages(self) -> tuple[str, ...]:
        """The names of the stages of the batch."""
        return tuple(dict.fromkeys(ref[0] for ref in self.refs))


def partition(jobs: Mapping[CellRef, Job], target_seconds: float = TARGET_SECONDS) -> list[Batch]:
    """Group jobs; every batch only needs batches of a lower level."""
    batches: list[Batch] = []
    behind: dict[tuple[int, ...], int] = {}  # the open batch after the batches that hold the newest inputs
    units = _Units(jobs)
    needs = Needs(len(units), units.needed)
    home = array("i", bytes(4 * len(units)))
    for unit in needs.depth_first():
        needed = {home[other] for other in needs.of(unit)}
        seconds = units.seconds(unit)
        if len(needed) == 1:
            newest: tuple[int, ...] = tuple(needed)
            level = batches[newest[0]].level
        else:
            level = max((batches[b].level for b in needed), default=-1)
            newest = tuple(sorted(b for b in needed if batches[b].level == level))
        open_ = (*(newest if len(newest) == 1 else ()), behind.get(newest))
        fits = (one for one in open_ if one is not None and batches[one].seconds + seconds <= target_seconds)
        chosen = next(fits, None)
        if chosen is None:
            chosen = len(batches)
            batches.append(Batch(chosen, level + 1, jobs))
            behind[newest] = chosen
        batch = batches[chosen]
        batch.refs += units.members(unit)
        batch.seconds += seconds
        home[unit] = chosen
        if needed <= {chosen}:
            continue
        for r in units.needs(unit):
            source = home[units.of(r)]
            if source != chosen:
                batch.inputs.add(source)
                batch.imports.setdefault(source, {})[r] = None
                names, known = units.read(unit, r), batches[source].exports.get(r, frozenset())
                batches[source].exports[r] = None if names is None or known is None else names | known
    return batches


class _Units:
    """Units of cells that are computed together, by number. A unit is a walk, at the position of its first cell, or one
    cell.
    """

    def __init__(self, jobs: Mapping[CellRef, Job]) -> None:
        self.together: dict[int, list[CellRef]] = {}  # the cells of each walk
        self.of: Callable[[CellRef], int]
        self.needs_of: Callable[[CellRef], tuple[CellRef, ...]]
        self.jobs = jobs
        if isinstance(jobs, Jobs):  # such jobs have no walks
            self.first, self.of, self.needs_of, self.seconds_of = list(jobs), jobs.place, jobs.needs, jobs.seconds
            return
        self.needs_of, self.seconds_of = (lambda ref: jobs[ref].needs), (lambda ref: jobs[ref].seconds)
        self.first = []
        numbers: dict[CellRef, int] = {}
        walks: dict[int, int] = {}
        for ref, job in jobs.items():
            unit = len(self.first) if job.walk is None else walks.setdefault(job.walk.number, len(self.first))
            if unit == len(self.first):
                self.first.append(ref)
            else:
                self.together.setdefault(unit, [self.first[unit]]).append(ref)
            numbers[ref] = unit
        self.of = numbers.__getitem__

    def __len__(self) -> int:
        return len(self.first)

    def members(self, unit: int) -> list[CellRef]:
        return self.together.get(unit) or [self.first[unit]]

    def needs(self, unit: int) -> tuple[CellRef, ...]:
        """Return the cells of other units that a unit reads."""
        if unit not in self.together:
            return self.needs_of(self.first[unit])
        own = set(self.together[unit])
        return tuple(dict.fromkeys(r for ref in self.together[unit] for r in self.needs_of(ref) if r not in own))

    def read(self, unit: int, ref: CellRef) -> Names:
        """Return the variables of a cell that a unit reads."""
        if isinstance(self.jobs, Jobs):
            return self.jobs.read_of(self.first[unit], ref)
        return frozenset(v for one in self.members(unit) for r, v in self.jobs[one].reads if r == ref)

    def needed(self, unit: int) -> set[int]:
        """Return the units that a unit reads."""
        return {self.of(ref) for ref in self.needs(unit)}

    def seconds(self, unit: int) -> float:
        if unit not in self.together:
            return self.seconds_of(self.first[unit])
        return sum(self.seconds_of(ref) for ref in self.together[unit])


@dataclass
class BatchResult:
    """The result of a batch: the results that later batches read, its reports, and arrays for the owner of the run."""

    results: dict[CellRef, Result]
    reports: tuple[CellReport, ...]
    kept: dict[CellRef, CellArrays]


Ended = tuple[Result, CellReport]


def _ahead(
    jobs: tuple[Job, ...],
    first: int,
    results: Mapping[CellRef, Result],
    doomed: Mapping[CellRef, str],
    at: Callable[[int], None] | None,
) -> dict[CellRef, Ended]:
    """Compute the cells of the walk that begins here together. Return {} if the walk is incomplete, or if one of its
    cells fails or must not be tried: every cell is then computed alone.
    """
    walk = jobs[first].walk
    assert walk is not None
    members = jobs[first : first + walk.members]
    complete = len(members) == walk.members and all(
        job.walk is not None and job.walk.number == walk.number for job in members
    )
    if not complete or any(job.ref in doomed for job in members):
        return {}
    ended = walked(members, results, None if at is None else lambda member: at(first + member))
    return {} if ended is None else {job.ref: one for job, one in zip(members, ended, strict=True)}


def _alone(
    job: Job,
    number: int,
    results: Mapping[CellRef, Result],
    began: float,
    doomed: Mapping[CellRef, str],
    at: Callable[[int], None] | None,
    groups: dict[str, Alike],
) -> Ended:
    """Compute a cell alone, unless it is known to fail."""
    if job.ref in doomed:
        return Result(failed=job.ref[0]), CellReport(*job.ref, "failed", message=doomed[job.ref])
    if at is not None:
        at(number)
    return compute(job, results, began, groups)


def _delivered(job: Job, result: Result) -> CellArrays:
    """Return the variables of a cell for the owner of the run. Arrays for which the owner has places are copied there
    while they are still in the processor's cache.
    """
    given = {v: a for v, a in result.arrays.items() if job.give is None or v in job.give}
    for variable, place in job.places.items():
        array = given.get(variable)
        if type(array) is not np.ndarray or type(place) is not np.ndarray or array.base is place.base:
            continue
        if array.shape == place.shape and array.dtype == place.dtype:
            place[...] = array
            given[variable] = place
    return given if job.look is None else job.look(given)


def _settle(jobs: tuple[Job, ...]) -> None:
    """Flush the arrays that the cells have written to their files; all cells write to one archive."""
    target = next((job.target for job in reversed(jobs) if job.store and job.target), None)
    if target is not None:
        with refused_by_the_machine():
            target.settle()


def let_go(job: Job, readers: Counter[CellRef], exports: Container[CellRef]) -> list[CellRef]:
    """Return the cells that no job reads after this one; ``readers``: the number of jobs that still read each cell."""
    needs = job.needs
    for ref in needs:
        readers[ref] -= 1
    return [ref for ref in (*needs, job.ref) if readers[ref] == 0 and ref not in exports]


def run_batch(
    jobs: tuple[Job, ...],
    exports: Mapping[CellRef, Names],
    imports: tuple[tuple[CellRef, ...], ...],
    deliver: Set[CellRef],
    *before: BatchResult,
    doomed: Mapping[CellRef, str] = NOBODY,
    at: Callable[[int], None] | None = None,
) -> BatchResult:
    """Run the jobs of one batch, dropping each array after its last reader.

    ``doomed``: cells that are known to fail, with the reason; they are not tried. ``at`` is called with the number of
    every job that starts.
    """
    results: dict[CellRef, Result] = {}
    for refs, source in zip(imports, before, strict=True):
        results.update({ref: source.results[ref].read_only() for ref in refs})
    with in_its_place():
        found = undisturbed(_in_order, jobs, results, exports, deliver, doomed, at)
    _settle(jobs)
    return found


def _in_order(
    jobs: tuple[Job, ...],
    results: dict[CellRef, Result],
    exports: Mapping[CellRef, Names],
    deliver: Set[CellRef],
    doomed: Mapping[CellRef, str],
    at: Callable[[int], None] | None,
) -> BatchResult:
    readers = Counter(ref for job in jobs for ref in job.needs)
    reports, kept = list[CellReport](), dict[CellRef, CellArrays]()
    ends: dict[int, list[tuple[CellRef, str]]] = {}  # by job: arrays that it is the last to read
    clock: float | None = None
    ahead: dict[CellRef, Ended] = {}  # cells of walks, computed together with an earlier cell
    groups: dict[str, Alike] = {}
    for number, job in enumerate(jobs):
        began = time.thread_time() if clock is None else clock
        if job.walk is not None and job.ref not in ahead:
            ahead |= _ahead(jobs, number, results, doomed, at)
            began = time.thread_time()
        walked_before = ahead.pop(job.ref, None)
        result, report = walked_before or _alone(job, number, results, began, doomed, at, groups)
        clock = None if job.walk or (job.store and job.target) or elsewhere.seconds else began + report.seconds
        results[job.ref] = result
        reports.append(report)
        if job.ref in deliver:
            kept[job.ref] = _delivered(job, result)
            clock = clock if job.look is None else None  # the caller's reduction is not counted as run time
        for end, piece in _ends(jobs, number, result, exports):
            ends.setdefault(end, []).append(piece)
        for ref in let_go(job, readers, exports):
            results.pop(ref, None)
        for ref, variable in ends.pop(number, ()):
            if ref in results:
                results[ref].arrays.pop(variable, None)
    return BatchResult({ref: results[ref] for ref in exports if ref in results}, tuple(reports), kept)


def _ends(
    jobs: tuple[Job, ...], number: int, result: Result, exports: Mapping[CellRef, Names]
) -> Iterator[tuple[int, tuple[CellRef, str]]]:
    """Yield, for each array of a job that no later batch reads, the number of the job that reads it last, and the
    array.
    """
    if len(result.arrays) < 2 or not any(
        isinstance(a, np.ndarray) and a.nbytes >= LARGE for a in result.arrays.values()
    ):
        return
    ref = jobs[number].ref
    names = exports.get(ref, frozenset())
    if names is None:
        return
    for variable in result.arrays:
        if variable not in names:
            last = (n for n in reversed(range(number, len(jobs))) if n == number or (ref, variable) in jobs[n].reads)
            yield next(last), (ref, variable)
