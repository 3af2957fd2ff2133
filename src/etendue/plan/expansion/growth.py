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

from typing import NamedTuple

from etendue.contract.capabilities import Noisy, Probe
from etendue.contract.stage import Stage, quantities_of
from etendue.plan import stage_calls
from etendue.plan.model import Cell, CellRef


def state_growth(cells: dict[CellRef, Cell]) -> None:
    """Set the growth of every cell with a decision. Bounds on noise refer to distributions and have no growth."""
    decided = [cell for cell in cells.values() if (cell.left_out and cell.left_out.bound > 0) or cell.approximated]
    decided = [cell for cell in decided if not isinstance(cell.stage, Noisy)]
    if not decided:
        return
    steps = Steps(cells)
    for shares in (False, True):
        own = [cell for cell in decided if cell.stage.pointwise is shares]
        factors = factors_of(cells, shares, steps) if own else {}
        for cell in own:
            cell.growth = factors[cell.ref]


class Kind(NamedTuple):
    """Properties that all cells of one node and class share."""

    grows: bool  # the stage defines ``growth``
    elementwise: bool
    plane: bool  # it writes a variable with positions
    given: frozenset[str]  # ports for numbers that other cells compute
    planes: frozenset[str]  # ports that read a variable with positions
    seen: bool  # it is a probe, which passes no light on


class Steps:
    """The growth of an error in each single stage, cached by cell."""

    def __init__(self, cells: dict[CellRef, Cell]) -> None:
        self.cells = cells
        self.kinds: dict[tuple[str, type[Stage]], Kind] = {}
        self.known: dict[CellRef, float] = {}

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
        found = self.known.get(cell.ref)
        if found is None:
            facts = {port: self.cells[ref].facts for port, ref, _ in cell.inputs}
            found = self.known[cell.ref] = stage_calls.growth_of(cell.stage, facts)
        return found


def factors_of(cells: dict[CellRef, Cell], shares: bool, steps: Steps | None = None) -> dict[CellRef, float]:
    """Return the factor of every cell. ``shares``: for changes that multiply every value by nearly the same factor.
    Clipping does not enlarge such changes relative to full scale, and a number computed from the light changes by the
    same factor.
    """
    steps = steps or Steps(cells)
    direct: dict[CellRef, float] = {}
    beside: dict[CellRef, float] = {}
    # A cell comes after the cells it reads. In reverse, the factor of a cell is complete before it is passed on.
    for ref, cell in reversed(cells.items()):
        kind, known = steps.kind(cell), direct.get(ref)
        steers = known is not None and not kind.plane
        factor = direct[ref] = max(1.0, (known or 1.0) + beside.get(ref, 0.0))
        if kind.seen:
            continue
        whole = factor
        if kind.grows:
            step = steps.step(cell)
            whole *= min(step, 1.0) if shares and (steers or kind.elementwise) else step
        for port, source, _ in cell.inputs:
            if port in kind.given:  # a number that the source computes
                direct[source] = max(direct.get(source, 0.0), factor)
            elif port in kind.planes:
                ways = beside if steers else direct
                ways[source] = max(ways.get(source, 0.0), whole)
    return direct
