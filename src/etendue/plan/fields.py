"""How much of a picture the sensor sees: a chart wider than the field, told before anything is computed.

In:  cells of a plan.
Out: a note for each stage that takes less than half of the light's area, with the axis values at which it takes least.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from etendue.plan.model import Axis, Cell, CellRef, Node
from etendue.spec.grid import Grid, Line

SEEN = 0.5  # of the light's area: whatever lies around less than that was hardly meant to be cropped


class _Field(NamedTuple):
    """Sides of the light in front of a sensor and of what its pixels take, um: (y, x)."""

    light: tuple[float, float]
    taken: tuple[float, float]

    @property
    def share(self) -> float:
        return self.taken[0] * self.taken[1] / (self.light[0] * self.light[1])


def notes_on_cropping(nodes: Sequence[Node], cells: Mapping[CellRef, Cell], axes: Mapping[str, Axis]) -> list[str]:
    """One note a stage: the least that it takes of its light, where, and in how many of its cells it takes less than half.

    ``axes``: by dimension. Of light that is the same everywhere nothing is lost, and nothing said.
    """
    by_node: dict[str, list[tuple[_Field, Cell]]] = {}
    known: dict[tuple[int, int], _Field | None] = {}  # cells share the grids that are equal
    for cell in cells.values():
        place = (id(cell.input_grids), id(cell.grids))
        if place not in known:
            known[place] = _field(cell)
        field = known[place]
        if field is not None and not cell.facts.uniform:
            by_node.setdefault(cell.node, []).append((field, cell))
    return [text for node in nodes for text in _note(node, by_node.get(node.name, []), axes)]


def _note(node: Node, own: Sequence[tuple[_Field, Cell]], axes: Mapping[str, Axis]) -> list[str]:
    cropped = [(field, cell) for field, cell in own if field.share < SEEN]
    if not cropped:
        return []
    least, worst = min(cropped, key=lambda one: one[0].share)
    point = [
        f"{axes[dim].key} = {_value(axes[dim], position)}"
        for number, (dim, position) in enumerate(zip(node.axes, worst.index, strict=True))
        if _matters(own, number)
    ]
    at = f" at {', '.join(point)}" if point else ""
    counted = f" (to less than half of its area in {len(cropped)} of {len(own)} cells)" if len(own) > 1 else ""
    return [
        f"{node.name}: crops the light to its middle {_sides(least.taken)} of {_sides(least.light)}{at}{counted}; where the whole scene is "
        "wanted, make its width and height smaller, or the sensor larger"
    ]


def _field(cell: Cell) -> _Field | None:
    """Of a cell that samples light at pixels; None for all others."""
    light = next((grid for grid in cell.input_grids.values() if _placed(grid, at_pixels=False)), None)
    taken = next((grid for grid in cell.grids.values() if _placed(grid, at_pixels=True)), None)
    return _Field(_lengths(light), _lengths(taken)) if light is not None and taken is not None else None


def _placed(grid: Grid, at_pixels: bool) -> bool:
    """Whether it has both dims of a picture: positions in um, or pixels that know theirs."""
    lines = [grid[dim] for dim in "yx" if dim in grid]
    return len(lines) == 2 and all(isinstance(line, Line) and (line.position is not None) == at_pixels for line in lines)


def _lengths(grid: Grid) -> tuple[float, float]:
    y, x = (grid.line(dim) for dim in "yx")
    return y.size * y.um()[1], x.size * x.um()[1]


def _matters(own: Sequence[tuple[_Field, Cell]], number: int) -> bool:
    """Whether the field changes along a stage's axis."""
    by_value: dict[int, set[float]] = {}
    for field, cell in own:
        by_value.setdefault(cell.index[number], set()).add(field.share)
    return len({frozenset(shares) for shares in by_value.values()}) > 1


def _value(axis: Axis, position: int) -> str:
    value = axis.values[position]
    return f"{value:g} {axis.units}".strip() if isinstance(value, float) else str(value)


def _sides(um: tuple[float, float]) -> str:
    return f"{um[1]:.4g} um x {um[0]:.4g} um"
