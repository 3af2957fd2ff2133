"""A photograph with the measured regions outlined.

In:  the file, the document of ``measure``.
Out: a plot: the picture, regions outlined, each with its results.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from etendue.present.plots.plot import Plot, new_figure
from etendue.types.arrays import Array, FloatArray
from etendue.types.documents import Document
from etendue_lab.measure.photograph import ENCODED, PhotographFile, open_photograph

WIDEST, INCHES = 1600, 9.0  # maximum pixels drawn along the longer side; its length in inches
LOW = 0.08  # share of the picture's height; closer to the top there is no room for text
GREY = (0.2126, 0.7152, 0.0722)
DARK = {"facecolor": "black", "alpha": 0.6, "edgecolor": "none", "pad": 1.5}


def drawn(path: Path, document: Document) -> Plot:
    """Plot the picture with every edge, star, patch and chart of a document."""
    encoding = "linear" if document["encoding"] == "raw" else document["encoding"]
    photograph = open_photograph(path, encoding, GREY)
    rows, columns = photograph.rows, photograph.columns
    wide, high = (INCHES * size / max(rows, columns) for size in (columns, rows))
    figure = new_figure(max(wide, 3.0), max(high, 3.0), layout=None)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(
        _shown(photograph),
        extent=(-0.5, columns - 0.5, rows - 0.5, -0.5),
        interpolation="nearest",
        cmap="gray",
        vmin=0,
        vmax=1,
    )
    axes.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
    axes.set_axis_off()
    numbers: list[list[Any]] = []
    marks = [("edge", one, one["region"]) for one in document["edges"]] + [
        ("star", one, one["star"]) for one in document["stars"]
    ]
    marks += [("noise", one, one["region"]) for one in document["noise"]]
    for number, (kind, one, where) in enumerate(marks):
        colour = f"C{(number + 1) % 10}"
        place = [float(part) for part in where.split(",")]
        words = _noise(one) if kind == "noise" else _response(one)
        x, y = _outlined(axes, kind, one, place, colour)
        # text goes above a region; where there is no room, at its lower end, inward
        low, right = (y < LOW * rows, x > 0.5 * columns)
        axes.annotate(
            words,
            (x, y),
            xytext=(-4 if right else 4, -4 if low else 4),
            textcoords="offset points",
            color="white",
            fontsize=7,
            va="top" if low else "bottom",
            ha="right" if right else "left",
            bbox=DARK,
        )
        numbers.append([kind, where, words])
    if document["chart"]:
        corners = np.array([float(part) for part in document["chart"]["corners"].split(",")]).reshape(4, 2)
        axes.plot(*np.vstack([corners, corners[:1]]).T, color="C1", lw=1.5)
        words = (
            f"Delta E 2000: mean {document['chart']['as_is']['mean']:.2f}, exposed "
            f"{document['chart']['exposed']['mean']:.2f}"
        )
        axes.text(*corners.mean(0), words, color="white", fontsize=7, ha="center", bbox=DARK)
        numbers.append(["chart", document["chart"]["corners"], words])
    return Plot(figure, ("kind", "region", "measured"), numbers)


def _outlined(axes: Any, kind: str, one: Document, place: list[float], colour: str) -> tuple[float, float]:
    """Outline a region; return the position of its text."""
    from matplotlib.patches import Circle, Polygon, Rectangle

    dashed = "--" if one.get("doubts") or one.get("not_covered") or one.get("hidden") else "-"
    if kind == "star":
        x, y, radius = place
        axes.add_patch(Circle((x, y), radius, fill=False, color=colour, lw=1.5, ls=dashed))
        return _words(axes, x - radius, y - radius, 2 * radius, 2 * radius)
    x, y, width, height = place
    frame = axes.add_patch(Rectangle((x - 0.5, y - 0.5), width, height, fill=False, color=colour, lw=1.5, ls=dashed))
    if kind == "edge":
        (x0, y0), (x1, y1) = one["line"]
        length = math.hypot(x1 - x0, y1 - y0) or 1.0
        u, v = (one["half_width"] * part / length for part in (y0 - y1, x1 - x0))
        axes.plot([x0, x1], [y0, y1], color=colour, lw=1.0, ls=":")
        band = [(x0 + u, y0 + v), (x1 + u, y1 + v), (x1 - u, y1 - v), (x0 - u, y0 - v)]
        axes.add_patch(Polygon(band, fill=True, color=colour, alpha=0.25, lw=0)).set_clip_path(frame)
    return _words(axes, x, y, width, height)


def _words(axes: Any, x: float, y: float, width: float, height: float) -> tuple[float, float]:
    """Return the corner of a region at which its text starts."""
    columns, rows = axes.get_xlim()[1], axes.get_ylim()[0]
    return (x + width if x + width / 2 > 0.5 * columns else x), (
        y + height if y < LOW * rows and y + height < (1 - LOW) * rows else y
    )


def _response(one: Document) -> str:
    between = f" ({one['mtf50_low']:.3f} to {one['mtf50_high']:.3f})"
    found = "MTF50 not reached" if math.isnan(one["mtf50"]) else f"MTF50 {one['mtf50']:.3f}{between}\ncycles/pixel"
    return found + (", doubtful" if one.get("doubts") else "") + (", not covered" if one.get("not_covered") else "")


def _noise(one: Document) -> str:
    own = one["channels"][-1]
    sigma = own["linear"]["sigma"]
    text = (
        f"{own['channel']}: sigma {100 * sigma['value']:.3g} % ({100 * sigma['low']:.3g} to {100 * sigma['high']:.3g})"
    )
    return text + (", not covered" if one["not_covered"] else "")


def _shown(photograph: PhotographFile) -> Array:
    """Return the picture to show, (rows, columns[, 3]), values 0 to 1. A large picture is subsampled."""
    every = math.ceil(max(photograph.rows, photograph.columns) / WIDEST)
    part = photograph.values[::every, ::every] / photograph.full
    seen: FloatArray = np.clip(part, 0, 1)
    if photograph.encoding == "linear":
        seen = ENCODED["sRGB"](seen / max(float(np.percentile(seen, 99.5)), 1e-9) if photograph.is_raw else seen)
    return np.clip(seen[..., 0] if seen.shape[2] == 1 else seen, 0, 1)
