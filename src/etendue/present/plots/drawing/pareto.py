"""Trade-offs: two metrics of every cell of a sweep, and the Pareto front, on which one metric improves only if the
other worsens.

In:  holdings, two metrics, and for each whether higher or lower is better.
Out: a ``Plot``, its front labelled by axis values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray

from etendue.contract.wording import first as goes_first
from etendue.errors import RequestError, nearest
from etendue.present.plots.arrangement import PlotDim, dims_of
from etendue.present.plots.drawing.panels import wrapped
from etendue.present.plots.holdings import HeldVariable, Holdings
from etendue.present.plots.labels import number_text, places_text, unit_text
from etendue.present.plots.places import resolved
from etendue.present.plots.plot import Plot, new_figure
from etendue.present.plots.rows import factors_of, rounded
from etendue.types.arrays import Array
from etendue.types.documents import AxisValue, AxisValues

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HIGHER, LOWER = "higher", "lower"
SAID = {HIGHER: HIGHER, "max": HIGHER, "more": HIGHER, LOWER: LOWER, "min": LOWER, "less": LOWER}
MARKERS = "osD^vP*Xhp<>"
MOST_NAMED = 24


def front(points: Any) -> Array:
    """Return a mask of the points that no other point dominates, that is, equals or exceeds in every column and exceeds
    in at least one.

    Parameters
    ----------
    points : (n, metrics) array
        Higher is better; rows with NaN are never on the front.

    Returns
    -------
    (n,) bool array
    """
    points = np.asarray(points, float)
    known = np.isfinite(points).all(axis=1)
    found = np.zeros(len(points), bool)
    # by the first column, then the second, best first
    order = np.lexsort(-points.T[::-1]) if len(points) else np.empty(0, int)
    best = -np.inf
    last: Any = None
    if points.shape[1] == 2:
        for place in order:
            if not known[place]:
                continue
            one = points[place]
            if one[1] > best or (last is not None and np.array_equal(one, last)):
                found[place], best, last = True, one[1], one
        return found
    for place in np.flatnonzero(known):
        others = points[known]
        found[place] = not np.any(np.all(others >= points[place], axis=1) & np.any(others > points[place], axis=1))
    return found


def pareto(
    holdings: Holdings,
    first: str = "",
    second: str = "",
    better: Mapping[str, str] | Sequence[str] = (),
    at: AxisValues | None = None,
) -> Plot:
    """Plot two metrics against each other, every cell a point; the Pareto front is drawn and labelled.

    ``better``: ``higher`` or ``lower`` for each metric, in order or by name; by default the direction declared by the
    variable.

    Raises
    ------
    RequestError
        A metric is unknown, its better direction is unknown, or no value is given for a dim such as ``stage``.
    """
    held = _chosen(holdings, first, second)
    sense = [_better(one, place, better) for place, one in enumerate(held)]
    place = resolved(held, at or {})
    said = [dim.text(place[dim.name]) for dim in dims_of(held) if dim.name in place]
    said += _behind(held, place)
    arrays = [_at(one, place) for one in held]
    a, b = xarray.broadcast(*arrays)
    dims = [dim for dim in dims_of(held) if dim.name in a.dims]
    order = [dim.name for dim in dims]
    values = np.stack([np.ravel(one.transpose(*order).values) for one in (a, b)], axis=1)
    index: Any = np.argwhere(np.ones([len(dim.values) for dim in dims], bool))
    signs = np.array([1.0 if s == HIGHER else -1.0 for s in sense])
    best = front(values * signs)
    if not np.isfinite(values).all(axis=1).any():
        raise RequestError(f"no cell has both {held[0].name} and {held[1].name}")
    words = [f"{held[1].title} against {held[0].title}", *said]
    title = f"{holdings.pipeline}: {', '.join(words)}" if holdings.pipeline else ", ".join(words)
    drawn = _Drawn(holdings, held, sense, dims)
    figure = _draw(drawn, values, best, index, title)
    alike = held[0].variable == held[1].variable
    columns = [*order, *(one.name if alike else one.variable for one in held), "front"]
    rows = [
        [*(d.values[i] for d, i in zip(dims, own, strict=True)), *map(float, v), bool(on)]
        for own, v, on in zip(index, values, best, strict=True)
    ]
    lost = int((~np.isfinite(values).all(axis=1)).sum())
    return Plot(figure, columns, rows, [f"{lost} of {len(values)} cells lack one of the two metrics"] if lost else [])


def _behind(held: Sequence[HeldVariable], place: dict[str, AxisValue]) -> list[str]:
    """Add the last stage of each metric with the dim ``stage`` to ``place``; return texts that state this."""
    said = []
    for one in held:
        for dim in one.dims:
            if dim not in place:
                names = one.values_of(dim)
                if dim != "stage":
                    raise RequestError(
                        f"{one.name} has the dim {dim}: choose one with --at {dim}={names[0]} (or "
                        f"{', '.join(map(str, names[1:]))})"
                    )
                place[dim] = names[-1]
                said.append(f"after {names[-1]}")
    return said


def _chosen(holdings: Holdings, first: str, second: str) -> list[HeldVariable]:
    if first and second:
        return [holdings.find(name, "figure") for name in (first, second)]
    if first or second:
        raise RequestError(f"a front needs two metrics: etendue plot {holdings.archive} pareto METRIC METRIC")
    names = {one.variable for one in holdings.of_kind("figure")}
    for pair in map(str.split, goes_first("front")):
        if len(pair) == 2 and names.issuperset(pair):
            return [holdings.find(name, "figure") for name in pair]
    own = f"etendue plot {holdings.archive}"
    raise RequestError(f"choose two metrics: {own} pareto METRIC METRIC (to list them: {own} --list)")


def _better(held: HeldVariable, place: int, asked: Mapping[str, str] | Sequence[str]) -> str:
    word = ""
    if isinstance(asked, Mapping):
        word = asked.get(held.name, asked.get(held.variable, ""))
    elif asked:
        named = dict(text.split("=", 1) for text in asked if "=" in text)
        plain = [text for text in asked if "=" not in text]
        word = named.get(held.name, named.get(held.variable, plain[place] if place < len(plain) else ""))
    word = word or str(held.attrs.get("better", "")) or held.known.better
    if word not in SAID:
        if word:
            raise RequestError(f"--better {word}{nearest(word, SAID)}")
        raise RequestError(
            f"unknown whether higher or lower {held.variable} is better; give --better {held.variable}=higher (or "
            "lower)"
        )
    return SAID[word]


def _at(held: HeldVariable, place: AxisValues) -> xarray.DataArray:
    own = {dim: value for dim, value in place.items() if dim in (*held.axes, *held.dims)}
    values = held.values(own)
    return values.sel({dim: value for dim, value in own.items() if dim in values.dims}).reset_coords(drop=True)


class _Drawn(NamedTuple):
    """What the points of a front stand for."""

    holdings: Holdings
    held: Sequence[HeldVariable]
    sense: Sequence[str]
    dims: Sequence[PlotDim]


def _draw(drawn: _Drawn, values: Array, best: Array, index: Array, title: str) -> Any:
    holdings, held, sense, dims = drawn
    from matplotlib import colormaps
    from matplotlib.lines import Line2D

    on = np.flatnonzero(best)
    on = on[np.argsort(values[on, 0])]
    named = on if len(on) <= MOST_NAMED else on[np.unique(np.linspace(0, len(on) - 1, MOST_NAMED).round().astype(int))]
    figure = new_figure(9.0, max(4.6, 1.4 + 0.19 * len(named)))
    axes = figure.add_subplot()
    varying = [n for n, dim in enumerate(dims) if len(dim.values) > 1 and not factors_of(holdings, dim.name)]
    hue, shape = (*varying, None, None)[:2]
    if shape is not None and len(dims[shape].values) > len(MARKERS):
        shape = None
    colours: Any = [(0.2, 0.4, 0.7, 1)]
    if hue is not None:
        colours = colormaps["plasma"](np.linspace(0.05, 0.9, len(dims[hue].values)))
    marks = np.zeros(len(index), int) if shape is None else index[:, shape]
    for mark in range(1 if shape is None else len(dims[shape].values)):
        own = marks == mark
        tint = [colours[i] for i in index[own, hue]] if hue is not None else colours[0]
        axes.scatter(*values[own].T, color=tint, marker=MARKERS[mark], s=26, linewidths=0, alpha=0.75, zorder=2)
    axes.step(
        values[on, 0],
        values[on, 1],
        color="0.25",
        linewidth=1,
        zorder=1,
        where="pre" if sense[0] == HIGHER else "post",
    )
    axes.scatter(*values[on].T, facecolors="none", edgecolors="black", s=70, linewidths=1.1, zorder=3)
    lines = _name_points(axes, values, named, index, drawn)
    more = f"\n({len(on) - len(named)} more)" if len(on) > len(named) else ""
    head = f"Pareto front, {len(on)} of {int(np.isfinite(values).all(axis=1).sum())} cells"
    handles = [Line2D([], [], linestyle="none", label=line) for line in [head, *lines]]
    legend = figure.legend(
        handles=handles,
        labels=[head, *(line + (more if line is lines[-1] else "") for line in lines)],
        loc="outside right upper",
        fontsize=7.5,
        frameon=False,
        handlelength=0,
        handletextpad=0,
    )
    legend.get_texts()[0].set_fontweight("bold")
    if meant := _marks(dims, hue, shape, colours):
        figure.legend(
            handles=meant,
            loc="outside lower center",
            ncols=min(10, len(meant)),
            fontsize=7.5,
            frameon=False,
            columnspacing=1.0,
            handletextpad=0.2,
        )
    _name_sides(axes, held, sense, values)
    axes.margins(0.09)  # keep numbers of the outermost points clear of the frame
    axes.tick_params(labelsize=8)
    axes.grid(color="0.92", zorder=0)
    axes.set_title(wrapped(title, 6.2), fontsize=10)
    return figure


def _name_points(axes: Axes, values: Array, named: Array, index: Array, drawn: _Drawn) -> list[str]:
    """Number the points ``named`` in the plot, and return a line of text for each: its axis values and both metrics."""
    lines, dims = [], drawn.dims
    factors = {dim.name: found for dim in dims if (found := factors_of(drawn.holdings, dim.name))}
    units = {dim.name: dim.units for dim in dims} | {f.name: f.units for own in factors.values() for f in own}
    for number, place in enumerate(named, 1):
        axes.annotate(str(number), values[place], (5, 5), textcoords="offset points", fontsize=7.5, zorder=4)
        where = {dim.name: dim.values[i] for dim, i in zip(dims, index[place], strict=True)}
        for dim, own in factors.items():
            row = where.pop(dim)
            where |= {factor.name: rounded(factor.values.get(row)) for factor in own}
        text = places_text(where, units) or "the only cell"
        lines.append(f"{number:2d}  {text}:  {number_text(values[place, 0])}, {number_text(values[place, 1])}")
    return lines


def _name_sides(axes: Axes, held: Sequence[HeldVariable], sense: Sequence[str], values: Array) -> None:
    for number, (one, word, name) in enumerate(zip(held, sense, "xy", strict=True)):
        unit = unit_text(one.units)
        own = values[:, number][np.isfinite(values[:, number])]
        error = f"\u00b1{one.attrs['error']:.1g} {unit}".rstrip() if one.error_text else unit
        words = ", ".join(text for text in (one.title, error) if text)
        getattr(axes, f"set_{name}label")(f"{wrapped(words, 4.6)}\n{word} is better", fontsize=8.5)
        if own.min() > 0 and own.max() / own.min() > 30:
            getattr(axes, f"set_{name}scale")("log")


def _marks(dims: Sequence[PlotDim], hue: int | None, shape: int | None, colours: Any) -> list[Any]:
    """Return legend entries for the markers and for at most eight of the colours."""
    from matplotlib.lines import Line2D

    marks: list[tuple[str, Any, str]] = []
    if hue is not None:
        values = dims[hue].values
        some = np.unique(np.linspace(0, len(values) - 1, min(8, len(values))).round().astype(int))
        marks += [("o", colours[i], dims[hue].text(values[i])) for i in some]
    if shape is not None:
        marks += [(MARKERS[i], "0.4", dims[shape].text(value)) for i, value in enumerate(dims[shape].values)]
    return [
        Line2D([], [], linestyle="none", marker=marker, markersize=5, color=colour, label=label)
        for marker, colour, label in marks
    ]
