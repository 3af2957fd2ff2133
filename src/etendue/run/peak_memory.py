"""The peak memory of a run, above the interpreter, found by simulating its jobs without arrays.

In:  a plan, the number of workers, whether results stay in memory.
Out: ``Peak``: bytes, and the cell that holds most of them.

The simulated jobs are the jobs for the largest cells of a plan and their neighbours on its axes. Cells that are left
out need no memory, cells of a walk need memory for strips, and light computed by band needs memory for some bands.
Stages state their working memory (``Stage.working``); the working memory of transforms is computed here. Measured by
``benchmarks/memory.py``.
"""

from __future__ import annotations

import heapq
import itertools
import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from etendue.compute.job import Job
from etendue.compute.jobs import make_jobs
from etendue.compute.rows import has_rows
from etendue.compute.tables import LARGEST_CACHE, LARGEST_PATTERN, LARGEST_TRANSFORMS
from etendue.contract.capabilities import halo_of, is_random, is_source
from etendue.contract.stage import patterns_of
from etendue.plan import cost
from etendue.plan.ancestry import ancestry
from etendue.plan.model import CellRef, Plan
from etendue.plan.shown import shown_cells
from etendue.plugins.guests import is_guest
from etendue.run import schedulers
from etendue.run.batches import Batch, let_go, partition
from etendue.run.peak_segments import segment_bytes
from etendue.run.ready import Ready
from etendue.transfer.sampling import padded_size

if TYPE_CHECKING:
    pass

WITHOUT_BANDS = 3.0  # planes of float64 that a stage holds for all bands while it computes one of them
AROUND = 4  # combinations of a sweep that are simulated, per worker
LARGEST_CHUNK = 64 << 20  # bytes of stored data that are encoded at a time
SHOWN_WHOLE = 1 << 18  # samples of the coarsest picture that are kept of every picture (present.pictures.details.BAND)
SHOWN = 256  # samples per side up to which a picture is kept whole
_LOOK = object()  # arrays that are only looked at are reduced where they are computed
Piece = tuple[CellRef, str]  # a variable of a cell, or its transform


@dataclass
class Peak:
    """Peak memory: the total (bytes), the cell that needs most, and the bytes that this cell needs alone."""

    bytes: int
    ref: CellRef | None = None
    alone: int = 0


def workers_of(scheduler: str, workers: int) -> int:
    """Return the number of cells computed at once."""
    return 1 if schedulers.scheduler(scheduler).single else workers or os.cpu_count() or 1


def peak_memory(plan: Plan, workers: int = 1, in_memory: bool = False, pictures: bool = True) -> Peak:
    """Return the peak memory of computing a plan; ``pictures``: whether a cell of every stage is drawn."""
    jobs = _jobs(plan, workers, in_memory, pictures)
    if not jobs:
        return Peak(0)
    show = set(shown_cells(plan).values()) if pictures else set()
    found = _Run(plan.precision, jobs, show, in_memory, workers).peak()
    if in_memory:
        found.bytes += kept_bytes(plan)
    return found


def kept_bytes(plan: Plan) -> int:
    """Return the bytes of all kept variables."""
    kept = {node.name: [v for v in node.writes if (node.name, v) in plan.with_arrays] for node in plan.nodes}
    return sum(
        count * cost.cell_bytes(node, cell, plan.precision, kept[node.name])
        for node in plan.nodes
        if kept[node.name]
        for cell, count in cost.alike(plan.of(node.name))
    )


def job_bytes(job: Job, precision: str) -> tuple[float, float]:
    """Return the bytes needed to compute a single job beyond its input, and the bytes of its input or output, whichever
    is larger.
    """
    run = _Run(precision, {job.ref: job}, set(), True, 1)
    own = run.cell(job) + run.tables + sum(run.transforms)
    return own, run.largest(job)


def _jobs(plan: Plan, workers: int, in_memory: bool, pictures: bool) -> Mapping[CellRef, Job]:
    """Return the jobs of the largest cells and of some neighbours."""
    chosen = _chosen(plan, AROUND * workers)
    refs: list[CellRef] = [
        (node.name, index)
        for node in plan.nodes
        if node.name not in plan.seen_only
        for index in itertools.product(*(sorted(chosen[dim]) for dim in node.axes))
    ]
    todo = ancestry(plan, refs) if len(refs) < len(plan.cells) else set(refs)
    show = frozenset(ref for ref in shown_cells(plan).values() if pictures and ref in todo)
    looks: dict[CellRef, Any] = dict.fromkeys(show, _LOOK)
    place = (lambda ref, variable: True if (ref[0], variable) in plan.with_arrays else None) if in_memory else None
    return make_jobs(plan, todo, lambda cell: None, deliver_all=in_memory, show=show, place=place, looks=looks)


