"""Cells of an earlier plan that a new plan can reuse, because nothing that determines them has changed.

In:  earlier plans, and the graph of a new one.
Out: the cells that can be taken over, one after the other in the order of the new plan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from etendue.contract.arrays.grid import Grid
from etendue.contract.capabilities import Noisy
from etendue.contract.stage import parameters_of
from etendue.pipeline.file import PipelineFile
from etendue.plan.expansion.recipes import Recipes
from etendue.plan.identity.once import Once
from etendue.plan.model import Cell, CellRef, Node, Plan
from etendue.plan.structure.cell import Settled
from etendue.plan.wiring.graph import Graph
from etendue.plan.wiring.request import Choice


class Earlier:
    """The cells of one earlier plan. ``unchanged``: the nodes that have the same stages and axes in the new plan."""

    def __init__(self, plan: Plan, unchanged: frozenset[str], sources: frozenset[str]) -> None:
        self.plan, self.unchanged, self.precision = plan, unchanged, plan.precision
        self.has_sources = sources <= unchanged
        self.same: set[CellRef] = set()  # of the new plan, the cells taken over so far
        self.whole: set[str] = set()  # nodes of which all cells are taken over
        self.settled: Once[Settled] = Once()

    def begin(self, precision: str) -> dict[Grid, Grid]:
        """Return the grids of the earlier plan, each mapped to itself; if the precision differs, take no cells over."""
        if precision != self.precision:
            self.unchanged = frozenset()
            return {}
        every = {cell.settled for cell in self.plan.cells.values()}
        return {grid: grid for settled in every for grid in settled.grids.values()}

    def all_of(self, node: Node, recipe: Recipes) -> list[Cell] | None:
        """Return all cells of a node if they and everything that they read and look at are unchanged; else None."""
        read = {source for bound in node.inputs for _, source, _ in bound}
        seen = {name for _, _, names in node.looks_at for name in names}
        if node.name not in self.unchanged or not self.whole.issuperset(read | seen):
            return None
        self.whole.add(node.name)
        cells = [self.take(cell, recipe) for cell in self.plan.of(node.name)]
        self.same.update(cell.ref for cell in cells)
        return cells

    def find(self, name: str, index: tuple[int, ...], recipe: Recipes) -> Cell | None:
        """Return the previous cell if its stage and everything that it reads and looks at are unchanged; else None."""
        cell = self.plan.cells.get((name, index)) if name in self.unchanged else None
        if cell is None:
            return None
        same = self.same
        if not all(ref in same for _, ref, _ in cell.inputs):
            return None
        if not all(ref in same for _, refs in cell.looks_at for ref in refs):
            return None
        same.add(cell.ref)
        return self.take(cell, recipe)

    def take(self, cell: Cell, recipe: Recipes) -> Cell:
        """Return a copy of a cell for the new plan, without references to the earlier plan."""
        settled = self.settled((cell.settled,), lambda: replace(cell.settled, recipe=recipe))
        return cell.taken(settled)


def nearest_of(plans: Sequence[Plan], graph: Graph, pipeline: PipelineFile, choice: Choice) -> Earlier | None:
    """Return the earlier plan with the most unchanged nodes; None if all were decided with other options."""
    sources = frozenset(node.name for node in graph.nodes if node.is_source)
    alike = [one for one in plans if _decided_alike(one, choice)]
    same = [(one, one.pipeline.seed == pipeline.seed) for one in alike]
    found = [Earlier(one, _unchanged(one, graph, seeded), sources) for one, seeded in same]
    return max(found, key=lambda one: len(one.unchanged), default=None)


def _decided_alike(plan: Plan, choice: Choice) -> bool:
    """Return whether the tolerance, norm, precision and options on which all decisions depend are equal."""
    own = plan.pipeline
    return (own.tolerance, own.norm, own.precision, plan.leaves_out, plan.expected, plan.digits) == (
        choice.tolerance,
        choice.norm,
        choice.precision,
        choice.leave_out,
        choice.expected,
        choice.digits,
    )


def _unchanged(plan: Plan, graph: Graph, same_seed: bool) -> frozenset[str]:
    before = {node.name: node for node in plan.nodes}
    axes = {axis.dim: axis for axis in plan.axes}
    same_axes = {axis.dim for axis in graph.axes if axes.get(axis.dim) == axis}
    same_values = {name for name, value in graph.shared.items() if name in plan.shared and plan.shared[name] == value}

    def unchanged(node: Node) -> bool:
        if not same_seed and (node.is_random or node.draws_anew):
            return False
        if before.get(node.name) != node or not same_axes.issuperset(node.axes):
            return False
        taken = (parameters_of(one.kind).items() for one in node.alternatives)
        return all(name in same_values for own in taken for name, (declared, _, _) in own if declared.shared)

    found = {node.name for node in graph.nodes if unchanged(node)}
    # Whether noise is left out depends on all other noise.
    noisy, former = _noisy(graph.nodes), _noisy(plan.nodes)
    return frozenset(found if noisy == former and found.issuperset(noisy) else found.difference(noisy))


def _noisy(nodes: Sequence[Node]) -> list[str]:
    return [node.name for node in nodes if any(issubclass(one.kind, Noisy) for one in node.alternatives)]
