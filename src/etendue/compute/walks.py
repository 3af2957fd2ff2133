"""Which cells of large frames are computed together, strip by strip.

In:  the jobs of a run.
Out: the same jobs; those of a walk know it.

A walk is a chain of cells of one frame whose stages need no more than a few rows around a row (``Haloed``, or
``elementwise``). It ends in front of a stage that needs the whole frame, and where a sweep forks. Walks hang together
without circles: every cell has a depth, which grows by one from a walk to whatever reads of it as a whole, and a walk
holds cells of one depth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from etendue.compute.job import Job, Walk
from etendue.compute.rows import Walker, has_rows, is_large, rows_of
from etendue.contract.capabilities import Haloed
from etendue.contract.stage import looks_at_stages
from etendue.plan.model import CellRef, told_by

if TYPE_CHECKING:
    pass


def with_walks(
    jobs: dict[CellRef, Job],
    can: Callable[[CellRef], Walker | None],
    place: Callable[[CellRef, str], Any] | None = None,
) -> dict[CellRef, Job]:
    """Tell the jobs of each walk of it; ``can``: what a cell needs of its frame, where a few rows do; ``place``: where
    the caller wants a variable put, which nobody else reads."""
    walkers = _walkers(jobs, can)
    if not walkers:
        return jobs
    readers = _readers(jobs)
    for number, members in enumerate(_together(jobs, walkers, readers)):
        rows = rows_of(walkers[members[0]].frame[1], [walkers[ref].halo for ref in members])
        inside = set(members)
        for ref in members:
            job = jobs[ref]
            whole = {*job.store, *(job.deliver if job.give is None else job.give)}
            others = {v for v in job.writes if readers.get((ref, v), set()) - inside}
            places = {v: found for v in whole - others if place and (found := place(ref, v)) is not None}
            seen = whole - others - set(job.store) if job.look else set()
            names, only = (tuple(v for v in job.writes if v in chosen) for chosen in ((whole | others) - seen, seen))
            job.walk = Walk(number, len(members), rows, names, only, places)
    return jobs


def _walkers(jobs: Mapping[CellRef, Job], can: Callable[[CellRef], Walker | None]) -> dict[CellRef, Walker]:
    """The cells that may be computed in strips."""
    small: set[tuple[str, tuple[int, int]]] = (
        set()
    )  # stages and grids of small frames: most cells of a sweep share them
    found: dict[CellRef, Walker] = {}
    for ref, job in jobs.items():
        alike = ref[0], told_by(job.grids, job.input_grids)
        if alike in small:
            continue
        if not is_large(job.grids, job.input_grids):
            small.add(alike)
        elif job.task == "compute" and (walker := can(ref)) is not None:
            found[ref] = walker
    return found


def _together(
    jobs: Mapping[CellRef, Job],
    walkers: Mapping[CellRef, Walker],
    readers: Mapping[tuple[CellRef, str], set[CellRef]],
) -> list[list[CellRef]]:
    """The cells of each walk: those of one depth that go on from each other's strips.

    A cell is one deeper than what it reads as a whole of a walk: so no walk waits for another that waits for it.
    """
    depth: dict[CellRef, int] = {}
    home: dict[CellRef, CellRef] = {}  # of a cell another one of its walk, at last of the one that stands for it
    for ref, job in jobs.items():
        own = [need for need in job.needs if ref in walkers and need in walkers]
        joined = {need for need in own if _walks_on(jobs, walkers, readers, need, job)}
        depth[ref] = max((depth[need] + (need in walkers and need not in joined) for need in job.needs), default=0)
        if ref in walkers:
            home[ref] = ref
            for need in joined:
                if depth[need] == depth[ref]:
                    home[_root(home, ref)] = _root(home, need)
    walks: dict[CellRef, list[CellRef]] = {}
    for ref in walkers:
        walks.setdefault(_root(home, ref), []).append(ref)
    return list(walks.values())


def _readers(jobs: Mapping[CellRef, Job]) -> dict[tuple[CellRef, str], set[CellRef]]:
    """Who reads a variable of a cell."""
    found: dict[tuple[CellRef, str], set[CellRef]] = {}
    for ref, job in jobs.items():
        read = {(source, variable) for _, source, variable in job.inputs}
        if job.looking:
            read |= {
                (source, what)
                for _, what, pairs in job.looking.ports
                if not looks_at_stages(what)
                for _, source in pairs
            }
        for each in (
            job.segment and job.segment.found,
            job.looking and job.looking.found,
            job.waiting and (job.waiting.found,),
        ):
            read |= {(source, variable) for one in each or () for _, source, variable in one}
        if job.waiting:
            read |= {(word.ref, word.variable) for word in job.waiting.words}
        for one in read:
            found.setdefault(one, set()).add(ref)
    return found


def _walks_on(
    jobs: Mapping[CellRef, Job],
    walkers: Mapping[CellRef, Walker],
    readers: Mapping[tuple[CellRef, str], set[CellRef]],
    need: CellRef,
    job: Job,
) -> bool:
    """Whether a job can go on from the strips of a cell that it reads: of the same frame, alone of its stage, and of
    rows only.
    """
    if walkers[need].frame != walkers[job.ref].frame or need in job.awaited or job.stage.negative == "clip":
        return False
    for _, source, variable in job.inputs:
        if source != need:
            continue
        before = jobs[need].stage
        whole = isinstance(before, Haloed) and type(before).joined is not Haloed.joined  # known when all rows are there
        if whole and not has_rows(jobs[need].writes[variable].dims):
            return False
        if sum(ref[0] == job.ref[0] for ref in readers[source, variable]) > 1:
            return False
    return True


def _root(home: dict[CellRef, CellRef], ref: CellRef) -> CellRef:
    while home[ref] != ref:
        ref = home[ref]
    return ref
