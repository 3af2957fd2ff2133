"""Plots of a design: its samples as lines over factors and metrics (parallel coordinates), and as a matrix of scatter
plots.

In:  holdings, metrics, values of the other axes.
Out: a ``Plot``; its rows are the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from etendue.contract.wording import first as goes_first
from etendue.errors import RequestError
from etendue.present.plots.drawing.panels import wrapped
from etendue.present.plots.holdings import HeldVariable, Holdings
from etendue.present.plots.labels import name_text, number_text, places_text, unit_text
from etendue.present.plots.places import resolved
from etendue.present.plots.plot import Plot, new_figure
from etendue.present.plots.rows import factors_of, rows_dim
from etendue.types.arrays import Array
from etendue.types.documents import AxisValues, Document

NOWHERE: AxisValues = MappingProxyType({})
COLOURS = "viridis"


@dataclass(frozen=True)
class Column:
    """One factor or metric over the samples."""

    name: str
    title: str
    values: Array
    names: tuple[str, ...] = ()  # of a factor whose values are no numbers: what its numbers stand for
    metric: bool = False


def columns_of(
    holdings: Holdings, figures: Sequence[str], at: AxisValues, middle: AxisValues
) -> tuple[list[Column], list[Any], str]:
    """Return the factors and metrics in all rows in which every metric is finite, these rows, and a text with the fixed
    values of the other axes.

    Raises
    ------
    RequestError
        The archive has no design, or a metric is unknown.
    """
    dim = rows_dim(holdings)
    if not dim:
        raise RequestError(f"{holdings.archive} holds a grid, not a design; plot it with map or curves")
    held = [holdings.find(name, "figure") for name in figures] or _usual(holdings, dim)
    if not held:
        raise RequestError(f"no metric depends on {dim}; to list all: etendue plot {holdings.archive} --list")
    place = resolved(held, at)
    rows = _rows_of(held, dim)
    found = [_metric(one, dim, rows, place, middle) for one in held]
    there = np.isfinite(np.stack([column.values for column in found])).all(axis=0)
    if not there.any():
        raise RequestError(f"no sample has values of all of {', '.join(one.name for one in held)}")
    factors = [_factor(own.name, own.units, [own.values.get(row) for row in rows]) for own in factors_of(holdings, dim)]
    columns = [Column(one.name, one.title, one.values[there], one.names, one.metric) for one in (*factors, *found)]
    kept = [row for row, is_there in zip(rows, there, strict=True) if is_there]
    units = {name: one.units_of(name) for one in held for name in (*one.axes, *one.dims)}
    return columns, kept, places_text(dict(place), units) if place else ""


def _rows_of(held: Sequence[HeldVariable], dim: str) -> list[Any]:
    """Return the rows of a design for which at least one of these variables is stored; none if a variable is the same
    for all rows.
    """
    if not all(dim in one.axes for one in held):
        return []
    return sorted({row for one in held for row in one.values_of(dim)})


def _usual(holdings: Holdings, dim: str) -> list[HeldVariable]:
    """Return the metrics that are shown by default."""
    own = {one.variable: one for one in holdings.of_kind("figure") if dim in one.axes}
    names = [name for text in (*goes_first("front"), *goes_first("headline")) for name in text.split()]
    plain = [name for name, one in own.items() if not one.dims]
    return [own[name] for name in dict.fromkeys([*(n for n in names if n in own), *plain])][:3]


def _metric(held: HeldVariable, dim: str, rows: Sequence[Any], place: Document, middle: AxisValues) -> Column:
    own = {name: place[name] for name in (*held.axes, *held.dims) if name in place}
    for name in (*held.axes, *held.dims):
        if name not in own and name != dim:
            values = held.values_of(name)
            if name in held.dims and name != "stage":
                raise RequestError(f"{held.name} has the dim {name}: choose one with --at {name}={values[0]}")
            usual = values[-1] if name in held.dims else middle.get(name, values[len(values) // 2])
            own[name] = place[name] = usual
    found = held.values({name: value for name, value in own.items() if name in held.axes})
    found = found.sel({name: value for name, value in own.items() if name in found.dims})
    where = dict(zip(found[dim].values.tolist(), np.ravel(found.values).tolist(), strict=True))
    unit = unit_text(held.units)
    title = f"{held.title}{f', {unit}' if unit else ''}"
    return Column(held.name, title, np.array([where.get(row, np.nan) for row in rows], float), (), True)


def _factor(name: str, units: str, values: Sequence[Any]) -> Column:
    if any(isinstance(value, str) for value in values):
        names = tuple(dict.fromkeys(str(value) for value in values))
        return Column(name, name_text(name), np.array([names.index(str(value)) for value in values], float), names)
    numbers = np.array([np.nan if value is None else float(value) for value in values])
    return Column(name, name_text(name, units), numbers)


def _plot(figure: Any, columns: Sequence[Column], rows: Sequence[Any]) -> Plot:
    values = [[column.names[int(v)] if column.names else float(v) for v in column.values] for column in columns]
    return Plot(figure, ["row", *(column.name for column in columns)], [*zip(rows, *values, strict=True)])


def _title(holdings: Holdings, what: str, fixed: str) -> str:
    return ": ".join(filter(None, [holdings.pipeline, ", ".join(filter(None, [what, fixed]))]))


def parallel(
    holdings: Holdings, figures: Sequence[str] = (), at: AxisValues = NOWHERE, middle: AxisValues = NOWHERE
) -> Plot:
    """Plot every sample as a line over all factors and metrics, coloured by the last metric."""
    columns, rows, fixed = columns_of(holdings, figures, at, middle)
    from matplotlib import colormaps

    figure = new_figure(max(6.0, 1.35 * len(columns) + 1.2), 4.8)
    axes = figure.add_subplot()
    scaled = np.stack([_share(column.values) for column in columns], axis=1)
    tints: Any = colormaps[COLOURS](scaled[:, -1])
    for number in np.argsort(scaled[:, -1], kind="stable"):
        axes.plot(range(len(columns)), scaled[number], color=tints[number], linewidth=0.9, alpha=0.6, zorder=2)
    for place, column in enumerate(columns):
        axes.axvline(place, color="0.25", linewidth=1.4 if column.metric else 0.8, zorder=3)
        for text, height in _ticks(column):
            axes.annotate(
                text,
                (place, height),
                (3, 0),
                textcoords="offset points",
                fontsize=6.5,
                va="center",
                zorder=4,
                bbox={"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6},
            )
    axes.set_xticks(range(len(columns)), [wrapped(column.title, 1.3) for column in columns], fontsize=7.5)
    axes.set_yticks([])
    axes.set_xlim(-0.15, len(columns) - 0.45)
    axes.set_ylim(-0.04, 1.04)
    for side in axes.spines.values():
        side.set_visible(False)
    count = f"{len(rows)} samples, coloured by {columns[-1].title}"
    axes.set_title(wrapped(_title(holdings, count, fixed), 1.35 * len(columns)), fontsize=9.5)
    return _plot(figure, columns, rows)


def _share(values: Array) -> Array:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    return np.asarray((values - low) / (high - low) if high > low else np.full(len(values), 0.5))


def _ticks(column: Column) -> list[tuple[str, float]]:
    """Return the tick labels of an axis, and their heights as fractions of the axis."""
    if column.names:
        most = max(len(column.names) - 1, 1)
        return [(name.replace("_", " "), place / most) for place, name in enumerate(column.names)]
    low, high = float(np.nanmin(column.values)), float(np.nanmax(column.values))
    if low == high:
        return [(number_text(low), 0.5)]
    return [(number_text(low + share * (high - low)), share) for share in (0.0, 0.25, 0.5, 0.75, 1.0)]


def scatter(
    holdings: Holdings, figures: Sequence[str] = (), at: AxisValues = NOWHERE, middle: AxisValues = NOWHERE
) -> Plot:
    """Plot every pair of factors and metrics of the samples against each other, with histograms on the diagonal."""
    columns, rows, fixed = columns_of(holdings, figures, at, middle)
    from matplotlib import colormaps

    count = len(columns)
    figure = new_figure(1.35 * count + 0.8, 1.35 * count + 0.9)
    grid = figure.subplots(count, count, squeeze=False)
    tints: Any = colormaps[COLOURS](_share(columns[-1].values))
    for i, below in enumerate(columns):
        for j, across in enumerate(columns):
            axes = grid[i, j]
            if i == j:
                axes.hist(across.values, bins=min(20, max(4, len(rows) // 6)), color="0.6", linewidth=0)
                axes.set_yticks([])
            elif j > i:
                axes.set_visible(False)
                continue
            else:
                axes.scatter(across.values, below.values, c=tints, s=7, linewidths=0, alpha=0.8)
            _sides(axes, below, across, i == count - 1, j == 0 and i > 0)
    count_text = f"{len(rows)} samples, coloured by {columns[-1].title}"
    figure.suptitle(wrapped(_title(holdings, count_text, fixed), 1.2 * count), fontsize=9.5)
    return _plot(figure, columns, rows)


def _sides(axes: Any, below: Column, across: Column, last: bool, first: bool) -> None:
    axes.tick_params(labelsize=5.5, labelbottom=last, labelleft=first, length=2)
    if last:
        axes.set_xlabel(wrapped(across.title, 1.3), fontsize=6.5)
    if first:
        axes.set_ylabel(wrapped(below.title, 1.3), fontsize=6.5)
    for column, set_ticks in ((across, axes.set_xticks), (below, axes.set_yticks)):
        if column.names and (column is across or first):
            texts = [name.replace("_", " ")[:10] for name in column.names]
            set_ticks(range(len(column.names)), texts if (last if column is across else first) else [])
