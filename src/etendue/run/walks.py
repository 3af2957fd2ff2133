"""Which cells of large frames are computed together, strip by strip.

In:  the jobs of a run.
Out: the same jobs; those of a walk know it.

A walk is a chain of cells of one frame whose stages need no more than a few rows around a row (``Haloed``, or ``elementwise``). It ends
in front of a stage that needs the whole frame, and where a sweep forks. Walks hang together without circles: every cell has a depth,
which grows by one from a walk to whatever reads of it as a whole, and a walk holds cells of one depth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from etendue.plan.model import CellRef
from etendue.run.job import Job, Walk
from etendue.spec.capabilities import Probe, halo_of, is_source, is_transfer, joins_figures
from etendue.spec.grid import Grid
from etendue.spec.stage import reads_of

LARGEST_WHOLE = 1 << 21  # pixels of a frame up to which cells are computed whole
STRIP = 1 << 19  # pixels of a strip, about
TILE = 64  # rows: strips end with the tiles of patterns that belong to the sensor
HALOS = 16  # a strip has about so many times the rows of a halo: what is computed twice is an eighth

Frame = tuple[int, int]


@dataclass
class _Walker:
    """A cell that may be computed in strips: the frame it is of, and the rows around a row that it needs."""

    frame: Frame
    halo: int


def with_walks(jobs: dict[CellRef, Job], place: Callable[[CellRef, str], Any] | None = None) -> dict[CellRef, Job]:
    """Tell the jobs of each walk of it; ``place``: where the caller wants a variable put, which nobody else reads."""
    small: set[tuple[str, int, int]] = set()  # stages and grids whose frames are computed whole: most cells of a sweep share them
    walkers: dict[CellRef, _Walker] = {}
    for ref, job in jobs.items():
        alike = ref[0], id(job.grids), id(job.input_grids)
        if alike in small:
            continue
        if not is_large(job.grids, job.input_grids):
            small.add(alike)
        elif (walker := _walker(job)) is not None:
            walkers[ref] = walker
    if not walkers:
        return jobs
    readers = _readers(jobs)
    depth: dict[CellRef, int] = {}
    home: dict[CellRef, CellRef] = {}
    for ref, job in jobs.items():
        own = walkers.get(ref)
        joined = {need for need in job.needs if own and need in walkers and _walks_on(jobs, walkers, readers, need, job)}
        depth[ref] = max((depth[need] + (need in walkers and need not in joined) for need in job.needs), default=0)
        if own:
            home[ref] = ref
            for need in joined:
                if depth[need] == depth[ref]:
                    _merge(home, need, ref)
    walks: dict[CellRef, list[CellRef]] = {}
    for ref in walkers:
        walks.setdefault(_root(home, ref), []).append(ref)
    for number, members in enumerate(walks.values()):
        frame = walkers[members[0]].frame
        rows = max(STRIP // frame[1], *(HALOS * walkers[ref].halo for ref in members), TILE)
        inside = set(members)
        for ref in members:
            job = jobs[ref]
            whole = {*job.store, *(job.deliver if job.give is None else job.give)}
            others = {v for v in job.writes if readers.get((ref, v), set()) - inside}
            places = {v: found for v in whole - others if place and (found := place(ref, v)) is not None}
            seen = whole - others - set(job.store) if job.look else set()
            names, only = (tuple(v for v in job.writes if v in chosen) for chosen in ((whole | others) - seen, seen))
            job.walk = Walk(number, len(members), rows // TILE * TILE, names, only, places)
    return jobs


def has_rows(dims: tuple[str, ...]) -> bool:
    """Whether an array stands over the pixels of a frame."""
    return dims[-2:] == ("y", "x")


def is_large(grids: Mapping[str, Grid], input_grids: Mapping[str, Grid]) -> bool:
    """Whether a cell reads or writes a frame that is not to be whole."""
    every = (*grids.values(), *input_grids.values())
    return any("y" in grid and "x" in grid and grid["y"].size * grid["x"].size > LARGEST_WHOLE for grid in every)


def _walker(job: Job) -> _Walker | None:
    """What a job needs of its frame, where it is large and a few rows do."""
    kind = type(job.stage)
    if job.task != "compute" or job.expected or job.mapped or job.by_band or job.segment is not None or not job.inputs:
        return None
    if is_transfer(kind) or is_source(kind) or issubclass(kind, Probe):
        return None
    if job.looking and any(what != "transfer" for _, what, _ in job.looking.ports):
        return None
    ports = reads_of(kind)
    frames = {_frame(job.input_grids[port], ports[port].dims) for port, _, _ in job.inputs if port in ports and "y" in ports[port].dims}
    frames |= {_frame(job.grids[v], d.dims) for v, d in job.writes.items() if "y" in d.dims}
    if len(frames) != 1 or None in frames or not any(has_rows(d.dims) for d in job.writes.values()):
        return None
    (frame,) = frames
    if frame is None or frame[0] * frame[1] <= LARGEST_WHOLE:
        return None
    if job.left_out:
        read = {variable for _, _, variable in job.inputs}
        return _Walker(frame, 0) if read >= set(job.writes) else None
    halo = halo_of(job.stage)
    if halo is None or frame[0] < 2 * max(TILE, HALOS * halo):
        return None
    return _Walker(frame, halo)


def _frame(grid: Grid, dims: tuple[str, ...]) -> Frame | None:
    return (grid["y"].size, grid["x"].size) if has_rows(dims) else None


def _readers(jobs: Mapping[CellRef, Job]) -> dict[tuple[CellRef, str], set[CellRef]]:
    """Who reads a variable of a cell."""
    found: dict[tuple[CellRef, str], set[CellRef]] = {}
    for ref, job in jobs.items():
        read = {(source, variable) for _, source, variable in job.inputs}
        if job.looking:
            read |= {(source, what) for _, what, pairs in job.looking.ports if what != "transfer" for _, source in pairs}
        for each in (job.segment and job.segment.found, job.looking and job.looking.found, job.waiting and (job.waiting.found,)):
            read |= {(source, variable) for one in each or () for _, source, variable in one}
        if job.waiting:
            read |= {(word.ref, word.variable) for word in job.waiting.words}
        for one in read:
            found.setdefault(one, set()).add(ref)
    return found


def _walks_on(
    jobs: Mapping[CellRef, Job], walkers: Mapping[CellRef, _Walker], readers: Mapping[tuple[CellRef, str], set[CellRef]],
    need: CellRef, job: Job,
) -> bool:  # fmt: skip
    """Whether a job can go on from the strips of a cell that it reads: of the same frame, alone of its stage, and of rows only."""
    if walkers[need].frame != walkers[job.ref].frame or need in job.awaited or job.stage.negative == "clip":
        return False
    for _, source, variable in job.inputs:
        if source != need:
            continue
        if not has_rows(jobs[need].writes[variable].dims) and joins_figures(jobs[need].stage):
            return False
        if sum(ref[0] == job.ref[0] for ref in readers[source, variable]) > 1:
            return False
    return True


def _root(home: dict[CellRef, CellRef], ref: CellRef) -> CellRef:
    while home[ref] != ref:
        ref = home[ref]
    return ref


def _merge(home: dict[CellRef, CellRef], one: CellRef, other: CellRef) -> None:
    home[_root(home, other)] = _root(home, one)
