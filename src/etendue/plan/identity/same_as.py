"""Find the variables that need no array of their own: all their cells are left out, so another stage has their values.

In:  cells with their decisions, the kept variables, and the variables for which a copy is requested.
Out: by stage and variable, the stage that has the values. That stage is computed, or stores copies itself.

A variable keeps its own array if only some of its cells are left out, if no stage with the same values is kept, if
several stages have the values, for example different ones for the alternatives of an axis, or if the stage that has
them depends on an axis that this stage lacks (the samples of fewer factors of a design).
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from typing import TYPE_CHECKING

from etendue.contract.arrays.grid import Coordinate, Line

if TYPE_CHECKING:
    from etendue.plan.model import Cell, CellRef, Node

StageVariable = tuple[str, str]


def same_as(
    nodes: Sequence[Node],
    cells: Mapping[str, Sequence[Cell]],
    by_ref: Mapping[CellRef, Cell],
    kept: Collection[StageVariable],
    copied: Collection[StageVariable],
) -> dict[StageVariable, str]:
    """Return, for each kept variable that needs no array of its own, the stage that has its values."""
    found: dict[StageVariable, str] = {}
    axes = {node.name: set(node.axes) for node in nodes}
    for node in nodes:
        own = cells.get(node.name, ())
        if not own or any(cell.left_out is None for cell in own):
            continue
        for variable, declared in node.writes.items():
            place = (node.name, variable)
            if place not in kept or place in copied or declared.optional:
                continue
            holder = _holder(own, variable, by_ref, kept, found)
            if holder and axes[holder] <= axes[node.name]:
                found[place] = holder
    return found


def _holder(
    cells: Sequence[Cell],
    variable: str,
    by_ref: Mapping[CellRef, Cell],
    kept: Collection[StageVariable],
    known: Mapping[StageVariable, str],
) -> str:
    """Return the one stage that has the values of all these cells; '' if there is none.

    The groups of a stage in an archive are distinguished by shape, so all cells of one shape must have a source of one
    shape.
    """
    stages: set[str] = set()
    shapes: dict[Hashable, Hashable] = {}
    for cell in cells:
        source = holding(by_ref, cell, variable, kept)
        if source is None:
            return ""
        stages.add(known.get((source.node, variable), source.node))
        own, other = (frozenset(shape_of(one).items()) for one in (cell, source))
        if len(stages) > 1 or shapes.setdefault(own, other) != other:
            return ""
    return stages.pop()


def source_of(cell: Cell, variable: str) -> CellRef | None:
    """Return the cell that computed the array which a left-out cell passes on as its variable; None if it does not pass
    this variable on.
    """
    return next((ref for _, ref, name in cell.inputs if name == variable), None) if cell.left_out else None


def holding(cells: Mapping[CellRef, Cell], cell: Cell, variable: str, kept: Collection[StageVariable]) -> Cell | None:
    """Return the nearest cell before a left-out cell that has the same values in a kept variable; None if there is
    none.
    """
    ref = source_of(cell, variable)
    while ref is not None and (ref[0], variable) not in kept:
        ref = source_of(cells[ref], variable)
    return None if ref is None else cells[ref]


def of_cell(cells: Mapping[CellRef, Cell], ref: CellRef, variable: str, holder: str) -> CellRef:
    """Return the cell of the stage ``holder`` that has the values of a cell that is left out."""
    while ref[0] != holder:
        source = source_of(cells[ref], variable)
        assert source is not None
        ref = source
    return ref


def shape_of(cell: Cell) -> dict[str, tuple[int, Coordinate | None]]:
    """Return the size, and the bins or labels, of every dim of a cell's outputs."""
    found: dict[str, tuple[int, Coordinate | None]] = {}
    for grid in cell.grids.values():
        for dim, coordinate in grid.entries:
            found.setdefault(dim, (coordinate.size, None if isinstance(coordinate, Line) else coordinate))
    return found
