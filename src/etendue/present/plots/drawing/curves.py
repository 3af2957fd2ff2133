"""Curves: a variable over its own dim, such as frequency or signal, or a metric over an axis of the sweep.

In:  holdings, the name of a variable, the dim along x, the dims shown as lines and as panels.
Out: a ``Plot``. A line marks the natural end of an axis, such as the Nyquist frequency: at half a cycle per pixel, or
     at the value of a variable with an ``end`` in the same unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.contract.arrays.variables import variable as known
from etendue.contract.wording import first
from etendue.errors import RequestError, nearest
from etendue.present.plots.arrangement import Arrangement, PlotDim, arranged, dims_of
from etendue.present.plots.drawing.maps import preferred
from etendue.present.plots.drawing.panels import wrapped
from etendue.present.plots.holdings import HeldVariable, Holdings
from etendue.present.plots.labels import name_text, unit_text
from etendue.present.plots.places import resolved
from etendue.present.plots.plot import Plot, new_figure
from etendue.types.documents import AxisValues, Document

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_LINES, MOST_PANELS = 12, 9
NYQUIST = "Nyquist"
PER_PIXEL = ("pixel-1", "cycles/pixel")


def curves(
    holdings: Holdings,
    variable: str = "",
    x: str = "",
    lines: str = "",
    panels: Sequence[str] = (),
    at: AxisValues | None = None,
    middle: AxisValues | None = None,
) -> Plot:
    """Plot a variable as curves. ``x``: an axis, or a coordinate or variable along the dim of the curve; ``lines``: the
    dim shown as separate lines.

    Raises
    ------
    RequestError
        Unknown variable, dim or value.
    """
    held = holdings.find(variable, "curve", "figure") if variable else _preferred(holdings)
    free = [dim for dim in held.dims if held.is_counted(dim)]
    chosen = resolved([held], at or {})
    dims = [dim for dim in dims_of([held]) if dim.name not in free]
    along, beside = _along(held, x, free, dims)
    rest = [dim for dim in dims if dim.name != along]
    lines = _told_apart(lines, rest, chosen)
    place = arranged(rest, 0 if not lines else 1, (lines,), panels, chosen, MOST_PANELS, middle)
    hue = place.x if lines else None
    figure, grid = _figure(place.panels)
    columns = [
        *place.fixed,
        *(dim.name for dim in place.panels),
        *([hue.name] if hue else []),
        beside or along,
        held.variable,
    ]
    rows, ended = _draw_panels(grid, place, holdings, held, (along, beside), hue)
    spread = next((dim for dim in dims if dim.name == along and along in held.axes and dim.spread), None)
    _scale(grid, held, spread)
    words = f"{holdings.pipeline}: {held.caption}" if holdings.pipeline else held.caption
    figure.suptitle(wrapped(f"{words}, at {place.at}" if place.at else words, figure.get_figwidth()), fontsize=10)
    _legend(figure, grid[0], ended)
    return Plot(figure, columns, rows)


def _scale(grid: Sequence[Axes], held: HeldVariable, spread: PlotDim | None) -> None:
    """Set scales and labels; ``spread``: the dim along x if its values require a logarithmic scale, else None."""
    unit = unit_text(held.units)
    for axes in grid:
        if spread is not None:
            axes.set_xscale("log")
            _plain_ticks(axes, spread.values)
        if held.known.base and held.units == "1":
            axes.axhline(0, color="0.8", linewidth=0.7, zorder=0)
    grid[0].set_ylabel(wrapped(f"{held.title}{f', {unit}' if unit else ''}", 3.4), fontsize=8.5)


def _draw_panels(
    grid: Sequence[Axes],
    place: Arrangement,
    holdings: Holdings,
    held: HeldVariable,
    x: tuple[str, str],
    hue: PlotDim | None,
) -> tuple[list[list[Any]], str]:
    """Draw all panels; return the plotted numbers and the name of the end of x."""
    rows: list[list[Any]] = []
    ended = ""
    for axes, where in zip(grid, product(*(dim.values for dim in place.panels)), strict=True):
        own = {**place.fixed, **dict(zip((dim.name for dim in place.panels), where, strict=True))}
        drawn, title, end = _draw_lines(axes, holdings, held, x, hue, own)
        rows += drawn
        ended = end or ended
        axes.set_title(", ".join(dim.text(v) for dim, v in zip(place.panels, where, strict=True)), fontsize=9)
        axes.grid(color="0.93")
        axes.tick_params(labelsize=7.5)
        axes.set_xlabel(title, fontsize=8.5)
    return rows, ended


def _draw_lines(
    axes: Axes, holdings: Holdings, held: HeldVariable, x: tuple[str, str], hue: PlotDim | None, at: AxisValues
) -> tuple[list[list[Any]], str, str]:
    """Draw the lines of a panel and mark the end of x; return the plotted numbers, the title of x, and the name of the
    end.
    """
    rows: list[list[Any]] = []
    title, ended, seen = "", "", set()
    for colour, value in zip(_colours(hue), hue.values if hue else [None], strict=True):
        full = {**at, **({hue.name: value} if hue else {})}
        values = held.values(full)
        values = values.sel({d: v for d, v in full.items() if d in values.dims})
        xs, units, title = _x_of(held, *x, full)
        ys = np.asarray(values.values, float)
        dots: Document = {"marker": "o", "markersize": 3.5} if len(xs) <= 24 else {}
        axes.plot(xs, ys, color=colour, label=hue.text(value) if hue else None, linewidth=1.4, **dots)
        rows += [[*full.values(), float(a), float(b)] for a, b in zip(xs, ys, strict=True)]
        end = _end(holdings, held, full, units)
        if end is not None and end not in seen:
            seen.add(end)
            ended = end[1]
            axes.axvline(end[0], color="0.6", linestyle="--", linewidth=0.9, zorder=0)
    return rows, title, ended


def _preferred(holdings: Holdings) -> HeldVariable:
    found = holdings.of_kind("curve")
    for name in first("curves"):
        for one in reversed(found):
            if one.variable == name:
                return one
    return found[-1] if found else preferred(holdings)


def _along(held: HeldVariable, x: str, free: Sequence[str], dims: Sequence[PlotDim]) -> tuple[str, str]:
    """Return the dim along x, and the coordinate or variable whose values replace those of the dim ('' if none)."""
    group = held.groups[0]
    if not x:
        if free:
            return free[0], ""
        axes = [dim for dim in dims if len(dim.values) > 1 and dim.counted]
        if not axes:
            raise RequestError(f"{held.name} has only one value along every axis: nothing to plot as a curve")
        return max(axes, key=lambda dim: (dim.name in first("along"), len(dim.values))).name if len(axes) > 1 else axes[
            0
        ].name, ""
    if x in free or x in [dim.name for dim in dims]:
        if free and x not in free:
            raise RequestError(f"--x {x}: {held.name} runs over {free[0]}; x must be this dim or a coordinate along it")
        return x, ""
    beside = [
        str(name) for name, own in group.variables.items() if free and free[0] in own.dims and own.dtype.kind in "fiu"
    ]
    if x in beside:
        return free[0], x
    raise RequestError(f"--x {x}: not a dim of {held.name}{nearest(x, [*free, *beside, *(dim.name for dim in dims)])}")


def _told_apart(lines: str, rest: Sequence[PlotDim], chosen: AxisValues) -> str:
    """Return the dim shown as lines: the requested dim, else the first named dim (stages, factors), else the first
    axis, provided that it has at most ``MOST_LINES`` values.
    """
    names = [dim.name for dim in rest]
    if lines and lines not in names:
        raise RequestError(f"--lines {lines}: not a dim that can be shown as lines{nearest(lines, names)}")
    if lines:
        return lines
    open_ = [dim for dim in rest if dim.name not in chosen and 1 < len(dim.values) <= MOST_LINES]
    named = [dim for dim in open_ if not dim.counted]
    return (named or open_)[0].name if open_ else ""


def _x_of(held: HeldVariable, along: str, beside: str, at: AxisValues) -> tuple[Any, str, str]:
    """Return the x values of a line, their unit, and the title of the axis."""
    if not beside:
        units = held.units_of(along)
        title = name_text(along, units) if units != "s" else f"{along.replace('_', ' ')}, s"
        return np.asarray(held.values_of(along), float), units, title
    for group in held.groups:
        array = group[beside]
        own = {d: v for d, v in at.items() if d in array.dims}
        if all(v in group[d].values.tolist() for d, v in own.items()):
            units = str(array.attrs.get("units", "1"))
            return (
                np.asarray(array.sel(own).values, float),
                units,
                name_text(str(array.attrs.get("long_name", beside)), units),
            )
    raise RequestError(f"{beside} has no values at this position")


def _end(holdings: Holdings, held: HeldVariable, at: AxisValues, units: str) -> tuple[float, str] | None:
    """Return the natural end of x for a line, in ``units``, and the name of this end; None if no end is known."""
    if units in PER_PIXEL:
        return 0.5, NYQUIST
    group = held.groups[0]
    for one in [h for h in holdings if h.known.end and h.units == units and not h.dims]:
        own = {d: v for d, v in at.items() if d in one.axes}
        if set(one.axes) <= set(own):
            return float(one.values(own)), one.known.end
    for name, array in group.coords.items():
        end = known(str(name)).end
        if end and str(array.attrs.get("units", "")) == units and set(map(str, array.dims)) <= set(at):
            return float(array.sel({d: at[str(d)] for d in array.dims})), end
    return None


def _figure(panels: Sequence[PlotDim]) -> tuple[Figure, list[Axes]]:
    count = int(np.prod([len(dim.values) for dim in panels])) if panels else 1
    columns = len(panels[1].values) if len(panels) == 2 else min(3, count)
    rows = -(-count // columns)
    figure = new_figure(3.6 * columns + 2.4, (3.4 if rows == 1 else 2.5) * rows + 0.8)
    first = figure.add_subplot(rows, columns, 1)
    return figure, [
        first,
        *(figure.add_subplot(rows, columns, n + 1, sharex=first, sharey=first) for n in range(1, count)),
    ]


def _colours(hue: PlotDim | None) -> Any:
    from matplotlib import colormaps

    if hue is None:
        return ["#24527a"]
    if hue.counted:
        return colormaps["plasma"](np.linspace(0.0, 0.85, len(hue.values)))
    return [colormaps["tab10" if len(hue.values) <= 10 else "tab20"](i) for i in range(len(hue.values))]


def _plain_ticks(axes: Axes, values: Sequence[float]) -> None:
    from matplotlib.ticker import NullFormatter

    shown = values if len(values) <= 8 else values[:: -(-len(values) // 8)]
    axes.set_xticks(shown, [f"{v:.3g}" for v in shown], fontsize=7.5)
    axes.xaxis.set_minor_formatter(NullFormatter())


def _legend(figure: Figure, axes: Axes, ended: str) -> None:
    from matplotlib.lines import Line2D

    handles, _ = axes.get_legend_handles_labels()
    if ended:
        handles = [*handles, Line2D([], [], color="0.6", linestyle="--", linewidth=0.9, label=ended)]
    if handles:
        figure.legend(handles=handles, loc="outside right center", fontsize=8, frameon=False)
