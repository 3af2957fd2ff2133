"""Panels: a metric over two dims, one panel for each value of further dims; numbers by colour, names by colour with a
legend.

In:  arrays (panel, y, x) with the labels of each; numbers, or indices into names.
Out: a figure, every cell with its value or its name's colour; failed cells are marked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.present.plots.labels import number_text
from etendue.present.plots.plot import new_figure
from etendue.types.arrays import Array
from etendue.types.documents import AxisValue

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_COLUMNS = 4
WIDEST = 16.0  # inches, largest width of a figure
OTHERS = ("#aa3377", "#994455", "#997700", "#6699cc", "#004488", "#eecc66")
MOST_TICKS = 12
SPREAD = 30  # ratio of largest to smallest number from which colours are logarithmic
FAILED, NOTHING = "×", "–"


@dataclass(frozen=True)
class Sides:
    """Labels along the sides of every panel and above every panel: texts, or numbers that become texts."""

    x: Sequence[AxisValue]
    y: Sequence[AxisValue]
    panels: Sequence[AxisValue]
    x_name: str = ""
    y_name: str = ""
    columns: int = 0  # number of panel columns; 0: automatic


def map_of_figures(
    values: Array,
    sides: Sides,
    title: str,
    unit: str = "",
    digits: int = 3,
    failed: Array | None = None,
    there: Array | None = None,
) -> Figure:
    """Show numbers as colours on one scale, and write each number in its cell.

    Parameters
    ----------
    values : (panel, y, x) array
    sides : Sides
    title, unit : str
    digits : int
        Number of significant digits to write.
    failed, there : (panel, y, x) bool arrays
        Cells that failed, and cells that were computed: a computed cell without a number is marked.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        The shape of the values does not match the sides.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.ticker import FuncFormatter

    values = _checked(values, sides)
    figure, panels, room = _panels(sides, title)
    norm = scale_of(values)
    low, high = norm.vmin, norm.vmax
    for number, (panel, own) in enumerate(zip(panels, values, strict=True)):
        panel.imshow(
            np.where(np.isfinite(own), own, np.nan),
            norm=norm,
            cmap="viridis",
            origin="lower",
            aspect="auto",
            interpolation="none",
        )
        for (row, column), value in np.ndenumerate(own):
            wrong = failed is not None and bool(np.asarray(failed)[number, row, column])
            if wrong:
                _mark(panel, row, column, FAILED, "#c03028", room)
            elif math.isfinite(value):
                if room:
                    dark = norm.vmax == norm.vmin or float(norm(value)) < 0.6  # a single number gets the darkest colour
                    colour = "white" if dark else "black"
                    panel.text(
                        column, row, number_text(value, digits), ha="center", va="center", fontsize=room, color=colour
                    )
            elif math.isinf(value) or (there is not None and bool(np.asarray(there)[number, row, column])):
                _mark(panel, row, column, number_text(value) or NOTHING, "0.45", room)
    if np.isfinite(values).any() and high > low:
        bar = figure.colorbar(ScalarMappable(norm, "viridis"), ax=panels, fraction=0.05, pad=0.02, aspect=25)
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.4g}"))
        span = high / max(low, 1e-300)
        # leading digits labelled in each decade of a logarithmic scale
        shown = "" if span > 100 else "25" if span > 4 else "23456789"
        bar.ax.yaxis.set_minor_formatter(
            FuncFormatter(lambda value, _: f"{value:.3g}" if f"{value:.0e}"[0] in shown else "")
        )
        bar.ax.tick_params(which="both", labelsize=7)
        bar.set_label(unit, fontsize=8)
    _explain(figure, failed, values, there)
    return figure


