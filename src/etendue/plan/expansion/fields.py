"""Check how pixels sample a scene, before anything is computed: report a chart wider than the field, or drawn softer
than the pixels resolve.

In:  cells of a plan.
Out: notes, each with the axis values of the worst cell.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

from etendue.contract.arrays.grid import Grid, Line
from etendue.contract.wording import words
from etendue.plan.cost import counted as counted_alike
from etendue.plan.identity.once import Once
from etendue.plan.model import Axis, Cell, CellRef, Node, scene_of

# least contrast that a rendering must leave at the pixels' Nyquist frequency; two samples per pixel leave 0.29
CRISP = 0.25
SEEN = 0.5  # share of the light's area; a crop to less than this is unlikely to be intended


class _Field(NamedTuple):
    """Side lengths of the incident light and of the part that the pixels take, and the pixel pitch, in um: (y, x)."""

    light: tuple[float, float]
    taken: tuple[float, float]
    pitch: tuple[float, float]

    @property
    def share(self) -> float:
        return self.taken[0] * self.taken[1] / (self.light[0] * self.light[1])


def notes_on_the_scene(nodes: Sequence[Node], cells: Mapping[CellRef, Cell], axes: Mapping[str, Axis]) -> list[str]:
    """Return notes on cropping and on softness, at most one of each for every stage that samples light at pixels.

    A note reports the cell that uses the smallest share of its light, if this is less than half of the area. Softness
    is noted for the cell whose pixels are finest relative to the rendering of the chart, if the rendering leaves less
    than a quarter of the contrast at their Nyquist frequency. Uniform light loses nothing and is skipped. ``axes`` is
    by dimension.
    """
    by_node: dict[str, list[tuple[_Field, Cell]]] = {}
    known: Once[_Field | None] = Once()  # cells share equal grids
    sampling = {
        cell.settled
        for cell, _ in counted_alike(cells.values())
        if known((cell.grids, cell.input_grids), partial(_field, cell)) is not None
    }
    for cell in cells.values():
        if cell.settled not in sampling:
            continue
        field = known((cell.grids, cell.input_grids), partial(_field, cell))
        if field is not None and not cell.facts.uniform:
            by_node.setdefault(cell.node, []).append((field, cell))
    held = [(node, by_node[node.name]) for node in nodes if node.name in by_node]
    return [text for node, own in held for text in (*_cropped(node, own, axes), *_softened(node, own, cells, axes))]


def _cropped(node: Node, own: Sequence[tuple[_Field, Cell]], axes: Mapping[str, Axis]) -> list[str]:
    cropped = [(field, cell) for field, cell in own if field.share < SEEN]
    if not cropped:
        return []
    least, worst = min(cropped, key=lambda one: one[0].share)
    at = _where(node, worst, [(field.share, cell) for field, cell in own], axes)
    counted = f" (to less than half of its area in {len(cropped)} of {len(own)} cells)" if len(own) > 1 else ""
    return [
        f"{node.name}: crops the light to its central {_sides(least.taken)} of {_sides(least.light)}{at}{counted}; "
        f"to keep the whole scene, "
        f"reduce its width and height or enlarge the {words()['frame']}"
    ]


def _softened(
    node: Node, own: Sequence[tuple[_Field, Cell]], cells: Mapping[CellRef, Cell], axes: Mapping[str, Axis]
) -> list[str]:
    left: list[tuple[float, Cell]] = []
    known: dict[tuple[tuple[float, float] | None, float], float] = {}
    for field, cell in own:
        scene = scene_of(cells, cell)
        place = (scene.facts.rendered, min(field.pitch))
        if place not in known:
            known[place] = _contrast_left(scene.facts.rendered, min(field.pitch))
        left.append((known[place], cell))
    worst, cell = min(left, key=lambda one: one[0])
    if worst >= CRISP:
        return []
    scene = scene_of(cells, cell)
    return [
        f"{scene.node}: its rendering leaves {100 * worst:.2g} % of the contrast at the Nyquist frequency of "
        f"{node.name}"
        f"{_where(node, cell, left, axes)}: the resolution measured in its pictures is lower than the "
        "resolution of the "
        f"{words()['whole']}; "
        "use a finer spacing"
    ]


def _contrast_left(rendered: tuple[float, float] | None, pitch: float) -> float:
    """Return the contrast at half a cycle per pixel after a Gaussian blur and an average over cells, given as (rms
    width, side) in um; 1 for a scene that is no chart.
    """
    if rendered is None:
        return 1.0
    sigma, cell = rendered
    frequency = 0.5 / pitch
    mean = math.pi * frequency * cell
    return math.exp(-2 * (math.pi * frequency * sigma) ** 2) * (abs(math.sin(mean) / mean) if mean else 1.0)


def _where(node: Node, worst: Cell, own: Sequence[tuple[float, Cell]], axes: Mapping[str, Axis]) -> str:
    """Return the axis values of a cell, for the axes along which the number changes."""
    point = [
        f"{axes[dim].key} = {_value(axes[dim], position)}"
        for number, (dim, position) in enumerate(zip(node.axes, worst.index, strict=True))
        if _matters(own, number)
    ]
    return f" at {', '.join(point)}" if point else ""


def _field(cell: Cell) -> _Field | None:
    """Return the field of a cell that samples light at pixels; None for all others."""
    light = next((grid for grid in cell.input_grids.values() if _placed(grid, at_pixels=False)), None)
    taken = next((grid for grid in cell.grids.values() if _placed(grid, at_pixels=True)), None)
    if light is None or taken is None:
        return None
    y, x = (taken.line(dim).um()[1] for dim in "yx")
    return _Field(_lengths(light), _lengths(taken), (y, x))


def _placed(grid: Grid, at_pixels: bool) -> bool:
    """Return whether a grid has both dims of a picture, as positions in um or as pixels with positions."""
    lines = [grid[dim] for dim in "yx" if dim in grid]
    return len(lines) == 2 and all(
        isinstance(line, Line) and (line.position is not None) == at_pixels for line in lines
    )


def _lengths(grid: Grid) -> tuple[float, float]:
    y, x = (grid.line(dim) for dim in "yx")
    return y.size * y.um()[1], x.size * x.um()[1]


def _matters(own: Sequence[tuple[float, Cell]], number: int) -> bool:
    """Return whether a number changes along an axis of a stage."""
    by_value: dict[int, set[float]] = {}
    for figure, cell in own:
        by_value.setdefault(cell.index[number], set()).add(figure)
    return len({frozenset(figures) for figures in by_value.values()}) > 1


def _value(axis: Axis, position: int) -> str:
    value = axis.values[position]
    return f"{value:g} {axis.units}".strip() if isinstance(value, float) else str(value)


def _sides(um: tuple[float, float]) -> str:
    return f"{um[1]:.4g} um x {um[0]:.4g} um"
