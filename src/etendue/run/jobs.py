"""A plan's cells to jobs. The owner of a run makes them.

In:  a plan, the cells to compute, where each is kept.
Out: jobs for these cells and for the stored ones they read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from etendue.plan.cost import cell_seconds, too_large
from etendue.plan.model import Cell, CellRef, Node, Plan, chains, is_whole, scene_of
from etendue.plan.strips import by_band, walker
from etendue.run.job import Found, Job, Look, Looking, Mapped, Segment, Waiting
from etendue.run.walks import with_walks
from etendue.spec.capabilities import Summed
from etendue.spec.grid import Grid
from etendue.spec.ports import Target
from etendue.spec.stage import quantities_of, reads_of


def make_jobs(
    plan: Plan,
    todo: set[CellRef],
    target: Callable[[Cell], Target | None],
    deliver_all: bool = False,
    show: frozenset[CellRef] = frozenset(),
    place: Callable[[CellRef, str], Any] | None = None,
    looks: Mapping[CellRef, Look] = MappingProxyType({}),
) -> dict[CellRef, Job]:
    """Jobs for the cells to compute and for the stored cells they read, in order.

    ``deliver_all`` keeps every kept variable in memory (no archive); ``show`` marks cells whose arrays the caller
    wants to look at; ``looks`` makes of them what it looks at, where they are made; ``place`` says where a variable is to be put that is
    made strip by strip.
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
        stored = any((node.name, v) in plan.kept for v in node.writes)
        if node.is_transfer and not (stored or ref in arrays or ref in spectra or ref in show):
            continue  # light that nobody looks at: its readers start from the segment's input
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
    kept = {node.name: tuple(v for v in node.writes if (node.name, v) in plan.kept) for node in plan.nodes}
    finding = {node.name for node in plan.nodes if node.found}
    jobs: dict[CellRef, Job] = {}
    last: dict[str, Job] = {}
    for ref, cell in plan.cells.items():
        if ref not in included:
            continue
        node, twin = nodes[cell.node], last.get(cell.node)
        store = kept[cell.node] if ref in todo else ()
        give = tuple(node.writes) if ref in show else store if deliver_all else ()
        deliver = {**arrays.get(ref, {}), **dict.fromkeys(give)}
        serial = vars(cell.stage)["sensor_serial"] if "sensor_serial" in quantities_of(type(cell.stage)) else ""
        awaited = cell.found if cell.node in finding else ()
        inputs = cell.inputs[: len(cell.inputs) - len(awaited)]
        segment = None
        if ref in direct:
            (source, variable), before = direct[ref]
            inputs = ((inputs[0][0], source, variable), *inputs[1:])
            segment = Segment(None, tuple(c.stage for c in before), _found_of(before), ref in spectra, plan.cells[source].key)  # type: ignore[misc]
        elif node.segment:
            segment = Segment(cell.inputs[0][1] if len(node.segment) > 1 else None, spectrum=ref in spectra)
        grids, input_grids = cell.grids, cell.input_grids
        if twin is not None:  # what is the same thing is found to be equal at once, and hashed once
            grids = twin.grids if twin.grids == grids else grids
            input_grids = twin.input_grids if twin.input_grids == input_grids else input_grids
            if not _costs_the_same(cell, grids, input_grids, twin):
                twin = None
        jobs[ref] = last[cell.node] = Job(
            ref=ref, task="compute" if ref in todo else "load", stage=cell.stage, writes=node.writes,
            grids=grids, input_grids=input_grids, inputs=inputs, left_out=cell.left_out is not None, seed=cell.seed,
            sensor_seed=f"{plan.pipeline.seed}|{node.name}|{serial}".encode(), precision=plan.precision, store=store,
            deliver=tuple(deliver), target=target(cell), give=give,
            seconds=twin.seconds if twin else cell_seconds(node, cell, plan.precision),
            by_band=twin.by_band if twin else by_band(node, cell, plan.precision), segment=segment,
            looking=_looking(plan, nodes, cell) if cell.looks_at else None,
            waiting=Waiting(awaited, cell.open_words, plan.pipeline.seed) if awaited or cell.open_words else None,
            mapped=Mapped(cell.mapped, _leading(nodes, cell)) if cell.mapped else None, expected=plan.expected,
            look=looks.get(ref),
        )  # fmt: skip
    return with_walks(jobs, lambda ref: walker(plan, nodes[ref[0]], plan.cells[ref]), place)


def _costs_the_same(cell: Cell, grids: Mapping[str, Grid], input_grids: Mapping[str, Grid], twin: Job) -> bool:
    """Whether what follows from class, grids and what is left out has been found out for another cell of the node."""
    if twin.grids is not grids or twin.input_grids is not input_grids or type(twin.stage) is not type(cell.stage):
        return False
    return twin.left_out == (cell.left_out is not None) and (twin.mapped is None) == (not cell.mapped)


def _leading(nodes: Mapping[str, Node], cell: Cell) -> Mapping[tuple[str, str], tuple[int, ...]]:
    """Which of the dims that a cell is mapped over lead each variable that it depends on, as positions."""
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
    expanded = isinstance(cell.stage, Summed) and (0 < cell.stage.terms() < grid.bands().size or cell.stage.kept() < 1)
    if not (expanded or grid.line("y").cells or too_large(nodes[source[0]].writes[variable], grid, plan.precision)):
        return None
    before: list[Cell] = []
    at = cell
    for _ in range(len(node.segment) - 1):
        at = plan.cells[at.inputs[0][1]]
        if at.left_out is None:
            before.append(at)
    return cell.segment_input, tuple(reversed(before))


def _looking(plan: Plan, nodes: Mapping[str, Node], cell: Cell) -> Looking:
    """What a cell looks at: stages for transfer functions, cells and grids for variables."""
    found: dict[str, Any] = {"ports": (), "grids": {}}
    looked = dict(cell.looks_at)
    for port, what, _ in nodes[cell.node].looks_at:
        if port not in looked:
            continue  # of an alternative
        refs = looked[port]
        found["ports"] += ((port, what, tuple((ref[0], ref) for ref in refs)),)
        cells = tuple(plan.cells[ref] for ref in refs)
        found["grids"][port] = tuple(c.grids[what] if what != "transfer" else next(iter(c.grids.values())) for c in cells)
        if what == "transfer" and cells:
            found["whole"] = tuple(is_whole(plan.cells, c) for c in cells)
            found["transfers"] = tuple(c.stage for c in cells)
            found["found"] = _found_of(cells)
            found["bands"] = cells[0].input_grids[cells[0].inputs[0][0]].bands().edges
            found["channel_weights"] = next((c.stage for c in cells if isinstance(c.stage, Summed)), None)
            found["chains"] = tuple(tuple(chain) for chain in chains([c.node for c in cells], nodes))
            found["rendered"] = scene_of(plan.cells, cells[0]).facts.rendered
    return Looking(**found)
