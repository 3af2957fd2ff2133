"""Maps of metrics for the contact sheet: numbers over two axes of a sweep, drawn small and without matplotlib.

In:  a plan, which gives metrics and axes; later, the metrics of the cells.
Out: (y, x, 3) bytes for each map, with the number in every cell; failed cells are marked.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.contract.arrays.variables import variable as known
from etendue.contract.wording import first
from etendue.plan.marks import not_in_it
from etendue.plan.model import Axis, CellRef, Node, Plan
from etendue.plan.shown import shown_cells
from etendue.present.pictures.contact_sheet import font
from etendue.types.arrays import Array
from etendue.types.documents import AxisValue

if TYPE_CHECKING:
    from PIL import ImageDraw

MOST, LONGEST = 4, 20  # maps, and values along a side: longer axes are thinned out
WIDE, HIGH, LETTERS = 46, 24, 12  # dots of a cell, and of its letters
VIRIDIS = np.array([  # matplotlib's, at eighths
    (68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 144, 141), (39, 173, 129), (92, 200, 99),
    (170, 220, 50), (253, 231, 37),
])  # fmt: skip
NAMED = np.array(
    [(68, 119, 170), (102, 204, 238), (34, 136, 51), (204, 187, 68), (238, 102, 119), (187, 187, 187), (170, 51, 119)]
)
FAILED = (250, 225, 222)


@dataclass(frozen=True)
class SmallMap:
    """A metric of one stage over one or two axes; the other axes are at the values of the pictures."""

    node: str
    variable: str
    unit: str
    sides: tuple[tuple[str, tuple[AxisValue, ...], str], ...]  # along x, then y: name, values, unit
    cells: tuple[CellRef, ...]  # (y, x), row by row
    at: str
    names: tuple[str, ...] = ()  # names that the values, if indices, stand for
    without: tuple[str, ...] = ()  # stages that the metric does not include


def small_maps(plan: Plan) -> list[SmallMap]:
    """Return the maps for the contact sheet of a sweep: of preferred metrics, else of any metrics."""
    found: dict[str, SmallMap] = {}
    for node in reversed(plan.nodes):
        for name, declared in node.writes.items():
            plain = declared.dims in ((), ("stage",)) and (node.name, name) in plan.kept and not known(name).counted
            if plain and name not in found and (one := _map(plan, node, name)) is not None:
                found[name] = one
    order = [name for name in first("sheet") if name in found and known(name).instead not in found] or list(found)
    return [found[name] for name in order[:MOST]]


def _map(plan: Plan, node: Node, name: str) -> SmallMap | None:
    axes = [plan.axis(dim) for dim in node.axes]
    rank = {key: place for place, key in enumerate(first("sides"))}
    varying = sorted((a for a in axes if len(a.values) > 1), key=lambda a: rank.get(a.key, len(rank)))[:2]
    if not varying:
        return None
    index = dict(zip(node.axes, shown_cells(plan)[node.name][1], strict=True))
    chosen = {axis.dim: _some(axis) for axis in varying}
    rest = [axis for axis in axes if axis.dim not in chosen and len(axis.values) > 1]
    units = {axis.dim: f" {axis.units}" if axis.units not in (None, "", "1") else "" for axis in rest}
    at = ", ".join(f"{axis.key} {_text(axis.values[index[axis.dim]])}{units[axis.dim]}" for axis in rest)
    refs = []
    for places in product(*(chosen[axis.dim] for axis in reversed(varying))):  # x varies fastest
        own = {**index, **{axis.dim: place for axis, place in zip(reversed(varying), places, strict=True)}}
        refs.append((node.name, tuple(own[dim] for dim in node.axes)))
    sides = tuple((axis.key, tuple(axis.values[i] for i in chosen[axis.dim]), axis.units or "") for axis in varying)
    names = _names(plan, refs[0], name)
    return SmallMap(node.name, name, node.writes[name].unit, sides, tuple(refs), at, names, not_in_it(plan, node, name))


def _names(plan: Plan, ref: CellRef, name: str) -> tuple[str, ...]:
    """Return the names that an index variable points to."""
    dim = known(name).names if known(name).index else ""
    factors = next((grid[dim] for grid in plan.cells[ref].grids.values() if dim in grid), None) if dim else None
    return tuple(map(str, factors.values())) if factors else ()


def _some(axis: Axis) -> list[int]:
    """Return the positions of as many values along an axis as fit, evenly chosen, numbers in ascending order."""
    places = list(range(len(axis.values)))
    if not any(isinstance(value, str) for value in axis.values):
        places.sort(key=lambda place: float(axis.values[place]))
    return [
        places[i] for i in np.unique(np.linspace(0, len(places) - 1, min(LONGEST, len(places))).round().astype(int))
    ]


def values_of(one: SmallMap, figures: Mapping[CellRef, Mapping[str, Array]]) -> Array:
    """Return the values of a map as (y, x) float64, NaN for missing cells; of several stages, the last."""
    found = [
        float(np.ravel(figures[ref][one.variable])[-1]) if one.variable in figures.get(ref, {}) else math.nan
        for ref in one.cells
    ]
    return np.array(found).reshape(-1, len(one.sides[0][1]))


def drawn(one: SmallMap, values: Array, failed: Array) -> Array:
    """Return a (dots, dots, 3) uint8 picture of the map below its title; x increases to the right, y upwards."""
    from PIL import Image, ImageDraw

    letters = font(LETTERS)
    ys = [_text(v) for v in one.sides[1][1]] if len(one.sides) > 1 else [""]
    xs = [_text(v) for v in one.sides[0][1]]
    left = 10 + max(round(letters.getlength(text)) for text in ys)
    inside = [] if one.names else [_number(v) for v in np.ravel(values) if math.isfinite(v)]
    wide = max(WIDE, 8 + max(round(letters.getlength(text)) for text in (*xs, *inside)))
    title = _title(one)
    rows, columns = values.shape
    legend = 16 if one.names else 0
    texts = [
        left + letters.getlength(_along(one)),
        4 + letters.getlength(title),
        26 * len(one.names) + letters.getlength("".join(one.names)),
    ]
    width = max(left + wide * columns, *(round(length) for length in texts)) + 8
    picture = Image.new("RGB", (width, 22 + HIGH * rows + 36 + legend), "white")
    pen = ImageDraw.Draw(picture)
    pen.text((4, 11), title, fill="black", font=letters, anchor="lm")
    colours = _colours(values, bool(one.names))
    for row, column in np.ndindex(rows, columns):
        x, y, value = left + column * wide, 22 + (rows - 1 - row) * HIGH, values[row, column]
        box, middle = (x, y, x + wide - 1, y + HIGH - 1), (x + wide / 2, y + HIGH / 2)
        if math.isfinite(value):
            colour = tuple(int(c) for c in colours[row, column])
            pen.rectangle(box, fill=colour)
            if not one.names:
                ink = "white" if sum(colour) < 380 else "black"
                pen.text(middle, _number(value), fill=ink, font=letters, anchor="mm")
        else:
            fill, text = (FAILED, "failed") if failed[row, column] else ("white", "-")
            pen.rectangle(box, fill=fill, outline=(215, 215, 215))
            pen.text(middle, text, fill=(150, 60, 60), font=letters, anchor="mm")
    for column, text in enumerate(xs):
        pen.text((left + (column + 0.5) * wide, 22 + HIGH * rows + 8), text, fill="black", font=letters, anchor="mm")
    for row, text in enumerate(ys):
        pen.text((left - 4, 22 + (rows - 0.5 - row) * HIGH), text, fill="black", font=letters, anchor="rm")
    pen.text((left, 22 + HIGH * rows + 25), _along(one), fill="black", font=letters, anchor="lm")
    _draw_names(pen, one.names, 22 + HIGH * rows + 36)
    return np.asarray(picture)


def _draw_names(pen: ImageDraw.ImageDraw, names: Sequence[str], base: int) -> None:
    """Draw the legend of the colours on one line."""
    place, letters = 6, font(LETTERS)
    for number, text in enumerate(names):
        pen.rectangle((place, base, place + 10, base + 10), fill=tuple(int(c) for c in NAMED[number % len(NAMED)]))
        pen.text((place + 14, base + 5), text, fill="black", font=letters, anchor="lm")
        place += 26 + round(letters.getlength(text))


def _colours(values: Array, named: bool) -> Any:
    """Return the (y, x, 3) colours of indices, or of numbers by their position within the range, which is logarithmic
    if it spans more than a factor of thirty.
    """
    if named:
        return NAMED[np.nan_to_num(values).astype(int) % len(NAMED)]
    found = values[np.isfinite(values)]
    low, high = (float(found.min()), float(found.max())) if found.size else (0.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = low > 0 and high / low > 30
        share = (
            np.log(values / low) / math.log(high / low)
            if ratio
            else (values - low) / (high - low)
            if high > low
            else np.zeros_like(values)
        )
    share = np.clip(np.nan_to_num(share), 0, 1) * (len(VIRIDIS) - 1)
    return np.stack([np.interp(share, np.arange(len(VIRIDIS)), VIRIDIS[:, c]) for c in range(3)], axis=-1)


def _title(one: SmallMap) -> str:
    title = f"{one.variable}{f', {one.unit}' if one.unit not in ('', '1') else ''}{f' at {one.at}' if one.at else ''}"
    return title + (f", without {', '.join(one.without)}" if one.without else "")


def _along(one: SmallMap) -> str:
    """Return the titles of both sides as text."""
    names = [f"{name}{f', {unit}' if unit not in ('', '1') else ''}" for name, _, unit in one.sides]
    return f"{names[0]} →" + (f"   {names[1]} ↑" if len(names) > 1 else "")


def _text(value: Any) -> str:
    return str(value) if isinstance(value, str | bool) else f"{float(value):.4g}"


def _number(value: Any) -> str:
    text = f"{value:.2e}" if 0 < abs(value) < 1e-3 else f"{value:.3g}"
    return f"{value:.0f}" if "e+0" in text and abs(value) < 1e5 else text.replace("e-0", "e-").replace("e+0", "e")


def all_drawn(
    maps: Sequence[SmallMap], figures: Mapping[CellRef, Mapping[str, Array]], failed: Sequence[CellRef]
) -> list[Array]:
    """Draw every map whose numbers differ."""
    wrong = set(failed)
    found = []
    for one in maps:
        values = values_of(one, figures)
        if np.unique(values[np.isfinite(values)]).size > 1:
            found.append(drawn(one, values, np.array([ref in wrong for ref in one.cells]).reshape(values.shape)))
    return found
