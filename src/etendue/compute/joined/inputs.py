"""The input from which the cells of a segment start, and the form in which they pass on their light.

In:  the plan of a cell of a segment.
Out: the input of the segment if the cell has to start from it; whether its light is made band by band.
"""

from __future__ import annotations

from collections.abc import Mapping

from etendue.contract.capabilities import Summed
from etendue.plan.cost import too_large
from etendue.plan.model import Cell, CellRef, Node, Plan
from etendue.transfer.sampling import TOGETHER

Direct = tuple[tuple[CellRef, str], tuple[Cell, ...]]  # the input of a segment; the active cells before its end


def made_by_band(cell: Cell) -> bool:
    """Return whether light that the caller only looks at is transformed back band by band, when it is looked at."""
    planes = (grid.line("y").size * grid.line("x").size for grid in cell.grids.values())
    return not isinstance(cell.stage, Summed) and min(planes) > TOGETHER


def direct_input(plan: Plan, nodes: Mapping[str, Node], cell: Cell) -> Direct | None:
    """Return the segment's input, and the cells between this input and ``cell`` that are not left out, if ``cell`` must
    be computed from the input itself; else None.

    This applies to all cells of a segment whose input is too large for memory or consists of means over grid cells, and
    to a last cell whose sum over bands is an expansion.
    """
    node = nodes[cell.node]
    if not node.segment or cell.segment_input is None or cell.left_out is not None:
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
