"""Find the grids of the inputs and outputs of a cell.

In:  a stage, its declarations, the grids of its inputs.
Out: the grid of each output; ``CellGrids``, shared by all cells with equal grids.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from etendue.contract.arrays.grid import Coordinate, Grid, Labels
from etendue.contract.arrays.variables import Declaration
from etendue.contract.stage import Stage
from etendue.contract.values.bounds import MOST_POINTS, MOST_VALUES, beyond
from etendue.errors import PluginError
from etendue.plan import stage_calls
from etendue.plan.model import Alternative, CellRef, Node


def output_grid(
    stage: Stage, declaration: Declaration, given: Grid | None, inputs: Mapping[str, Grid], looks_at: Any = ()
) -> Grid:
    """Return the grid of one output. Each dim comes from ``given``, else from ``creates``, else from an input; the dim
    ``stage`` lists the stages looked at.
    """
    creates = stage.creates
    found = {}
    for dim in declaration.dims:
        if given is not None and dim in given:
            found[dim] = given[dim]
        elif dim in creates:
            found[dim] = creates[dim]
        elif dim == "stage" and looks_at:
            found[dim] = Labels(tuple(dict.fromkeys(name for _, refs in looks_at for name, _ in refs)))
        else:
            source = next((g for g in inputs.values() if dim in g), None)
            if source is None:
                raise PluginError(stage_calls.lacking(type(stage), dim, declaration.variable))
            found[dim] = source[dim]
    grid = Grid.of(found)
    for dim, coordinate in grid.entries:
        if coordinate.size > MOST_POINTS:
            raise ValueError(
                f"{declaration.variable} has "
                f"{beyond(coordinate.size, f'points along {dim}', MOST_POINTS, 'make it smaller')}"
            )
    if grid.count > MOST_VALUES:
        raise ValueError(
            f"{declaration.variable} has {beyond(grid.count, 'values in one cell', MOST_VALUES, 'make it smaller')}"
        )
    return grid


@dataclass(frozen=True, eq=False)
class CellGrids:
    """The grids of a cell: of its inputs (complete, and without the dims over which it is mapped) and of its outputs.
    Compared by identity: many cells share one, and comparing grids would take longer than the lookups that use it.
    """

    whole_grids: Mapping[str, Grid]
    input_grids: Mapping[str, Grid]
    grids: Mapping[str, Grid]
    mapped: tuple[tuple[str, Coordinate], ...]


class Draft(NamedTuple):
    """A cell before its decisions."""

    node: Node
    number: int  # number of the alternative
    stage: Stage
    inputs: tuple[tuple[str, CellRef, str], ...]  # (port or shared quantity, cell, variable)
    form: CellGrids

    @property
    def one(self) -> Alternative:
        return self.node.alternatives[self.number]