def map_of_names(
    indices: Array,
    names: Sequence[str],
    sides: Sides,
    title: str,
    failed: Array | None = None,
    said: str = "no value",
    tints: Mapping[str, str] | None = None,
) -> Figure:
    """Show names as colours with a legend. ``indices`` is a (panel, y, x) array of indices into ``names``; cells with
    NaN stay white.

    ``said``: what the legend says about white cells; ``tints``: colours of the names that have a fixed colour.

    Raises
    ------
    ValueError
        The indices do not match the sides, or point beyond the names.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    indices = _checked(indices, sides)
    found = indices[np.isfinite(indices)]
    if found.size and not (found.min() >= 0 and found.max() < len(names)):
        raise ValueError(
            f"indices from {found.min():g} to {found.max():g}; must be from 0 to {len(names) - 1}, one for each name"
        )
    others = iter(OTHERS * (len(names) // len(OTHERS) + 1))
    colours = [(tints or {}).get(name) or next(others) for name in names]
    figure, panels, room = _panels(sides, title)
    for number, (panel, own) in enumerate(zip(panels, indices, strict=True)):
        panel.imshow(
            own,
            cmap=ListedColormap(colours),
            vmin=-0.5,
            vmax=len(names) - 0.5,
            origin="lower",
            aspect="auto",
            interpolation="none",
        )
        if failed is not None:
            for row, column in np.argwhere(np.asarray(failed)[number]):
                _mark(panel, row, column, FAILED, "#c03028", room)
    patches = [Patch(facecolor=colour, label=name) for name, colour in zip(names, colours, strict=True)]
    if np.isnan(indices).any():
        patches.append(Patch(facecolor="white", edgecolor="0.6", label=said))
    figure.legend(
        handles=patches,
        loc="outside lower center",
        ncols=min(len(patches), 4 if len(panels) == 1 else 8),
        fontsize=8,
        frameon=False,
    )
    return figure


def scale_of(values: Array) -> Any:
    """Return the colour scale: logarithmic if all numbers are above 0 and differ much, else linear."""
    from matplotlib.colors import LogNorm, Normalize

    found = np.asarray(values, float)
    found = found[np.isfinite(found)]
    low, high = (float(found.min()), float(found.max())) if found.size else (0.0, 1.0)
    if low > 0 and high / low > SPREAD:
        return LogNorm(low, high)
    return Normalize(low, high)


def _mark(panel: Axes, row: int, column: int, text: str, colour: str, room: float) -> None:
    panel.text(column, row, text, ha="center", va="center", fontsize=room or 5, color=colour)


def _explain(figure: Figure, failed: Array | None, values: Array, there: Array | None) -> None:
    """Explain, below the panels, the marks that the panels contain."""
    words = [f"{FAILED} the cell failed"] if failed is not None and np.any(failed) else []
    lost = ~np.isfinite(values) & (np.zeros_like(values, bool) if failed is None else ~np.asarray(failed))
    if there is not None and np.any(lost & np.asarray(there) & np.isnan(values)):
        words.append(f"{NOTHING} computed, but undefined")
    if np.any(lost & (False if there is None else ~np.asarray(there))):
        words.append("empty: not computed")
    if words:
        figure.supxlabel("     ".join(words), fontsize=8, color="0.35")


def _checked(values: Array, sides: Sides) -> Array:
    values = np.asarray(values, dtype=float)
    wanted = (len(sides.panels), len(sides.y), len(sides.x))
    if values.shape != wanted:
        raise ValueError(f"values have shape {values.shape}; expected (panel, y, x) = {wanted}")
    return values


def _panels(sides: Sides, title: str) -> tuple[Figure, list[Axes], float]:
    """Return a figure with one panel for each label and labelled sides; and the font size in cells, 0 if no text
    fits.
    """
    count = len(sides.panels)
    columns = sides.columns or (min(MOST_COLUMNS, count) if count not in (5, 6, 9) else 3)
    rows = -(-count // columns)
    wide = min(max(1.9, 0.42 * len(sides.x) + 0.25), (WIDEST - 1.5) / columns)
    high = min(max(1.3 if len(sides.y) > 1 else 0.7, 0.3 * len(sides.y) + 0.2), 12.0 / rows)
    longest = max((len(str(text)) for text in sides.y), default=0)
    figure = new_figure(max(wide * columns + 1.5 + 0.05 * longest, 4.2), high * rows + 0.45 * rows + 1.1)
    figure.suptitle(wrapped(title, figure.get_figwidth()), fontsize=10)
    found = []
    for number, label in enumerate(sides.panels):
        panel = figure.add_subplot(rows, columns, number + 1)
        panel.set_title(str(label), fontsize=9)
        _ticks(panel.set_xticks, sides.x, wide, turned=True)
        _ticks(panel.set_yticks, sides.y, high, turned=False)
        panel.tick_params(length=2)
        if number >= count - columns:
            panel.set_xlabel(sides.x_name, fontsize=8)
        if number % columns == 0:
            panel.set_ylabel(sides.y_name, fontsize=8)
        found.append(panel)
    # inches; 3 or 4 letters take 0.25
    cell = min(wide / max(len(sides.x), 1) * 0.62, high / max(len(sides.y), 1) * 1.4)
    return figure, found, min(7.5, 26 * cell) if cell > 0.17 else 0


def _ticks(put: Callable[..., object], labels: Sequence[Any], inches: float, turned: bool) -> None:
    """Label as many cells as fit."""
    texts = [_text(label) for label in labels]
    letters = max((len(text) for text in texts), default=1)
    each = 0.062 * letters + 0.06 if turned else 0.13
    rotate = turned and letters > 3 and each * len(texts) > inches
    step = max(
        1,
        math.ceil(len(texts) * (0.13 if rotate else min(each, 0.3)) / inches),
        math.ceil(len(texts) / (3 * MOST_TICKS)),
    )
    chosen = range(0, len(texts), step)
    put(
        list(chosen),
        [texts[i] for i in chosen],
        fontsize=7,
        **({"rotation": 60, "ha": "right", "rotation_mode": "anchor"} if rotate else {}),
    )


def wrapped(text: str, inches: float) -> str:
    """Break a title into lines that fit over a figure."""
    import textwrap

    return "\n".join(textwrap.wrap(text, max(24, int(inches * 72 / 5.6))))


def _text(label: Any) -> str:
    return f"{label:.4g}" if isinstance(label, float | np.floating) else str(label)
