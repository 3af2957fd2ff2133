"""The factor by which an error of one cell may grow on its way to the wanted variables: by meters, by gains, and by
clipping.

In:  the cells of a plan, in order, with the facts of their inputs.
Out: a factor of at least 1 in each cell that has a decision.

If the full well is a hundredth of the brightest light, clipping makes an error in the unclipped pixels a hundred times
larger relative to full scale. The largest factor over all paths and over all cells that read a cell is used. If a cell
determines a number (a metered time) that another reader of the same array uses, the factors of both paths are added.

The factor enters the stated bounds but not the decisions. If decisions depended on later stages, editing an exposure
would recompute the light, and a cell in a sweep could differ from the same cell alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from etendue.contract.arrays.facts import UNKNOWN
from etendue.contract.capabilities import Noisy, Probe
from etendue.contract.stage import Stage, quantities_of
from etendue.plan import stage_calls
from etendue.plan.identity.once import Once
from etendue.plan.model import Cell, CellRef


def state_growth(cells: dict[CellRef, Cell]) -> None:
    """Set the growth of every cell with a decision. Bounds of noise sources have no growth, because they refer to
    distributions.
    """
    decided = [cell for cell in cells.values() if (cell.left_out and cell.left_out.bound > 0) or cell.approximated]
    decided = [cell for cell in decided if not isinstance(cell.stage, Noisy)]
    if not decided:
        return
    for shares in {cell.stage.pointwise for cell in decided}:
        own = {cell.ref: cell for cell in decided if cell.stage.pointwise is shares}
        for ref, factor in factors_of(cells, shares):
            if ref in own:
                own[ref].growth = factor


class Kind(NamedTuple):
    """Properties that all cells of one node and class share."""

    grows: bool  # the stage defines ``growth``
    elementwise: bool
    plane: bool  # it writes a variable with positions
    given: frozenset[str]  # ports for numbers that other cells compute
    planes: frozenset[str]  # ports that read a variable with positions
    seen: bool  # it is a probe, which passes no light on


class Steps:
    """The growth of an error in each single stage."""

    def __init__(self, cells: dict[CellRef, Cell]) -> None:
        self.cells = cells
        self.kinds: dict[tuple[str, type[Stage]], Kind] = {}
        self.alike: Once[float] = Once()  # of cells that read no facts

    def kind(self, cell: Cell) -> Kind:
        kind = type(cell.stage)
        found = self.kinds.get((cell.ref[0], kind))
        if found is None:
            found = self.kinds[cell.ref[0], kind] = Kind(
                kind.growth is not Stage.growth,
                kind.elementwise,
                any("y" in grid for grid in cell.grids.values()),
                frozenset(quantities_of(kind)),
                frozenset(port for port, grid in cell.input_grids.items() if "y" in grid),
                issubclass(kind, Probe),
            )
        return found

    def step(self, cell: Cell) -> float:
        index = cell.ref[1]
        facts = {port: self.cells[name, at(index)].facts for port, name, _, at in cell.settled.reading.inputs}
        if all(one is UNKNOWN for one in facts.values()):
            return self.alike((cell.stage,), lambda: stage_calls.growth_of(cell.stage, facts), *facts)
        return stage_calls.growth_of(cell.stage, facts)


def factors_of(cells: dict[CellRef, Cell], shares: bool) -> Iterator[tuple[CellRef, float]]:
    """Yield every cell with the factor by which an error of its output may grow, the last cell first. ``shares``: yield
    the factor for changes that multiply every value by nearly the same number. Clipping does not enlarge such changes
    relative to full scale, and a number computed from the light is multiplied by the same number.
    """
    steps = Steps(cells)
    direct: dict[CellRef, float] = {}
    beside: dict[CellRef, float] = {}
    # A cell comes after the cells it reads. In reverse, the factor of a cell is complete before it is passed on.
    for ref, cell in reversed(cells.items()):
        kind, known = steps.kind(cell), direct.pop(ref, None)
        steers = known is not None and not kind.plane
        factor = max(1.0, (known or 1.0) + beside.pop(ref, 0.0))
        yield ref, factor
        if kind.seen:
            continue
        whole = factor
        if kind.grows:
            step = steps.step(cell)
            whole *= min(step, 1.0) if shares and (steers or kind.elementwise) else step
        index = ref[1]
        for port, name, _, at in cell.settled.reading.inputs:
            source = name, at(index)
            if port in kind.given:  # a number that the source computes
                direct[source] = max(direct.get(source, 0.0), factor)
            elif port in kind.planes:
                ways = beside if steers else direct
                ways[source] = max(ways.get(source, 0.0), whole)
