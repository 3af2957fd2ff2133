"""Turn the cells of a plan into jobs. Runs in the process that owns the run.

In:  a plan, the cells to compute, and the place where each cell is stored.
Out: jobs for these cells and for the stored cells that they read.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Hashable, Iterator, Mapping, Set
from dataclasses import replace
from functools import cached_property, partial
from itertools import accumulate
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from etendue.compute.job import CellObserver, Found, Job, Looking, Mapped, Segment, Waiting
from etendue.compute.joined.inputs import Direct, direct_input, made_by_band
from etendue.compute.rows import by_band, is_large, walker
from etendue.compute.walks import with_walks
from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Sheet, Summed, Transfer
from etendue.contract.ports import Target
from etendue.contract.stage import looks_at_stages, patterns_of, reads_of
from etendue.plan.cost import cell_seconds
from etendue.plan.identity.once import Once
from etendue.plan.identity.same_as import source_of
from etendue.plan.model import Cell, CellRef, Node, Plan, chains, is_whole, light_of, pixel_of, scene_of
from etendue.transfer.sampling import TOGETHER

if TYPE_CHECKING:
    from etendue.types.arrays import Array


def make_jobs(
    plan: Plan,
    todo: Set[CellRef],
    target: Callable[[Cell], Target | None],
    deliver_all: bool = False,
    show: frozenset[CellRef] = frozenset(),
    place: Callable[[CellRef, str], Array | bool | None] | None = None,
    looks: Mapping[CellRef, CellObserver] = MappingProxyType({}),
) -> Mapping[CellRef, Job]:
    """Return jobs for the cells to compute and for the stored cells they read, in order.

    ``deliver_all`` keeps every kept variable in memory (no archive); ``show`` marks cells whose arrays the caller
    wants; ``looks`` gives the function that reduces these arrays in the worker that computes them; ``place`` gives the
    array into which a variable for the caller is put as soon as it is computed.
    """
    jobs = Jobs(plan, todo, target, deliver_all, show, looks)
    jobs.place_of = place
    large: Once[bool] = Once()  # most cells of a sweep share their grids
    every = ((plan.cells[ref].grids, plan.cells[ref].input_grids) for ref in jobs)
    if not any(large(grids, partial(is_large, *grids)) for grids in every):
        return jobs
    return with_walks(dict(jobs), lambda ref: walker(plan, jobs.nodes[ref[0]], plan.cells[ref]), place)


BANDS, WHOLE = 1, 2  # how other cells continue from the transform of a cell: a few bands at a time, or with all bands


class Jobs(Mapping[CellRef, Job]):
    """The jobs of a run. Each job is created on demand and not kept: a sweep has many more cells than are being
    computed at any moment.

    Only this is kept of each cell: the variables that other cells read, whether other cells continue from its
    transform, and whether it has a job.
    """

    def __init__(
        self,
        plan: Plan,
        todo: Set[CellRef],
        target: Callable[[Cell], Target | None],
        deliver_all: bool,
        show: frozenset[CellRef],
        looks: Mapping[CellRef, CellObserver],
    ) -> None:
        self.plan, self.todo, self.target, self.deliver_all = plan, todo, target, deliver_all
        self.show, self.looks = show, looks
        self.place_of: Callable[[CellRef, str], Array | bool | None] | None = None
        self.nodes = {node.name: node for node in plan.nodes}
        self.kept = {
            node.name: tuple(v for v in node.writes if (node.name, v) in plan.with_arrays) for node in plan.nodes
        }
        self.finding = {node.name for node in plan.nodes if node.found}
        self.number = plan.numbers.of
        self.direct: dict[CellRef, Direct] = {}
        self.read: list[tuple[str, ...]] = [()] * plan.numbers.count  # by cell: the variables that others read
        self.joined: dict[tuple[tuple[str, ...], str], tuple[str, ...]] = {}  # each combination is stored once
        self.transforms, self.included = bytearray(plan.numbers.count), bytearray(plan.numbers.count)
        self.costs: Once[tuple[float, tuple[str, ...]]] = Once()
        self.grids: dict[str, tuple[Mapping[str, Grid], Mapping[str, Grid]]] = {}
        self.looked: dict[str, tuple[Hashable, Looking]] = {}
        for ref, cell in plan.cells.items():
            if self.nodes[cell.node].segment and (found := direct_input(plan, self.nodes, cell)) is not None:
                self.direct[ref] = found
        # In reverse order, all readers of a cell are visited before the cell itself, so that all its variables that are
        # read are known by then.
        for ref in reversed(list(plan.cells)):
            self._include(ref, plan.cells[ref])

    def _include(self, ref: CellRef, cell: Cell) -> None:
        """Decide whether a cell has a job, and record its inputs. Cells are visited after all of their readers."""
        number, node, computed = self.number(ref), self.nodes[ref[0]], ref in self.todo
        read, transform = self.read[number], self.transforms[number]
        if not (computed or read or transform):
            return
        self.included[number] = True
        if cell.left_out is not None:
            self._note_passed(ref, cell, computed, read, transform)
            return
        if not (computed or transform):
            return  # stored: its result is only read back
        if node.is_transfer and not (self.kept[node.name] or read or transform or ref in self.show):
            return  # no cell reads this light: later cells start from the segment's input
        direct = self.direct.get(ref)
        self._note_inputs(cell, len(node.segment) > 1, direct)
        for word in cell.open_words:
            self._reads(word.ref, word.variable)
        self._note_looks(cell, node)
        for other in direct[1] if direct is not None else ():
            self._note_found(other)

    def _note_passed(self, ref: CellRef, cell: Cell, computed: bool, read: tuple[str, ...], transform: int) -> None:
        """Record the parts of its input that a left-out cell passes on: arrays that other cells need, and the transform
        of its segment.
        """
        node = self.nodes[ref[0]]
        wanted = self._wanted(cell, node, computed, read)
        if computed and any(node.writes[v].optional for v in wanted):  # only the stage itself computes these
            self._note_inputs(cell, False, None)
            for word in cell.open_words:
                self._reads(word.ref, word.variable)
            self._note_looks(cell, node)
        for variable in self._passed(node, wanted, computed):
            self._reads(self._source(cell, variable, computed), variable)
        if transform and len(node.segment) > 1:
            self._continues(cell.inputs[0][1], transform)
        elif transform:
            self._reads(*cell.inputs[0][1:])

    def _wanted(self, cell: Cell, node: Node, computed: bool, read: tuple[str, ...]) -> tuple[str, ...]:
        """Return the variables of a cell that are read, stored or given to the caller, if they are available."""
        if not computed:
            return read
        kept = self.plan.kept
        given = [
            v
            for v in (node.writes if cell.ref in self.show else ())
            if (s := source_of(cell, v)) and (s in self.todo or not kept or (s[0], v) in kept)
        ]
        return tuple(dict.fromkeys((*read, *self.kept[node.name], *given)))

    def _passed(self, node: Node, wanted: tuple[str, ...], computed: bool) -> tuple[str, ...]:
        """Return the variables that a left-out cell takes from another cell rather than from the store."""
        if not computed:
            return tuple(v for v in wanted if (node.name, v) in self.plan.same_as)
        return tuple(v for v in wanted if not node.writes[v].optional)

    def _source(self, cell: Cell, variable: str, computed: bool) -> CellRef:
        """Return the cell whose array a left-out cell passes on: its input or, if the cell is finished, the cell whose
        array is stored."""
        source = source_of(cell, variable) if computed else self.plan.stored(cell.ref, variable)
        assert source is not None
        return source

    def _note_inputs(self, cell: Cell, joined: bool, direct: Direct | None) -> None:
        """Record the variables that a cell reads through its ports; ``joined``: the cell continues from the transform
        of the previous stage.
        """
        for place, (_, source, variable) in enumerate(cell.inputs):
            if direct is not None and place == 0:
                self._reads(*direct[0])
            elif joined and place == 0:
                self._continues(source, BANDS if self._seen(cell, self.nodes[cell.node]) else WHOLE)
            else:
                self._reads(source, variable)

    def _continues(self, source: CellRef, how: int) -> None:
        number = self.number(source)
        self.transforms[number] = max(self.transforms[number], how)

    def _seen(self, cell: Cell, node: Node) -> bool:
        """Return whether the light of a cell, and of all cells that continue from it, is only looked at, band
        by band.
        """
        number = self.number(cell.ref)
        looked = cell.ref in self.looks and cell.ref in self.todo and self.transforms[number] < WHOLE
        alone = not (self.read[number] or self.kept[node.name] or cell.mapped or cell.steps)
        return looked and alone and made_by_band(cell)

    def _note_looks(self, cell: Cell, node: Node) -> None:
        """Record the variables that a cell looks at, and the values for which the stages that it looks at wait."""
        looked = dict(cell.looks_at) if node.looks_at else {}
        for port, what, _ in node.looks_at:
            for source in looked.get(port, ()):
                if looks_at_stages(what):
                    self._note_found(self.plan.cells[source])
                else:
                    self._reads(source, what)

    def _note_found(self, cell: Cell) -> None:
        for _, finder, variable in cell.found:
            self._reads(finder, variable)

    def _reads(self, ref: CellRef, variable: str) -> None:
        number = self.number(ref)
        known = self.read[number]
        if variable not in known:
            self.read[number] = self.joined.setdefault((known, variable), (*known, variable))

    # -- the mapping --------------------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[CellRef]:
        return (ref for ref, own in zip(self.plan.cells, self.included, strict=True) if own)

    def __len__(self) -> int:
        return sum(self.included)

    def __contains__(self, ref: object) -> bool:
        return ref in self.plan.cells and bool(self.included[self.number(ref)])  # type: ignore[arg-type]

    def __getitem__(self, ref: CellRef) -> Job:
        if ref not in self:
            raise KeyError(ref)
        return self._made(ref, self.target(self.plan.cells[ref]))

    def _made(self, ref: CellRef, target: Target | None) -> Job:
        number = self.number(ref)
        plan, cell, node, computed = self.plan, self.plan.cells[ref], self.nodes[ref[0]], ref in self.todo
        store = self.kept[node.name] if computed else ()
        give = tuple(node.writes) if ref in self.show else store if self.deliver_all else ()
        read, transform = self.read[number], bool(self.transforms[number])
        # Among the inputs of a cell, the values that other cells find during the run come last.
        awaited = cell.found if node.name in self.finding else ()
        inputs = cell.inputs[: len(cell.inputs) - len(awaited)]
        segment = None
        if ref in self.direct:
            (source, variable), before = self.direct[ref]
            inputs = ((inputs[0][0], source, variable), *inputs[1:])
            # this removes nothing, because a segment contains only transfer stages
            stages = tuple(c.stage for c in before if isinstance(c.stage, Transfer))
            segment = Segment(None, stages, _found_of(before), transform, plan.cells[source].key)
        elif node.segment:
            last = cell.inputs[0][1] if len(node.segment) > 1 else None
            segment = Segment(last, transform=transform, seen=self._seen(cell, node))
        grids, input_grids = self._grids(cell)
        seconds, bands = self._cost(node, cell)
        identity = next(iter(patterns_of(type(cell.stage)).values()), "")  # the owner of its fixed patterns
        job = Job(
            ref=cell.ref,
            task="compute" if computed else "load",
            stage=cell.stage,
            writes=node.writes,
            grids=grids,
            input_grids=input_grids,
            inputs=inputs,
            left_out=cell.left_out is not None,
            seed=cell.seed,
            pattern_of=str(vars(cell.stage).get(identity, "")).encode(),
            precision=plan.precision,
            store=store,
            deliver=tuple(dict.fromkeys((*read, *give))) if give else read,
            target=target,
            give=give,
            seconds=seconds,
            by_band=bands,
            segment=segment,
            looking=self._looking(cell) if cell.looks_at else None,
            waiting=Waiting(awaited, cell.open_words, plan.pipeline.seed) if awaited or cell.open_words else None,
            mapped=Mapped(cell.mapped, _leading(self.nodes, cell)) if cell.mapped else None,
            expected=plan.expected,
            look=self.looks.get(ref),
            steps=cell.steps,
            places={v: self.place_of(ref, v) for v in give} if give and self.place_of else {},
        )
        return job if cell.left_out is None else self._left_out(job, cell, node)

    def _left_out(self, job: Job, cell: Cell, node: Node) -> Job:
        """Return the job of a cell that is left out: it passes on the variables of its input that other cells need."""
        computed, transform = cell.ref in self.todo, job.transform
        wanted = self._wanted(cell, node, computed, self.read[self.number(cell.ref)])
        passes = self._passed(node, wanted, computed)
        before = cell.inputs[0][1] if len(node.segment) > 1 else None
        job = replace(job, passes=passes, segment=Segment(before, transform=True) if transform else None)
        if computed and any(node.writes[v].optional for v in wanted):
            return job  # the stage is run for these
        inputs = self._passing(cell, cell.inputs, passes, computed, transform and before is None)
        return replace(job, inputs=inputs, looking=None, waiting=None)

    def _passing(self, cell: Cell, inputs: Found, passes: tuple[str, ...], computed: bool, begins: bool) -> Found:
        """Return the inputs of the job of a left-out cell: the arrays that it passes on, and its other input cells,
        because it fails if they fail. ``begins``: other cells need the transform of the segment's input.
        """
        first = [one for one in inputs if source_of(cell, one[2]) == one[1] and one[2] in cell.grids]
        light = first[:1] if begins else []
        if not computed:
            return (*light, *((v, self._source(cell, v, computed), v) for v in passes))
        own = [one for one in first if one[2] in passes and one not in light]
        rest = (one for one in first if one not in own and one not in light and self.included[self.number(one[1])])
        return (*light, *own, *rest)

    # -- queries that need no job -------------------------------------------------------------------------------------

    def needs(self, ref: CellRef) -> tuple[CellRef, ...]:
        """Return the cells whose results a job reads."""
        cell, node = self.plan.cells[ref], self.nodes[ref[0]]
        if node.segment or cell.left_out or cell.looks_at or cell.open_words or node.name in self.finding:
            return self._made(ref, None).needs
        if ref not in self.todo:
            return ()
        return tuple(dict.fromkeys([source for _, source, _ in cell.inputs]))

    def read_of(self, ref: CellRef, source: CellRef) -> frozenset[str] | None:
        """Return the variables of a cell that a job reads; None if the cell has a single variable or no large one."""
        if len(self.nodes[source[0]].writes) < 2 or not self._is_large(self.plan.cells[source]):
            return None
        return frozenset(variable for other, variable in self._made(ref, None).reads if other == source)

    def _is_large(self, cell: Cell) -> bool:
        return any(grid.count > TOGETHER for grid in cell.grids.values())

    def place(self, ref: CellRef) -> int:
        """Return the position of a job among all jobs."""
        return self.number(ref) if self.places is None else self.places[self.number(ref)]

    @cached_property
    def places(self) -> array[int] | None:
        """The position of the job of each cell, by cell number; None if every cell has a job."""
        return None if all(self.included) else array("i", (count - 1 for count in accumulate(self.included)))

    def seconds(self, ref: CellRef) -> float:
        """Return the estimated seconds of a job."""
        return self._cost(self.nodes[ref[0]], self.plan.cells[ref])[0]

    def _grids(self, cell: Cell) -> tuple[Mapping[str, Grid], Mapping[str, Grid]]:
        """Return the grids of a cell; the objects of the previous cell if they are equal, because comparing identical
        objects later is fast."""
        known = self.grids.get(cell.node)
        if known is None or known[0] is not cell.grids or known[1] is not cell.input_grids:
            grids, input_grids = cell.grids, cell.input_grids
            if known is not None:
                grids = known[0] if known[0] == grids else grids
                input_grids = known[1] if known[1] == input_grids else input_grids
            known = self.grids[cell.node] = grids, input_grids
        return known

    def _looking(self, cell: Cell) -> Looking:
        """Return the stages, cells and grids that a cell looks at; the object of the previous cell if it looks at the
        same cells.
        """
        known = self.looked.get(cell.node)
        if known is None or known[0] != cell.looks_at:
            known = self.looked[cell.node] = cell.looks_at, _looking(self.plan, self.nodes, cell)
        return known[1]

    def _cost(self, node: Node, cell: Cell) -> tuple[float, tuple[str, ...]]:
        """Return the expected seconds of a cell and its variables computed by band; cached by stage class and grids."""
        precision = self.plan.precision
        return self.costs(
            (cell.grids, cell.input_grids),
            lambda: (cell_seconds(node, cell, precision), by_band(node, cell, precision)),
            node.name,
            type(cell.stage),
            cell.left_out is None,
        )


def _leading(nodes: Mapping[str, Node], cell: Cell) -> Mapping[tuple[str, str], tuple[int, ...]]:
    """Return, for each variable that a cell depends on, the positions of those mapped dims that lead its array."""
    dims = [dim for dim, _ in cell.mapped]
    ports, found = reads_of(type(cell.stage)), {}
    for port, ref, variable in cell.inputs:
        whole = nodes[ref[0]].writes[variable].dims
        lead = whole[: len(whole) - len(ports[port].dims)] if port in ports else whole
        found[ref[0], variable] = tuple(dims.index(dim) for dim in lead)
    for word in cell.open_words:
        whole = nodes[word.ref[0]].writes[word.variable].dims
        found[word.ref[0], word.variable] = tuple(dims.index(dim) for dim in whole if dim in dims)
    return found


def _found_of(cells: tuple[Cell, ...]) -> tuple[Found, ...]:
    """Return, for each of the cells, the values that it waits for; () if no cell waits."""
    every = tuple(cell.found for cell in cells)
    return every if any(every) else ()


def _looking(plan: Plan, nodes: Mapping[str, Node], cell: Cell) -> Looking:
    """Return the objects that a cell looks at: stages for transfer functions, cells and grids for variables."""
    found: dict[str, Any] = {"ports": (), "grids": {}}
    looked = dict(cell.looks_at)
    for port, what, _ in nodes[cell.node].looks_at:
        if port not in looked:
            continue  # the port of another alternative
        refs = looked[port]
        found["ports"] += ((port, what, tuple((ref[0], ref) for ref in refs)),)
        cells = tuple(plan.cells[ref] for ref in refs)
        found["grids"][port] = tuple(
            next(iter(c.grids.values())) if looks_at_stages(what) else c.grids[what] for c in cells
        )
        if what == "datasheet":
            found["sheets"] = tuple(Sheet.of(c.stage) for c in cells)
        if what == "transfer" and cells:
            found["whole"] = tuple(is_whole(plan.cells, c) for c in cells)
            found["transfers"] = tuple(c.stage for c in cells)
            found["found"] = _found_of(cells)
            found["bands"] = cells[0].input_grids[cells[0].inputs[0][0]].bands().edges
            found["channel_weights"] = next((c.stage for c in cells if isinstance(c.stage, Summed)), None)
            found["chains"] = tuple(tuple(chain) for chain in chains([c.node for c in cells], nodes))
            found["rendered"] = scene_of(plan.cells, cells[0]).facts.rendered
            found["light"] = next((light_of(plan.cells, c) for c in pixel_of(cells)), None)
    return Looking(**found)
