"""A walk: cells of one large frame computed together, strip by strip, so that arrays between them are never held whole.

In:  the jobs of a walk and the results they read.
Out: results and reports, with the same bits as from computing the cells one by one.

Every cell advances as far as the available input rows allow, and only the rows that are needed again are kept. If a
strip fails, the walk has no result and its cells are computed one by one, which reports the error.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from etendue.compute import rows as strips
from etendue.compute.cell import check, kept, undefined
from etendue.compute.form import Output, form_of
from etendue.compute.found import with_found
from etendue.compute.given import Clipped, beside, clipped_figures, looked_through
from etendue.compute.job import Job
from etendue.compute.joined.segments import Result
from etendue.compute.ownership import for_reading, frozen, guests_of, handed, undisturbed
from etendue.compute.rounded import handed_on
from etendue.compute.rows import has_rows
from etendue.compute.tables import PatternRandom
from etendue.contract.arrays.grid import Line
from etendue.contract.capabilities import Haloed, halo_of
from etendue.contract.ports import CellReport
from etendue.contract.stage import patterns_of, reads_of
from etendue.errors import ArchiveInUse, MachineError
from etendue.interrupts import is_ours
from etendue.plan.model import CellRef
from etendue.types.arrays import Array, CellArrays

Results = Mapping[CellRef, Result]
Ended = list[tuple[Result, CellReport]]


class _Unfit(Exception):
    """The cells must be computed whole, because a stage refuses its input or a value is found only during the run."""


def walked(jobs: Sequence[Job], results: Results, at: Callable[[int], None] | None = None) -> Ended | None:
    """Compute the cells of a walk; return None if they must be computed one by one. ``at`` is called with the number of
    the cell in progress.
    """
    # A failed input concerns only the cells that read it. Computed one by one, the other cells get their results.
    if any(ref in results and results[ref].failed for job in jobs for ref in job.needs):
        return None
    try:
        return in_strips(jobs, results, at)
    except (MachineError, ArchiveInUse):
        raise
    except BaseException as error:  # the cell fails again when it is computed alone, and is reported then
        if is_ours(error):
            raise
        return None


def in_strips(jobs: Sequence[Job], results: Results, at: Callable[[int], None] | None = None) -> Ended:
    """Compute the cells of a walk; exceptions of stages are raised."""
    return undisturbed(_walked, jobs, results, at)


def _walked(jobs: Sequence[Job], results: Results, at: Callable[[int], None] | None) -> Ended:
    flows: dict[tuple[CellRef, str], _Flow] = {}
    members: list[_Member] = []
    for number, job in enumerate(jobs):
        began = time.thread_time()
        member = _Member(number, job if job.left_out else with_found(job, results), job, results, flows)
        flows |= {(job.ref, variable): flow for variable, flow in member.flows.items()}
        member.seconds += time.thread_time() - began
        members.append(member)
    try:
        for front in _fronts(members[0]):
            for member in members:
                began = time.thread_time()
                if member.reach(front) > member.next:
                    if at is not None:
                        at(member.number)
                    member.go_on(front)
                member.seconds += time.thread_time() - began
            for flow in flows.values():
                flow.forget()
        return [member.ended() for member in members]
    finally:
        for flow in flows.values():
            # Flows and members refer to each other. Without this, whole frames stay until the garbage collector runs.
            flow.readers.clear()


def _fronts(member: _Member) -> Iterator[int]:
    """Yield the rows at which strips end: boundaries of fixed-pattern tiles, so that no tile is drawn twice."""
    walk = member.job.walk
    assert walk is not None
    # The first strip is shorter if the window starts inside a tile, so that all others start at tile boundaries.
    front = walk.rows - member.first_row % strips.TILE
    while front < member.total:
        yield front
        front += walk.rows
    yield member.total


@dataclass(eq=False)
class _Flow:
    """A variable that is written and read row by row; ``whole``: the array of all rows, if it is needed outside the
    walk.
    """

    whole: Any = None
    parts: list[tuple[int, int, Array]] = field(default_factory=list)
    end: int = 0
    readers: list[_Member] = field(default_factory=list)
    undefined: bool = False
    seen: Any = None  # collects a small result from the rows, if the caller wants only that
    figure: Any = None  # for a variable without rows: its value from the first strip

    def put(self, start: int, stop: int, rows: Array) -> None:
        if self.whole is not None:
            self.whole[..., start:stop, :] = rows
        if self.seen is not None:
            self.seen.take(start, rows)
        if self.readers:
            self.parts.append((start, stop, rows))
        self.end = stop

    def rows(self, start: int, stop: int) -> Any:
        """Return rows as a contiguous, read-only array."""
        found = [(first, last, rows) for first, last, rows in self.parts if first < stop and last > start]
        if len(found) == 1 and found[0][:2] == (start, stop):
            return found[0][2]
        cut = [rows[..., max(start - first, 0) : stop - first, :] for first, _, rows in found]
        return frozen(np.concatenate(cut, axis=-2) if len(cut) > 1 else cut[0].copy(order="C"))

    def forget(self) -> None:
        """Drop rows that no reader needs again."""
        needed = min((reader.next - reader.halo - 1 for reader in self.readers), default=self.end)
        self.parts = [part for part in self.parts if part[1] > needed]


class _Member:
    """One cell of a walk, and its progress."""

    def __init__(
        self, number: int, job: Job, planned: Job, results: Results, flows: Mapping[tuple[CellRef, str], _Flow]
    ) -> None:
        self.number, self.job, self.planned, self.form = number, job, planned, form_of(planned)
        self.stage: Any = job.stage
        self.seconds, self.next = 0.0, 0
        self.outputs = {output.variable: output for output in self.form.outputs}
        rowed = next(output for output in self.outputs.values() if has_rows(output.declaration.dims))
        self.main, self.total = rowed.variable, rowed.shape[-2]
        halo = 0 if job.left_out else halo_of(job.stage)
        if halo is None:
            raise _Unfit
        self.halo = halo
        self.first_row = round(job.grids[self.main].line("y").start)
        walk = planned.walk
        assert walk is not None
        self.flows = {name: _Flow() for name in self.outputs}
        for name, o in self.outputs.items():
            if has_rows(o.declaration.dims) and name in (*walk.whole, *walk.seen):
                flow = self.flows[name]
                flow.seen = planned.look.gathering(name, o.shape) if name in walk.seen and planned.look else None
                if flow.seen is None:
                    place = walk.places.get(name)
                    fits = place is not None and (place.shape, place.dtype) == (o.shape, o.dtype)
                    flow.whole = place if fits else np.empty(o.shape, o.dtype)
        self.figures: dict[str, list[Array]] = {
            name: [] for name, o in self.outputs.items() if not has_rows(o.declaration.dims)
        }
        self.sizes: list[int] = []
        self.cut: CellArrays = {}  # by port: a flow, or an array of all rows
        self.fixed: CellArrays = {}
        self.negative: dict[str, _Negative] = {}
        self._read(results, flows)
        if not job.left_out:
            self._ask(results)

    def _read(self, results: Results, flows: Mapping[tuple[CellRef, str], _Flow]) -> None:
        """Connect the ports: to flows of this walk, or to whole arrays from outside."""
        ports = reads_of(type(self.stage))
        for port, ref, variable in self.job.inputs:
            flow = flows.get((ref, variable))
            if flow is not None and has_rows(ports[port].dims):
                flow.readers.append(self)
                self.cut[port] = flow
            elif flow is not None:
                self.fixed[port] = flow  # its value, once the first strip has been computed
            elif self.job.left_out:
                array = results[ref].arrays[variable]
                (self.cut if has_rows(ports[port].dims) else self.fixed)[port] = array
                if variable in self.flows:
                    self.flows[variable].undefined = bool(undefined(self.job, {variable: array}))
            else:
                array = looked_through(self.job, results, ref, variable)
                (self.cut if has_rows(ports[port].dims) else self.fixed)[port] = array
                if (
                    self.stage.negative == "clip"
                    and array.dtype.kind == "f"
                    and results[ref].lowest.get(variable, 0.0) < 0
                ):
                    if not has_rows(ports[port].dims) or self.halo:
                        raise _Unfit
                    self.negative[port] = _Negative()

    def _ask(self, results: Results) -> None:
        """Get the other arguments of ``run`` for the whole frame; arguments along y are cut to rows later."""
        self.known = beside(self.job, results)
        self.along = {name for name in self.known if name.removeprefix("out_") in ("y", "y_um")}

    def reach(self, front: int) -> int:
        """Return the row up to which this cell can be computed from the rows that are available."""
        there = min((flow.end for flow in self.cut.values() if isinstance(flow, _Flow)), default=front)
        if not any(isinstance(flow, _Flow) for flow in self.cut.values()) or there == self.total:
            return there
        return max(there - self.halo, self.next)

    def go_on(self, front: int) -> None:
        start, stop = self.next, self.reach(front)
        if self.job.left_out:
            self._pass_on(start, stop)
        else:
            self._compute(start, stop)
        self.next = stop

    def _pass_on(self, start: int, stop: int) -> None:
        """Pass on the input of a cell that is left out."""
        for port, _, variable in self.job.inputs:
            if variable in self.flows:
                source = self.cut.get(port, self.fixed.get(port))
                if isinstance(source, _Flow):
                    self.flows[variable].undefined |= source.undefined
                self._put(
                    variable, self._rows(port, start, stop) if port in self.cut else self._fixed(port), start, stop
                )

    def _put(self, variable: str, array: Array, start: int, stop: int) -> None:
        flow = self.flows[variable]
        if variable not in self.figures:
            flow.put(start, stop, array)
            return
        self.figures[variable].append(array)
        if flow.figure is None:
            flow.figure = array
        flow.end = stop

    def _rows(self, port: str, start: int, stop: int) -> Any:
        source = self.cut[port]
        if isinstance(source, _Flow):
            return source.rows(start, stop)
        rows = source[..., start:stop, :]
        return for_reading(rows if rows.flags.c_contiguous else frozen(rows.copy(order="C")))

    def _fixed(self, port: str) -> Any:
        source = self.fixed[port]
        return source.figure if isinstance(source, _Flow) else source

    def _compute(self, start: int, stop: int) -> None:
        """Call ``run`` on some rows and the halo around them."""
        # ``Haloed`` promises strips that begin on even rows, so that patterns of two rows keep their phase.
        low = max(start - self.halo, 0) // 2 * 2 if self.halo else start
        high, first = min(stop + self.halo, self.total), start == 0
        given = self._given(low, high, first)
        with guests_of(self.job):
            found = self.job.run(**given)
        expected = tuple(
            self._shaped(o, high - low) for o in self.outputs.values() if first or not o.declaration.optional
        )
        figures = {name: found[name] for name in self.figures if isinstance(found, dict) and name in found}
        held = [found]
        del found  # another reference would force ``taken`` to copy the arrays
        arrays = check(self.job, held.pop(), expected)
        bad = undefined(self.job, arrays)
        arrays = handed_on(self.job, arrays) if self.job.steps else arrays
        for name, array in arrays.items():
            if name in self.figures:
                self.figures[name].append(figures[name])
                if self.flows[name].figure is None:
                    self.flows[name].figure = array
                self.flows[name].end = stop
                continue
            self.flows[name].undefined |= name in bad
            if (low, high) != (start, stop):
                array = frozen(array[..., start - low : stop - low, :].copy(order="C"))
            self.flows[name].put(start, stop, array)
        self.sizes.append(self.outputs[self.main].size // self.total * (stop - start))

    def _given(self, low: int, high: int, first: bool) -> CellArrays:
        """Return the arguments of ``run`` for some rows, as if they were the whole frame."""
        given = {name: value[low:high] if name in self.along else value for name, value in self.known.items()}
        for port in self.fixed:
            given[port] = for_reading(self._looked_at(port, self._fixed(port)))
        for port in self.cut:
            given[port] = for_reading(self._looked_at(port, self._rows(port, low, high)))
        if "asked" in given and not first:
            given["asked"] = frozenset()  # optional outputs come with the first strip only
        for pattern in [name for name in patterns_of(type(self.job.stage)) if name in given]:
            grid = next(iter(self.job.grids.values()))
            line = grid.line("y")
            grid = grid.replace(y=Line(high - low, line.start + low * line.step, line.step))
            given[pattern] = PatternRandom(self.job.pattern_of, grid, self.job.precision, self.total * grid["x"].size)
        return handed(self.stage, {name: given[name] for name in self.job.asks if name in given})

    def _looked_at(self, port: str, array: Any) -> Any:
        """Check rows for values that the stage refuses; set negative values to 0 if it clips them."""
        if port in self.negative:
            return self.negative[port].taken_off(array)
        source = self.cut.get(port, self.fixed.get(port))
        if not isinstance(source, _Flow) or array.dtype.kind != "f" or not array.size:
            return array
        if source.undefined and self.stage.nan != "keep":
            raise _Unfit
        if self.stage.negative != "keep" and not array.min() >= 0:
            raise _Unfit
        return array

    @staticmethod
    def _shaped(output: Output, rows: int) -> Output:
        if not has_rows(output.declaration.dims):
            return output
        return replace(output, shape=(*output.shape[:-2], rows, output.shape[-1]))

    def ended(self) -> tuple[Result, CellReport]:
        """Return the result of the cell with the whole arrays that are needed outside, and its report."""
        began = time.thread_time()
        arrays = {name: _read_only(flow.whole) for name, flow in self.flows.items() if flow.whole is not None}
        arrays |= {name: flow.seen.made() for name, flow in self.flows.items() if flow.seen is not None}
        arrays |= self._joined()
        result = Result(lowest={name: float("nan") for name, flow in self.flows.items() if flow.undefined})
        result.lowest |= undefined(self.job, {name: arrays[name] for name in self.figures if name in arrays})
        clipped: Clipped = [negative.figures() for negative in self.negative.values()]
        self.seconds += time.thread_time() - began
        return kept(self.planned, result, arrays, clipped, lambda: self.seconds)

    def _joined(self) -> CellArrays:
        """Return the variables without rows, joined over the strips."""
        if self.job.left_out:
            return {name: values[0] for name, values in self.figures.items()}
        parts = {name: [np.asarray(value) for value in values] for name, values in self.figures.items()}
        if not parts:
            return {}
        stage = self.stage if isinstance(self.stage, Haloed) else Haloed()
        if self.halo and type(stage).joined is not Haloed.joined:
            raise _Unfit
        found = {name: np.asarray(value) for name, value in stage.joined(parts, self.sizes).items()}
        return check(self.job, found, tuple(self.outputs[name] for name in self.figures))


def _read_only(array: Array) -> Array:
    """Return a complete array as read-only; as a view if it is part of the caller's array."""
    if array.base is None:
        return frozen(array)
    view = array.view()
    view.flags.writeable = False
    return view


class _Negative:
    """Counts the values clipped from a port, row by row, so that the sums do not depend on the strips."""

    def __init__(self) -> None:
        self.below, self.taken, self.flux = 0, [], []  # type: ignore[var-annotated]
        self.size = 0

    def taken_off(self, rows: Array) -> Array:
        self.size += rows.size
        below, taken, flux = clipped_figures(rows)
        self.below += below
        self.taken.append(taken)
        self.flux.append(flux)
        return frozen(np.maximum(rows, 0))

    def figures(self) -> tuple[float, float]:
        taken, flux = (float(np.concatenate(each, axis=-1).sum()) for each in (self.taken, self.flux))
        return self.below / self.size, taken / flux if flux else 0.0
