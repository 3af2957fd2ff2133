"""Maps: a figure over two axes of a sweep, one panel for each value of a third or for each stage.

In:  arrays (panel, y, x) with the labels of each; numbers, or indices into names.
Out: a PNG, every cell with its value or its name's colour.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

PANEL = 2.6  # inches
MOST_COLUMNS = 4
FACTOR_COLOURS = {
    "lens": "#4477aa", "diffusion": "#66ccee", "geometry": "#228833", "sampling": "#ccbb44", "demosaic": "#ee6677", "noise": "#bbbbbb",
}  # fmt: skip
OTHERS = ("#aa3377", "#994455", "#997700", "#6699cc", "#004488", "#eecc66")


@dataclass(frozen=True)
class Axes:
    """What stands along the sides of every panel, and over each."""

    x: Sequence[Any]
    y: Sequence[Any]
    panels: Sequence[Any]
    x_name: str = ""
    y_name: str = ""
    panel_name: str = ""


def map_of_numbers(values: Any, axes: Axes, path: Path, title: str, unit: str = "", digits: int = 3) -> None:
    """Numbers by colour on one logarithmic scale, each also written in its cell; what is unknown stays empty.

    Parameters
    ----------
    values : (panel, y, x) array
    axes : Axes
    path : Path
        Of the PNG, written whole or not at all.
    title, unit : str
    digits : int
        That are written.

    Raises
    ------
    ValueError
        Where the values have another shape than the axes.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    values = _checked(values, axes)
    known = values[np.isfinite(values) & (values > 0)]
    low, high = (float(known.min()), float(known.max())) if known.size else (1.0, 10.0)
    norm = LogNorm(low, high if high > low else low * 1.01)
    figure, panels = _panels(axes, title)
    for panel, own in zip(panels, values, strict=True):
        panel.imshow(np.where(own > 0, own, np.nan), norm=norm, cmap="viridis", origin="lower", aspect="auto")
        for (row, column), value in np.ndenumerate(own):
            if math.isfinite(value):
                dark = value > 0 and norm(value) < 0.6
                text = f"{value:.{digits}g}"
                panel.text(column, row, text, ha="center", va="center", fontsize=6.5, color="white" if dark else "black")
    bar = figure.colorbar(ScalarMappable(norm, "viridis"), ax=panels, label=unit, fraction=0.03, pad=0.02)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bar.ax.yaxis.set_minor_formatter(NullFormatter())
    _save(figure, path)


def map_of_names(indices: Any, names: Sequence[str], axes: Axes, path: Path, title: str) -> None:
    """Names by colour with a legend; ``indices`` (panel, y, x) point into ``names``, and what is unknown (NaN) stays white.

    Raises
    ------
    ValueError
        Where the indices have another shape than the axes, or point beyond the names.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    indices = _checked(indices, axes)
    known = indices[np.isfinite(indices)]
    if known.size and not (known.min() >= 0 and known.max() < len(names)):
        raise ValueError(f"indices run from {known.min():g} to {known.max():g}; allowed is 0 to {len(names) - 1}, one for each name")
    others = iter(OTHERS * (len(names) // len(OTHERS) + 1))
    colours = [FACTOR_COLOURS.get(name) or next(others) for name in names]
    figure, panels = _panels(axes, title)
    for panel, own in zip(panels, indices, strict=True):
        panel.imshow(own, cmap=ListedColormap(colours), vmin=-0.5, vmax=len(names) - 0.5, origin="lower", aspect="auto")
    patches = [Patch(color=colour, label=name) for name, colour in zip(names, colours, strict=True)]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(names), fontsize=8, frameon=False)
    _save(figure, path)


def _checked(values: Any, axes: Axes) -> Any:
    values = np.asarray(values, dtype=float)
    wanted = (len(axes.panels), len(axes.y), len(axes.x))
    if values.shape != wanted:
        raise ValueError(f"values have shape {values.shape}; allowed is (panel, y, x) = {wanted}, as the axes say")
    return values


def _panels(axes: Axes, title: str) -> tuple[Any, list[Any]]:
    """A figure with one panel for each label, its sides labelled."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(axes.panels)
    columns = min(MOST_COLUMNS, count) if count != 6 else 3
    rows = -(-count // columns)
    figure = Figure(figsize=(PANEL * columns + 1.0, PANEL * rows + 0.8), dpi=110, layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    found = []
    for number, label in enumerate(axes.panels):
        panel = figure.add_subplot(rows, columns, number + 1)
        panel.set_title(f"{axes.panel_name} {_text(label)}".strip(), fontsize=9)
        panel.set_xticks(range(len(axes.x)), [_text(v) for v in axes.x], fontsize=7)
        panel.set_yticks(range(len(axes.y)), [_text(v) for v in axes.y], fontsize=7)
        if number >= count - columns:
            panel.set_xlabel(axes.x_name, fontsize=8)
        if number % columns == 0:
            panel.set_ylabel(axes.y_name, fontsize=8)
        found.append(panel)
    return figure, found


def _text(label: Any) -> str:
    return f"{label:.4g}" if isinstance(label, float | np.floating) else str(label)


def _save(figure: Any, path: Path) -> None:
    temporary = path.with_name(path.name + ".partial")
    figure.savefig(temporary, format="png")
    os.replace(temporary, path)
