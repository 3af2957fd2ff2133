"""How much a change in one cell may grow on its way to what is wanted: by meters, by gains, and where light is clipped.

In:  the cells of a plan, in order, with the facts of their inputs.
Out: a factor per cell, at least 1.

A full well at a hundredth of the brightest light makes an error in the rest a hundred times larger, relative to what
is left. The largest factor of all ways and of all cells that read a cell counts, so that a decision holds in each of
them. Where a cell decides a value that another reader of the same array uses (a metered time), both ways add.
"""

from __future__ import annotations

from collections.abc import Mapping

from etendue.contract.capabilities import Noisy, Probe
from etendue.contract.stage import quantities_of
from etendue.plan import stage_calls
from etendue.plan.model import Cell, CellRef


def growth_of(cells: Mapping[CellRef, Cell]) -> dict[CellRef, float]:
    """Return the factor of every cell in which something is decided or that is on the way from one."""
    direct: dict[CellRef, float] = {}
    beside: dict[CellRef, float] = {}
    for cell in reversed(cells.values()):
        behind = max(1.0, direct.get(cell.ref, 1.0) + beside.get(cell.ref, 0.0))
        steered = cell.ref in direct and not any("y" in grid for grid in cell.grids.values())
        direct[cell.ref] = behind
        if isinstance(cell.stage, Probe):
            continue
        facts = {port: cells[ref].facts for port, ref, _ in cell.inputs}
        whole = behind * stage_calls.growth_of(cell.stage, facts)
        given = quantities_of(type(cell.stage))
        for port, ref, _ in cell.inputs:
            if port in given:  # a number that the other cell found
                direct[ref] = max(direct.get(ref, 0.0), behind)
            elif "y" in cell.input_grids.get(port, ()):
                ways = beside if steered else direct
                ways[ref] = max(ways.get(ref, 0.0), whole)
    return direct


def changes(cells: Mapping[CellRef, Cell], growth: Mapping[CellRef, float]) -> bool:
    """Return whether growth can change a decision: a bound above 0 of a cell behind which changes grow."""
    return any(
        growth.get(cell.ref, 1.0) > 1 and ((cell.left_out and cell.left_out.bound > 0) or cell.approximated)
        for cell in cells.values()
        if not isinstance(cell.stage, Noisy)
    )
