"""Maps: a metric over two axes of a sweep, its value in every cell; further axes and names such as stages as panels.

In:  holdings, the name of a metric, the place of each axis.
Out: a ``Plot``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.contract.arrays.variables import without
from etendue.contract.wording import first
from etendue.errors import RequestError
from etendue.present.plots.arrangement import Arrangement, PlotDim, arranged, dims_of
from etendue.present.plots.drawing.panels import Sides, map_of_figures, map_of_names
from etendue.present.plots.holdings import HeldVariable, Holdings
from etendue.present.plots.labels import bare_text, unit_text
from etendue.present.plots.places import resolved
from etendue.present.plots.plot import Plot
from etendue.types.arrays import Array
from etendue.types.documents import AxisValues

if TYPE_CHECKING:
    import xarray


def figure_map(
    holdings: Holdings,
    figure: str = "",
    x: str = "",
    y: str = "",
    panels: Sequence[str] = (),
    at: AxisValues | None = None,
    middle: AxisValues | None = None,
) -> Plot:
    """Plot a map of a metric, or of the names that an index points to. Without ``figure`` a suitable metric is chosen.

    Raises
    ------
    RequestError
        Unknown metric, axis or value.
    """
    held = holdings.find(figure, "figure") if figure else preferred(holdings)
    if held.known.index:
        return factor_map(holdings, held.name, x, y, panels, at, middle)
    place = arranged(dims_of([held]), 2, (x, y), panels, resolved([held], at or {}), middle=middle)
    values, failed, there = laid_out(held, place)
    drawn = map_of_figures(
        values, _sides(place), _title(held.caption, holdings, place), unit_text(held.units), failed=failed, there=there
    )
    return Plot(drawn, *_table(held, place, values))


def factor_map(
    holdings: Holdings,
    figure: str = "",
    x: str = "",
    y: str = "",
    panels: Sequence[str] = (),
    at: AxisValues | None = None,
    middle: AxisValues | None = None,
) -> Plot:
    """Plot a map over two axes of the names that an index points to, such as the limiting factor.

    Raises
    ------
    RequestError
        There is no index, or it has no names; unknown axis or value.
    """
    indices = [one for one in holdings.of_kind("figure") if one.known.index]
    if not figure and not indices:
        raise RequestError("no limiting factors stored: no metric is an index into a list of names")
    held = holdings.find(figure, "figure") if figure else indices[-1]
    names = names_of(held)
    if not names:
        raise RequestError(f"{held.name} is a plain number, not an index into names; use map")
    place = arranged(dims_of([held]), 2, (x, y), panels, resolved([held], at or {}), middle=middle)
    values, failed, _ = laid_out(held, place)
    what = f"{held.known.asks}{without(held.attrs)}" if held.known.asks else held.title
    title = _title(what, holdings, place)
    drawn = map_of_names(values, names, _sides(place), title, failed, tints=held.known.tints)
    columns, rows = _table(held, place, values)
    named = [[*row[:-1], names[int(row[-1])] if np.isfinite(row[-1]) else ""] for row in rows]
    return Plot(drawn, columns, named)


def preferred(holdings: Holdings) -> HeldVariable:
    """Return the metric plotted by default: the first preferred metric that varies, else another metric."""
    figures = [one for one in holdings.of_kind("figure") if not one.known.counted]
    if not figures:
        raise RequestError(
            "no metrics stored, only pictures; plot them with strip, or keep a stage that writes metrics"
        )
    varying = [one for one in figures if one.axes] or figures
    for name in first("map"):
        for one in reversed(varying):
            if one.variable == name:
                return one
    return varying[-1]


def names_of(held: HeldVariable) -> list[str]:
    """Return the names that an index points to: from its attributes, else from the labels beside it."""
    said = str(held.attrs.get("flag_meanings", "")).split()
    group = held.groups[0]
    dim = held.known.names
    beside = [str(name) for name in group[dim].values.tolist()] if dim in group.coords else []
    return said or beside


def laid_out(held: HeldVariable, place: Arrangement) -> tuple[Array, Array, Array]:
    """Return three (panel, y, x) arrays: the values, whether the cell failed, and whether it was computed."""
    at = {dim: value for dim, value in place.fixed.items() if dim in (*held.axes, *held.dims)}
    values, failed = held.values(at), held.failed(at)
    there = held.there(at)
    own = {dim: value for dim, value in at.items() if dim in values.dims}
    values = values.sel(own)
    order = [*(dim.name for dim in place.panels), *(side.name for side in (place.y, place.x) if side)]
    sizes = [_size(side) for side in (place.y, place.x)]
    found = [np.asarray(values.transpose(*order).values, float).reshape(-1, *sizes)]
    for flags in (failed, there):
        found.append(np.broadcast_to(_over(flags, order, values), values.transpose(*order).shape).reshape(-1, *sizes))
    return found[0], found[1], found[2]


def _over(flags: xarray.DataArray, order: Sequence[str], values: xarray.DataArray) -> Array:
    """Broadcast flags, which have only the axes of the sweep, to all dims of the values."""
    whole = flags.expand_dims({dim: values.sizes[dim] for dim in order if dim not in flags.dims})
    return whole.transpose(*order).values


def _size(side: PlotDim | None) -> int:
    return len(side.values) if side else 1


def _sides(place: Arrangement) -> Sides:
    x, y = place.x, place.y
    labels = [
        ", ".join(dim.text(v) for dim, v in zip(place.panels, own, strict=True))
        for own in product(*(d.values for d in place.panels))
    ]
    columns = 0
    if len(place.panels) == 2:
        columns = len(place.panels[1].values)
    return Sides(
        [bare_text(v, x.units, x.name) for v in x.values] if x else [""],
        [bare_text(v, y.units, y.name) for v in y.values] if y else [""],
        labels,
        x.title if x else "",
        y.title if y else "",
        columns,
    )


def _title(what: str, holdings: Holdings, place: Arrangement) -> str:
    text = f"{holdings.pipeline}: {what}" if holdings.pipeline else what
    return f"{text}, at {place.at}" if place.at else text


def _table(held: HeldVariable, place: Arrangement, values: Array) -> tuple[list[str], list[list[Any]]]:
    """Return the names of the columns, and a row for each plotted number."""
    dims = [*place.panels, *(side for side in (place.y, place.x) if side)]
    fixed = [name for name in place.fixed if name in (*held.axes, *held.dims)]
    columns = [*fixed, *(dim.name for dim in dims), held.variable]
    at = [place.fixed[name] for name in fixed]
    rows = [
        [*at, *own, float(v)] for own, v in zip(product(*(dim.values for dim in dims)), np.ravel(values), strict=True)
    ]
    return columns, rows
