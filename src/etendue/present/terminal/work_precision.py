"""Error against run time, both logarithmic: a comparison of alternatives.

In:  points with a label, seconds per megapixel, error.
Out: a PNG with the points and their Pareto front.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

from etendue.types.documents import Document

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import RendererBase
    from matplotlib.transforms import Bbox

AROUND = (  # candidate positions of a label, in points from its dot
    (8, 6, "left"),
    (8, -13, "left"),
    (-8, 6, "right"),
    (-8, -13, "right"),
    (0, 13, "center"),
    (0, -20, "center"),
    (8, 20, "left"),
    (8, -27, "left"),
    (-8, 20, "right"),
    (-8, -27, "right"),
)


@dataclass(frozen=True)
class Point:
    """One alternative."""

    label: str
    seconds: float
    error: float
    best: bool  # on the front


def work_precision(points: list[Point], title: str, error: str) -> bytes:
    """Return the plot as PNG; lower left is better."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    figure = Figure(figsize=(7.2, 5.0), dpi=120, facecolor="white", layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set(xscale="log", yscale="log", xlabel="CPU time, s per Mpixel", ylabel=error, title=title)
    for limits, values in ((axes.set_xlim, [p.seconds for p in points]), (axes.set_ylim, [p.error for p in points])):
        low, high = min(values), max(values)
        room = max((high / low) ** 0.18, 1.15)
        limits(low / room, high * room)
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        subs = (
            (1.0,) if high / low > 200 else (1.0, 2.0, 5.0) if high / low > 3 else tuple(1 + 0.1 * i for i in range(90))
        )
        axis.set_major_locator(LogLocator(subs=subs, numticks=9))
        axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    front = sorted((p for p in points if p.best), key=lambda p: p.seconds)
    if len(front) > 1:
        x, y = [p.seconds for p in front], [p.error for p in front]
        axes.plot(x, y, color="#3b6fb6", lw=1.2, zorder=2, label="Pareto front")
        axes.legend(loc="upper right", frameon=False, fontsize=8)
    for chosen, colour in ((True, "#3b6fb6"), (False, "#9a9a9a")):
        some = [p for p in points if p.best == chosen]
        axes.scatter([p.seconds for p in some], [p.error for p in some], s=38, color=colour, zorder=3)
    axes.grid(True, which="major", color="#dddddd", lw=0.6)
    figure.canvas.draw()
    _label(axes, points, canvas.get_renderer())  # type: ignore[no-untyped-call]
    picture = BytesIO()
    figure.savefig(picture, format="png")
    return picture.getvalue()


def _label(axes: Axes, points: list[Point], renderer: RendererBase) -> None:
    """Put a label beside each point such that it covers no point and no other label."""
    taken = [axes.transData.transform((p.seconds, p.error)) for p in points]
    boxes: list[Bbox] = []
    for p in points:
        for number, (right, up, side) in enumerate(AROUND):
            text = axes.annotate(
                p.label,
                (p.seconds, p.error),
                (right, up),
                textcoords="offset points",
                ha=side,
                fontsize=8,
                color="black" if p.best else "#555555",
            )
            box = text.get_window_extent(renderer)
            free = not any(box.overlaps(other) for other in boxes) and not any(box.contains(*place) for place in taken)
            within = (
                axes.bbox.x0 <= box.x0 and box.x1 <= axes.bbox.x1 and axes.bbox.y0 <= box.y0 and box.y1 <= axes.bbox.y1
            )
            if (free and within) or number == len(AROUND) - 1:
                boxes.append(box)
                break
            text.remove()


TimedError = tuple[float, float, float]  # least seconds, error, median seconds


@dataclass(frozen=True)
class Series:
    """Points drawn in the same way: with a ``line`` through them, as ``dots``, as the Pareto ``front``, as the front of
    the ``cold`` run times, or as a ``star``.
    """

    label: str
    points: list[TimedError]
    kind: str = "line"
    colour: str = "C0"  # of a line


@dataclass(frozen=True)
class Bar:
    """One setting, with the parts of its error by cause."""

    label: str
    parts: Mapping[str, float]


Level = tuple[float | None, str] | None
Panel = tuple[str, str, list[Series], Level, Level]  # title, x label, series, noise level, floor
Split = tuple[str, list[Bar], Mapping[str, str]]  # title, bars, colours of the causes in their order


