"""How much a change in one cell may grow on its way to what is wanted: by meters, by gains, and where light is clipped.

In:  the cells of a plan, in order, with the facts of their inputs.
Out: a factor of at least 1 in each cell about which something is decided.

A full well at a hundredth of the brightest light makes an error in the rest a hundred times larger, relative to what
is left. The largest factor of all ways and of all cells that read a cell counts. Where a cell decides a value that
another reader of the same array uses (a metered time), both ways add.

The factor belongs to what is stated, not to what is decided: a decision that looked at later stages would compute the
light again wherever an exposure is edited, and a cell otherwise in a sweep than alone.
"""

from __future__ import annotations

from typing import NamedTuple

from etendue.contract.capabilities import Noisy, Probe
from etendue.contract.stage import Stage, quantities_of
from etendue.plan import stage_calls
from etendue.plan.model import Cell, CellRef


def state_growth(cells: dict[CellRef, Cell]) -> None:
    """Set the growth of every cell with a decision. Bounds on noise are of distributions, and do not grow."""
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
    """What all cells of a node have in common."""

    grows: bool  # its stage states a growth
    elementwise: bool
    plane: bool  # it writes something by place
    given: frozenset[str]  # ports that take a number which other cells find
    planes: frozenset[str]  # ports that read something by place
    seen: bool  # a probe: it passes nothing on


class Steps:
    """How much a change grows in each single stage, found once for every cell."""

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
    """Return the factor of every cell. ``shares``: of changes that are a share of every value. Where light is clipped
    they are the same share of less, and a number that is found from the light changes by that share.
    """
    steps = steps or Steps(cells)
    direct: dict[CellRef, float] = {}
    beside: dict[CellRef, float] = {}
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
            if port in kind.given:  # a number that the other cell finds
                direct[source] = max(direct.get(source, 0.0), factor)
            elif port in kind.planes:
                ways = beside if steers else direct
                ways[source] = max(ways.get(source, 0.0), whole)
    return direct
