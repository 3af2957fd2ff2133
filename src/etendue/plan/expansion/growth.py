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

from etendue.contract.capabilities import Noisy, Probe
from etendue.contract.stage import Stage, quantities_of
from etendue.plan import stage_calls
from etendue.plan.model import Cell, CellRef


def state_growth(cells: dict[CellRef, Cell]) -> None:
    """Set the growth of every cell with a decision. Bounds on noise are of distributions, and do not grow."""
    decided = [cell for cell in cells.values() if (cell.left_out and cell.left_out.bound > 0) or cell.approximated]
    decided = [cell for cell in decided if not isinstance(cell.stage, Noisy)]
    for shares in (False, True):
        own = [cell for cell in decided if cell.stage.pointwise is shares]
        factors = factors_of(cells, shares) if own else {}
        for cell in own:
            cell.growth = factors[cell.ref]


def factors_of(cells: dict[CellRef, Cell], shares: bool) -> dict[CellRef, float]:
    """Return the factor of every cell. ``shares``: of changes that are a share of every value. Where light is clipped
    they are the same share of less, and a number that is found from the light changes by that share.
    """
    direct: dict[CellRef, float] = {}
    beside: dict[CellRef, float] = {}
    for cell in reversed(cells.values()):
        steers = cell.ref in direct and not any("y" in grid for grid in cell.grids.values())
        factor = direct[cell.ref] = max(1.0, direct.get(cell.ref, 1.0) + beside.get(cell.ref, 0.0))
        kind = type(cell.stage)
        if issubclass(kind, Probe):
            continue
        whole = factor
        if kind.growth is not Stage.growth:
            step = stage_calls.growth_of(cell.stage, {port: cells[ref].facts for port, ref, _ in cell.inputs})
            whole *= min(step, 1.0) if shares and (steers or kind.elementwise) else step
        given = quantities_of(kind)
        for port, ref, _ in cell.inputs:
            if port in given:  # a number that the other cell finds
                direct[ref] = max(direct.get(ref, 0.0), factor)
            elif "y" in cell.input_grids.get(port, ()):
                ways = beside if steers else direct
                ways[ref] = max(ways.get(ref, 0.0), whole)
    return direct
