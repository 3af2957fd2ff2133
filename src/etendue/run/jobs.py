"""A plan's cells to jobs: everything needed to compute one cell, and nothing of the plan besides.

Jobs are plain values that travel to another thread or process. The owner of a run makes them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from etendue.plan.cost import cell_seconds, too_large
from etendue.plan.model import Cell, CellRef, Node, Plan, chains, is_whole, scene_of
from etendue.plan.words import Open
from etendue.spec.capabilities import Banded, Summed, Transfer
from etendue.spec.grid import Coordinate, Grid
from etendue.spec.ports import Target
from etendue.spec.stage import Stage, quantities_of, reads_of
from etendue.spec.variables import Declaration


@dataclass(eq=False)  # written once; freezing it would cost more than making it
class Job:
    """One cell to compute, or to load because something else reads it.

    ``task``: compute, or load (already stored; only read back, or its spectrum rebuilt).
    ``deliver``: the variables other jobs or the caller need as arrays, ``give``: those of the caller; ``spectrum``: they need its spectrum.
    """

    ref: CellRef
    task: str
    stage: Stage
    writes: Mapping[str, Declaration]
    grids: Mapping[str, Grid]
    input_grids: Mapping[str, Grid]
    inputs: tuple[tuple[str, CellRef, str], ...]
    looks_at: tuple[tuple[str, str, tuple[tuple[str, CellRef], ...]], ...]
    transfers: tuple[Transfer, ...]
    bands: tuple[float, ...]
    channel_weights: Summed | None
    previous: CellRef | None  # the transfer cell before it in its segment
    left_out: bool
    seed: bytes
    sensor_seed: bytes
    precision: str
    store: tuple[str, ...]
    deliver: tuple[str, ...]
    spectrum: bool
    target: Target | None
    seconds: float
    give: tuple[str, ...] | None = None  # of what is delivered: what the caller holds on to; None: all
    by_band: tuple[str, ...] = ()  # variables that are made and stored band by band
    joined: tuple[Transfer, ...] | None = None  # reads the segment's input itself: the stages of the segment in front of it
    chains: tuple[tuple[int, ...], ...] = ()  # for each of ``transfers``: which of them it stands behind, itself last; (): all before it
    whole: tuple[bool, ...] = ()  # for each of ``transfers``: nothing else has moved light in front of it; (): so for all
    rendered: tuple[float, float] | None = None  # with what the scene in front of ``transfers`` was drawn
    looked_grids: Mapping[str, tuple[Grid, ...]] = field(default_factory=dict)  # by port, of what is looked at
    found: tuple[tuple[str, CellRef, str], ...] = ()  # camera quantities of its stage that other cells find
    found_by: tuple[tuple[tuple[str, CellRef, str], ...], ...] = ()  # the same for each of ``transfers``
    found_before: tuple[tuple[tuple[str, CellRef, str], ...], ...] = ()  # the same for each of ``joined``
    open_words: tuple[Open, ...] = ()  # of the seed, which holds the closed ones
    seed_number: int = 0
    mapped: tuple[tuple[str, Coordinate], ...] = ()  # dims in front of what it writes for which its stage is run one by one
    leading: Mapping[tuple[str, str], tuple[int, ...]] = field(default_factory=dict)  # which of them lead a (stage, variable) that it reads

    @cached_property
    def needs(self) -> tuple[CellRef, ...]:
        """The cells whose results this job reads."""
        if self.task == "load" and not self.spectrum:
            return ()
        if self.previous is not None:
            return tuple(dict.fromkeys((self.previous, *(ref for _, ref, _ in self.inputs[1:]), *self.awaited)))
        refs = [ref for _, ref, _ in self.inputs]
        refs += self.awaited
        refs += [ref for port, what, pairs in self.looks_at if what != "transfer" for _, ref in pairs]
        return tuple(dict.fromkeys(refs))

    @cached_property
    def awaited(self) -> tuple[CellRef, ...]:
        """The cells that find something this job does not know yet."""
        if not (self.found or self.open_words or self.found_by or self.found_before):
            return ()
        every = (self.found, *self.found_by, *self.found_before)
        return tuple(dict.fromkeys((*(ref for found in every for _, ref, _ in found), *(word.ref for word in self.open_words))))

    def without_stage(self) -> Job:
        """The same job for those who will not compute it: what its stage is cannot be said to another process."""
        return replace(self, stage=Stage(), transfers=(), joined=None, channel_weights=None)


def make_jobs(
    plan: Plan,
    todo: set[CellRef],
    target: Callable[[Cell], Target | None],
    deliver_all: bool = False,
    show: frozenset[CellRef] = frozenset(),
) -> dict[CellRef, Job]:
    """Jobs for the cells to compute and for the stored cells they read, in order.

    ``deliver_all`` keeps every kept variable in memory (no archive); ``show`` marks cells whose arrays the caller
    wants to look at.
    """
    nodes = {node.name: node for node in plan.nodes}
    direct = {ref: found for ref, cell in plan.cells.items() if (found := _direct(plan, nodes, cell)) is not None}
    arrays: dict[CellRef, dict[str, None]] = {}
    spectra: set[CellRef] = set()
    included: set[CellRef] = set()
    for ref in reversed(list(plan.cells)):
        cell = plan.cells[ref]
        if ref not in todo and ref not in arrays and ref not in spectra:
            continue
        included.add(ref)
        if ref not in todo and ref not in spectra:
            continue  # stored and only read back
        node = nodes[cell.node]
        joined = len(node.segment) > 1
        for number, (_, source, variable) in enumerate(cell.inputs):
            if ref in direct and number == 0:
                source, variable = direct[ref][0]
                arrays.setdefault(source, {})[variable] = None
            elif joined and number == 0:
                spectra.add(source)
            else:
                arrays.setdefault(source, {})[variable] = None
        for word in cell.open_words:
            arrays.setdefault(word.ref, {})[word.variable] = None
        for port, what, _ in node.looks_at:
            for source in dict(cell.looks_at).get(port, ()):
                if what != "transfer":
                    arrays.setdefault(source, {})[what] = None
                    continue
                for _, finder, variable in plan.cells[source].found:
                    arrays.setdefault(finder, {})[variable] = None
        for other in direct[ref][1] if ref in direct else ():
            for _, finder, variable in other.found:
                arrays.setdefault(finder, {})[variable] = None
    jobs = {}
    for ref, cell in plan.cells.items():
        if ref not in included:
            continue
        node = nodes[cell.node]
        store = tuple(v for v in node.writes if (node.name, v) in plan.kept) if ref in todo else ()
        give = tuple(node.writes) if ref in show else store if deliver_all else ()
        deliver = {**arrays.get(ref, {}), **dict.fromkeys(give)}
        looking = _looking(plan, nodes, cell)
        serial = vars(cell.stage)["sensor_serial"] if "sensor_serial" in quantities_of(type(cell.stage)) else ""
        awaited = cell.found if node.found else ()
        inputs = cell.inputs[: len(cell.inputs) - len(awaited)]
        previous: CellRef | None = cell.inputs[0][1] if len(node.segment) > 1 else None
        segment: dict[str, Any] = {}
        if ref in direct:
            (source, variable), before = direct[ref]
            inputs, previous = ((inputs[0][0], source, variable), *inputs[1:]), None
            segment = {"joined": tuple(c.stage for c in before), "found_before": _found_of(before)}
        jobs[ref] = Job(
            ref=ref, task="compute" if ref in todo else "load", stage=cell.stage, writes=node.writes, grids=cell.grids,
            input_grids=cell.input_grids, inputs=inputs, previous=previous,
            left_out=cell.left_out is not None, seed=cell.seed,
            sensor_seed=f"{plan.pipeline.seed}|{node.name}|{serial}".encode(), precision=plan.precision, store=store,
            deliver=tuple(deliver), spectrum=ref in spectra, target=target(cell), seconds=cell_seconds(node, cell, plan.precision),
            give=give, by_band=_by_band(node, cell, plan.precision), found=awaited, open_words=cell.open_words,
            seed_number=plan.pipeline.seed, mapped=cell.mapped, leading=_leading(nodes, cell), **segment, **looking,
        )  # fmt: skip
    return jobs


def _by_band(node: Node, cell: Cell, precision: str) -> tuple[str, ...]:
    """The variables of a cell that are made band by band: too large to be held, by a stage that can."""
    if cell.left_out is not None or cell.mapped or not (isinstance(cell.stage, Banded) or node.segment):
        return ()
    return tuple(v for v, d in node.writes.items() if too_large(d, cell.grids[v], precision))


def _leading(nodes: Mapping[str, Node], cell: Cell) -> Mapping[tuple[str, str], tuple[int, ...]]:
    """Which of the dims that a cell is mapped over lead each variable that it depends on, as positions."""
    if not cell.mapped:
        return {}
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


def _found_of(cells: tuple[Cell, ...]) -> tuple[tuple[tuple[str, CellRef, str], ...], ...]:
    """What each of some cells awaits; () where none does."""
    every = tuple(cell.found for cell in cells)
    return every if any(every) else ()


def _direct(plan: Plan, nodes: Mapping[str, Node], cell: Cell) -> tuple[tuple[CellRef, str], tuple[Cell, ...]] | None:
    """What a transfer cell reads that starts from the segment's input itself: the input, and the cells in force in front of it.

    So do all cells of a segment whose input is too large to be held, or is means over grid cells, and an end whose sum over
    wavelength is expanded.
    """
    node = nodes[cell.node]
    if not node.segment or cell.segment_input is None:
        return None
    source, variable = cell.segment_input
    grid = plan.cells[source].grids[variable]
    expanded = isinstance(cell.stage, Summed) and cell.stage.terms() > 0
    if not (expanded or grid.line("y").cells or too_large(nodes[source[0]].writes[variable], grid, plan.precision)):
        return None
    before: list[Cell] = []
    at = cell
    for _ in range(len(node.segment) - 1):
        at = plan.cells[at.inputs[0][1]]
        if at.left_out is None:
            before.append(at)
    return cell.segment_input, tuple(reversed(before))


_LOOKS_AT_NOTHING: Mapping[str, Any] = {"looks_at": (), "transfers": (), "bands": (), "channel_weights": None}


def _looking(plan: Plan, nodes: Mapping[str, Node], cell: Cell) -> Mapping[str, Any]:
    """What a cell looks at: stages for transfer functions, cells and grids for variables."""
    if not cell.looks_at:
        return _LOOKS_AT_NOTHING
    found: dict[str, Any] = {**_LOOKS_AT_NOTHING, "looked_grids": {}}
    looked = dict(cell.looks_at)
    for port, what, _ in nodes[cell.node].looks_at:
        if port not in looked:
            continue  # of an alternative
        refs = looked[port]
        found["looks_at"] += ((port, what, tuple((ref[0], ref) for ref in refs)),)
        cells = [plan.cells[ref] for ref in refs]
        found["looked_grids"][port] = tuple(c.grids[what] if what != "transfer" else next(iter(c.grids.values())) for c in cells)
        if what == "transfer" and cells:
            found["whole"] = tuple(is_whole(plan.cells, c) for c in cells)
            found["transfers"] = tuple(c.stage for c in cells)
            found["found_by"] = _found_of(tuple(cells))
            found["bands"] = cells[0].input_grids[cells[0].inputs[0][0]].bands().edges
            found["channel_weights"] = next((c.stage for c in cells if isinstance(c.stage, Summed)), None)
            found["chains"] = tuple(tuple(chain) for chain in chains([c.node for c in cells], nodes))
            found["rendered"] = scene_of(plan.cells, cells[0]).facts.rendered
    return found
