"""Decide which cells of large frames are computed together, strip by strip.

In:  the jobs of a run.
Out: the same jobs, with ``walk`` set for jobs that belong to a walk.

A walk is a set of connected cells of one frame whose stages need no more than a few rows around a row (``Haloed``, or
``elementwise``). It ends before a stage that needs the whole frame, and where a sweep forks. Walks must not depend on
each other in circles: every cell has a depth, which increases by one from a walk to each cell that reads its result as
a whole, and a walk contains cells of one depth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from etendue.compute.job import Job, Walk
from etendue.compute.rows import Walker, has_rows, is_large, rows_of
from etendue.contract.capabilities import Haloed
from etendue.plan.identity.once import Once
from etendue.plan.model import CellRef

if TYPE_CHECKING:
    from etendue.types.arrays import Array

    pass


def with_walks(
    jobs: dict[CellRef, Job],
    can: Callable[[CellRef], Walker | None],
    place: Callable[[CellRef, str], Array | bool | None] | None = None,
) -> dict[CellRef, Job]:
    """Set ``walk`` for the jobs that belong to a walk. ``can`` returns the frame and halo of a cell that can be
    computed from a few rows. ``place`` returns the caller's array for a variable that no cell reads.
    """
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
    """Return the cells that may be computed in strips."""
    large: Once[bool] = Once()  # most cells of a sweep share their grids
    found: dict[CellRef, Walker] = {}
    for ref, job in jobs.items():
        grids = job.grids, job.input_grids
        if large(grids, partial(is_large, *grids)) and job.task == "compute" and (walker := can(ref)) is not None:
            found[ref] = walker
    return found


def _together(
    jobs: Mapping[CellRef, Job],
    walkers: Mapping[CellRef, Walker],
    readers: Mapping[tuple[CellRef, str], set[CellRef]],
) -> list[list[CellRef]]:
    """Group cells into walks. The cells of a walk have the same depth, and each reads strips of another cell of the
    walk.

    A cell that reads a whole array from a walk is one level deeper than the walk, so that no two walks wait for each
    other.
    """
    depth: dict[CellRef, int] = {}
    home: dict[CellRef, CellRef] = {}  # union-find: each cell points towards the representative of its walk
    for ref, job in jobs.items():
        own = [need for need in job.needs if ref in walkers and need in walkers]
        joined = {need for need in own if _walks_on(jobs, walkers, readers, need, job)}
        depth[ref] = max((depth[need] + (need in walkers and need not in joined) for need in job.needs), default=0)
        if ref in walkers:
            home[ref] = ref
            for need in joined:
                # A shallower walk must end before another input of this cell can be read, so the cell cannot belong to
                # it.
                if depth[need] == depth[ref]:
                    home[_root(home, ref)] = _root(home, need)
    walks: dict[CellRef, list[CellRef]] = {}
    for ref in walkers:
        walks.setdefault(_root(home, ref), []).append(ref)
    return list(walks.values())


def _readers(jobs: Mapping[CellRef, Job]) -> dict[tuple[CellRef, str], set[CellRef]]:
    """Return the readers of each variable of each cell."""
    found: dict[tuple[CellRef, str], set[CellRef]] = {}
    for ref, job in jobs.items():
        for one in job.reads:
            found.setdefault(one, set()).add(ref)
    return found


def _walks_on(
    jobs: Mapping[CellRef, Job],
    walkers: Mapping[CellRef, Walker],
    readers: Mapping[tuple[CellRef, str], set[CellRef]],
    need: CellRef,
    job: Job,
) -> bool:
    """Return True if a job can continue from the strips of a cell that it reads: both have the same frame, the cell is
    the only one of its stage, and the job reads only arrays with rows.
    """
    if walkers[need].frame != walkers[job.ref].frame or need in job.awaited or job.stage.negative == "clip":
        return False
    for _, source, variable in job.inputs:
        if source != need:
            continue
        before = jobs[need].stage
        # known only once all rows have been computed
        whole = isinstance(before, Haloed) and type(before).joined is not Haloed.joined
        if whole and not has_rows(jobs[need].writes[variable].dims):
            return False
        if sum(ref[0] == job.ref[0] for ref in readers[source, variable]) > 1:
            return False
    return True


def _root(home: dict[CellRef, CellRef], ref: CellRef) -> CellRef:
    while home[ref] != ref:
        ref = home[ref]
    return ref