def diagrams(title: str, panels: list[Panel], split: Split) -> bytes:
    """Return a PNG with work-precision diagrams side by side, both axes logarithmic, and bars that split the error of
    each setting. Points without error or time are omitted.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.2 * len(panels) + 6.2, 5.2), dpi=120, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title)
    for number, (name, time, series, noise, floor) in enumerate(panels, 1):
        axes = figure.add_subplot(1, len(panels) + 1, number)
        axes.set(xscale="log", yscale="log", xlabel=time, ylabel="rms error, full scale 1", title=name)
        for one in series:
            _draw(axes, one)
        for level, colour, style in ((noise, "#b2443b", "--"), (floor, "#777777", ":")):
            if level is not None and level[0]:
                axes.axhline(level[0], color=colour, ls=style, lw=1.2, label=level[1], zorder=1)
        axes.grid(True, which="major", color="#dddddd", lw=0.6)
        _few_ticks(axes, len(axes.get_legend_handles_labels()[1]))
        if axes.get_legend_handles_labels()[1]:
            axes.legend(frameon=False, fontsize=8, loc="upper right")
    _bars(figure.add_subplot(1, len(panels) + 1, len(panels) + 1), *split)
    picture = BytesIO()
    figure.savefig(picture, format="png")
    return picture.getvalue()


def _draw(axes: Axes, series: Series) -> None:
    points = [(seconds, error, median) for seconds, error, median in series.points if seconds > 0 and error > 0]
    if not points:
        return
    x, y, medians = zip(*points, strict=True)
    how: Document = {
        "line": {"marker": "o", "ms": 4, "lw": 1.3, "color": series.colour, "zorder": 3},
        "dots": {"marker": "o", "ms": 4, "lw": 0, "color": "#b5b5b5", "zorder": 2},
        "front": {"marker": "o", "ms": 5.5, "lw": 1.5, "color": "#3b6fb6", "zorder": 4},
        "cold": {"marker": "o", "ms": 4, "lw": 1.2, "ls": "--", "color": "#7fa6d6", "zorder": 3},
        "star": {"marker": "*", "ms": 13, "lw": 0, "color": "#c8791c", "zorder": 5},
    }[series.kind]
    axes.plot(x, y, label=series.label, **how)
    if series.kind != "dots":
        axes.hlines(y, x, medians, color=how["color"], lw=2.5, alpha=0.4, zorder=2)


def _bars(axes: Axes, title: str, bars: list[Bar], colours: Mapping[str, str]) -> None:
    """Draw one bar for each setting, divided by each cause's share of the error, %; the first is at the top."""
    left, places = [0.0] * len(bars), [-number for number in range(len(bars))]
    wholes = [sum(bar.parts.values()) or 1.0 for bar in bars]
    for cause, colour in colours.items():
        shares = [100 * bar.parts.get(cause, 0.0) / whole for bar, whole in zip(bars, wholes, strict=True)]
        axes.barh(places, shares, left=left, height=0.7, color=colour, label=cause if max(shares) > 0.5 else None)
        left = [own + share for own, share in zip(left, shares, strict=True)]
    axes.set_yticks(places, [bar.label for bar in bars], fontsize=8)
    room = 0.6 + 0.4 * len(bars)  # for the legend
    axes.set(title=title, xlabel="share of the error, %", xlim=(0, 100), ylim=(0.4 - len(bars), room))
    if axes.get_legend_handles_labels()[1]:
        axes.legend(frameon=False, fontsize=8, loc="upper right", ncols=2)


def _few_ticks(axes: Axes, lines: int) -> None:
    """Set ticks that do not overlap, and leave room above for a legend with this number of lines."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = axes.get_xlim()
    few, tenths = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0), tuple(1 + 0.1 * i for i in range(90))
    subs = (1.0,) if high / low > 200 else (1.0, 2.0, 5.0) if high / low > 4 else few if high / low > 1.5 else tenths
    axes.xaxis.set_major_locator(LogLocator(subs=subs, numticks=9))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    bottom, top = axes.get_ylim()
    share = 0.05 * lines + 0.03  # of the height
    axes.set_ylim(bottom, top * (top / bottom) ** (share / (1 - share)))