def _chosen(plan: Plan, most: int) -> dict[str, set[int]]:
    """Return positions on every axis: the positions of the largest cells, plus neighbours while there are few
    combinations.
    """
    largest: dict[str, int] = {}
    sizes = []
    for node in plan.nodes:
        every = [
            (cost.cell_bytes(node, cell, plan.precision), cell)
            for cell, _ in cost.alike(plan.of(node.name))
            if cell.left_out is None
        ]
        if every:
            size, cell = max(every, key=lambda one: one[0])
            sizes.append((size, node.axes, cell.index))
    for _, axes, index in sorted(sizes, key=lambda one: -one[0]):
        for dim, position in zip(axes, index, strict=True):
            largest.setdefault(dim, position)
    found = {axis.dim: {largest.get(axis.dim, 0)} for axis in plan.axes}
    count, order = 1, list(largest)  # first some values of the axis that the largest cells have, and then of the others
    for axis in sorted(plan.axes, key=lambda axis: order.index(axis.dim) if axis.dim in largest else len(order)):
        own, room = found[axis.dim], max((most // 2 if count == 1 else most) // count, 1)
        own |= set(itertools.islice((i for i in range(len(axis.values)) if i not in own), room - 1))
        count *= len(own)
    for one in plan.derived:
        found[one.dim] = {largest.get(one.dim, 0), *(one.places[i] for i in found[one.of])}
    return found


def _one_by_one(job: Job) -> int:
    """Return the number of slices into which the inputs of a mapped stage are divided (``compute.mapped``)."""
    if job.mapped is None or (job.stage.elementwise and not (is_random(type(job.stage)) and not job.averages)):
        return 1
    return math.prod(coordinate.size for _, coordinate in job.mapped.dims)


@dataclass
class _Batch:
    """The bytes that a batch holds while it runs, in addition to its input, and the results that it passes on."""

    most: float
    ref: CellRef
    alone: float
    after: dict[Piece, float] = field(default_factory=dict)


class _Run:
    """A simulated run of jobs without arrays."""

    def __init__(
        self, precision: str, jobs: Mapping[CellRef, Job], show: set[CellRef], in_memory: bool, workers: int
    ) -> None:
        self.precision, self.jobs, self.show, self.in_memory, self.workers = precision, jobs, show, in_memory, workers
        self.size = 4 if precision == "float32" else 8
        self.pieces: dict[CellRef, dict[Piece, float]] = {}  # bytes of the result of each cell
        self.tables, self.pictures = 0.0, 0.0
        self.transforms: list[float] = []  # bytes of cached transforms and transfer functions
        frames = [
            g["y"].size * g["x"].size
            for ref in show
            if ref in jobs
            for g in jobs[ref].grids.values()
            if "y" in g and "x" in g
        ]
        self.shown = min(1.0, SHOWN_WHOLE / min(frames, default=1))

    # -- all batches --------------------------------------------------------------------------------------------------

    def peak(self) -> Peak:
        """Return the peak memory of the simulated run: batches start as they become ready, as many at once as there are
        workers.
        """
        ready = Ready[dict[Piece, float]](partition(self.jobs), self.workers)
        under_way: list[tuple[float, int]] = []
        working: dict[int, _Batch] = {}
        best, now = Peak(0), 0.0
        while ready.heap or under_way:
            while len(under_way) < self.workers and (new := ready.next()) is not None:
                working[new.number] = self.through(new)
                heapq.heappush(under_way, (now + new.seconds, new.number))
            total = self.now(ready.results.values(), working.values())
            if total > best.bytes:
                most = max(working.values(), key=lambda one: one.most)
                best = Peak(int(total), most.ref, int(most.alone))
            now, number = heapq.heappop(under_way)
            ready.ended(ready.batches[number], working.pop(number).after)
        return best

    def now(self, held: Iterable[Mapping[Piece, float]], working: Iterable[_Batch]) -> float:
        """Return the bytes held while some batches run and others have passed on their results; each array is counted
        once.
        """
        standing: dict[Piece, float] = {}
        for own in held:
            standing |= own
        most = sum(standing.values()) + sum(one.most for one in working)
        cached = min(sum(self.transforms), max((LARGEST_TRANSFORMS, *self.transforms)))
        return most + min(self.tables + cached, LARGEST_CACHE) + self.pictures

    # -- one batch ----------------------------------------------------------------------------------------------------

    def through(self, batch: Batch) -> _Batch:
        """Return the memory of a batch, whose cells are simulated in order; each result is dropped after its last
        reader.
        """
        jobs, exports = batch.jobs, set(batch.exports)
        given = {piece for refs in batch.imports.values() for ref in refs for piece in self.pieces.get(ref, {})}
        readers = Counter(ref for job in jobs for ref in job.needs)
        live: set[CellRef] = set()
        best, done = _Batch(0.0, jobs[0].ref, 0.0), set[int]()
        for number, job in enumerate(jobs):
            before = self.held(live, given)
            if job.walk is None or job.walk.number not in done:
                members = [job] if job.walk is None else jobs[number : number + job.walk.members]
                need = self.cell(job) if job.walk is None else self.walk(members)
                best = max(best, _Batch(before + need, job.ref, need + self.read(members)), key=lambda one: one.most)
            if job.walk is not None:
                done.add(job.walk.number)
            live.add(job.ref)
            if job.ref in self.show:
                self.pictures += sum(
                    self.picture(job, v) for v, d in job.writes.items() if has_rows(d.dims) and v not in job.by_band
                )
            live.difference_update(let_go(job, readers, exports))
        best.after = {piece: size for ref in exports for piece, size in self.pieces.get(ref, {}).items()}
        return best

    def held(self, live: set[CellRef], given: set[Piece]) -> float:
        """Return the bytes of the ``live`` results except the pieces in ``given``; each array is counted once."""
        found: dict[Piece, float] = {}
        for ref in live:
            found |= self.pieces[ref]
        return sum(size for piece, size in found.items() if piece not in given)

    def read(self, jobs: Sequence[Job]) -> float:
        own = {job.ref for job in jobs}
        found: dict[Piece, float] = {}
        for job in jobs:
            for ref in job.needs:
                found |= self.pieces.get(ref, {}) if ref not in own else {}
        return sum(found.values())

    # -- one cell -----------------------------------------------------------------------------------------------------

    def bytes(self, job: Job, variable: str) -> float:
        return cost.bytes_of(job.writes[variable], job.grids[variable], self.precision)

    def picture(self, job: Job, variable: str) -> float:
        """Return the bytes kept for the picture of a variable: a small picture of three planes and, for a large frame,
        a share of its rows.
        """
        size = job.grids[variable]["y"].size, job.grids[variable]["x"].size
        return 12.0 * (
            min(size[0] * size[1], SHOWN * SHOWN) + (self.shown * size[0] * size[1] if max(size) > SHOWN else 0)
        )

    def cell(self, job: Job) -> float:
        """Return the bytes added while a cell is computed and stored; record the bytes of its result."""
        if job.left_out:
            own, working = self._left_out(job), 0.0
        elif job.segment is not None:
            own, working = segment_bytes(self, job)
        elif job.by_band:
            own = {(job.ref, v): self.bytes(job, v) for v in job.writes if v not in job.by_band}
            working = self.bands_made(job) * self.plane(job) if job.store else 0.0
        else:
            own = {(job.ref, v): self.bytes(job, v) for v in job.writes}
            working = self.working(job) + self.whole_of_bands(job)
            self.tables += self.patterns(job)
        self.pieces[job.ref] = {piece: size for piece, size in own.items() if piece[1] in job.deliver or not piece[1]}
        made = sum(size for piece, size in own.items() if piece[0] == job.ref)
        packed = [min(self.bytes(job, v), LARGEST_CHUNK) for v in job.store if v not in job.by_band]
        return made + max(working, 0.0 if self.in_memory else max(packed, default=0.0))

    def _left_out(self, job: Job) -> dict[Piece, float]:
        """Return the bytes, by piece, of the result of a cell that is left out: its input, and the transform of the
        stage before.
        """
        found = {
            piece: size
            for _, ref, variable in job.inputs
            for piece, size in self.pieces.get(ref, {}).items()
            if piece[1] == variable and variable in job.passes
        }
        if job.segment is not None and job.segment.previous is not None:
            found |= {piece: n for piece, n in self.pieces.get(job.segment.previous, {}).items() if not piece[1]}
        elif job.segment is not None:  # made by the first stage that needs it
            grid = job.input_grids[job.inputs[0][0]]
            found[job.ref, ""] = grid.bands().size * self.padded(job)
        return found

    def working(self, job: Job) -> float:
        """Return the working memory of a stage: the multiple that it states, times the larger of input and output, plus
        copies."""
        return self.factor(job) * self.largest(job) + self.copied(job)

    def copied(self, job: Job) -> float:
        """Return the bytes of the copies that a foreign stage gets (``compute.ownership.handed``): of its inputs, and
        of the arrays that it looks at.
        """
        if not is_guest(type(job.stage)):
            return 0.0
        seen = [(ref, what) for _, what, pairs in job.looking.ports for _, ref in pairs] if job.looking else []
        looked = sum(
            self.bytes(self.jobs[ref], what) for ref, what in seen if ref in self.jobs and what in self.jobs[ref].writes
        )
        return sum(self.size * grid.count for grid in job.input_grids.values()) / _one_by_one(job) + looked

    def largest(self, job: Job) -> float:
        """Return the larger of a stage's input and output in bytes, as floats, for one slice of its mapped dims."""
        read = sum(self.size * grid.count for grid in job.input_grids.values())
        written = sum(self.size * grid.count for grid in job.grids.values())
        return max(read, written) / _one_by_one(job)

    def factor(self, job: Job) -> float:
        """Return the stage's working memory as a multiple of the larger of its input and output; sources need more,
        because they compute in float64 first.
        """
        return job.stage.working + (2.0 if is_source(type(job.stage)) and self.size == 4 else 0.0)

    def whole_of_bands(self, job: Job) -> float:
        """Return the bytes of light that is computed by band but that a stage needs as a whole."""
        large = [
            self.size * g.count
            for port, ref, v in job.inputs
            if (g := job.input_grids.get(port)) and self._by_band(ref, v)
        ]
        seen = [(ref, what) for _, what, pairs in job.looking.ports for _, ref in pairs] if job.looking else []
        looked = [self.bytes(self.jobs[ref], what) for ref, what in seen if self._by_band(ref, what)]
        return float(sum(large) + 2 * max(looked, default=0.0))

    def _by_band(self, ref: CellRef, variable: str) -> bool:
        return ref in self.jobs and variable in self.jobs[ref].by_band

    def patterns(self, job: Job) -> float:
        """Return the bytes of cached fixed patterns."""
        if not patterns_of(type(job.stage)):
            return 0.0
        size = max(
            self.size * grid["y"].size * grid["x"].size for grid in job.grids.values() if "y" in grid and "x" in grid
        )
        return 0.0 if job.walk and size > LARGEST_PATTERN else size

    def plane(self, job: Job) -> float:
        """Return the bytes of the largest band of a cell's input and output."""
        grids = (*job.input_grids.values(), *job.grids.values())
        return float(max((self.size * g["y"].size * g["x"].size for g in grids if "y" in g and "x" in g), default=0))

    def padded(self, job: Job) -> float:
        """Return the bytes of a padded band; the half transform of the band takes about as many."""
        grids = [g for g in job.input_grids.values() if "y" in g and "x" in g]
        return float(max((self.size * padded_size(g["y"].size) * padded_size(g["x"].size) for g in grids), default=0))

    def bands_made(self, job: Job) -> float:
        """Return the number of bands held while one band is computed, including bands of earlier stages."""
        found = 1.0 + max(self.factor(job), WITHOUT_BANDS * 8 / self.size) + is_guest(type(job.stage))
        for _, ref, variable in job.inputs:
            if self._by_band(ref, variable) and not self.jobs[ref].store:
                found = max(found, 1.0 + self.bands_made(self.jobs[ref]))
        return found

    # -- walks --------------------------------------------------------------------------------------------------------

    def walk(self, members: Sequence[Job]) -> float:
        """Return the bytes of cells computed in strips: whole arrays that other cells need, and strips of all arrays in
        between.

        Memory freed by strips stays with the process (``run.memory``), also while their results are encoded.
        """
        whole, strips, working = 0.0, 0.0, 0.0
        for job in members:
            walk = job.walk
            assert walk is not None
            own = {(job.ref, v): self.bytes(job, v) for v in job.writes}
            placed = sum(own[job.ref, v] for v in walk.places if (job.ref, v) in own)
            whole += sum(own[job.ref, v] for v in walk.whole) - placed
            rows = next(job.grids[v]["y"].size for v, d in job.writes.items() if has_rows(d.dims))
            halo = 0 if job.left_out else halo_of(job.stage) or 0
            share = min((walk.rows + 2 * halo) / rows, 1.0)
            if not job.left_out:
                strips += share * sum(own.values())
                working = max(working, share * self.working(job))
                self.tables += self.patterns(job)
            self.pieces[job.ref] = {
                piece: size for piece, size in own.items() if piece[1] in walk.whole and piece[1] in job.deliver
            }
        packed = [min(self.bytes(job, v), LARGEST_CHUNK) for job in members for v in job.store]
        return whole + strips + working + (0.0 if self.in_memory else max(packed, default=0.0))
