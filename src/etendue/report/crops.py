"""The same crop of several pictures side by side, where they differ most.

In:  pictures (channel, y, x), the first of them the reference.
Out: a PNG, each sample a whole number of screen pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import scipy

from etendue.physics.colour.encoding import srgb_encode

SIDE, SHOWN, COLUMNS = 56, 280, 5  # samples of a crop, its size on the screen, crops in a row
BORDER = 10


@dataclass(frozen=True)
class Strip:
    """One picture and what stands under it."""

    label: str
    picture: Any


def where_most(pictures: list[Any], side: int) -> tuple[int, int]:
    """First row and column of the window in which pictures differ most among each other."""
    spread = np.stack([np.asarray(p, np.float64) for p in pictures]).std(axis=0).mean(axis=0)
    rows, columns = spread.shape
    edge = BORDER if min(rows, columns) >= side + 2 * BORDER else 0
    mean = scipy.ndimage.uniform_filter(spread**2, side, mode="constant")
    half = side // 2
    mean = mean[edge + half : rows - edge - (side - half) + 1, edge + half : columns - edge - (side - half) + 1]
    row, column = np.unravel_index(int(np.argmax(mean)), mean.shape)
    return int(row) + edge, int(column) + edge


def strip(pictures: list[Strip], encoded: bool, title: str) -> bytes:
    """Reference and alternatives as PNG; linear pictures are scaled alike and encoded for the screen."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = pictures[0].picture.shape[-2:]
    side = min(SIDE, rows, columns)
    compared = [p.picture for p in pictures[1:]]
    top, left = where_most(compared if len(compared) > 1 else [p.picture for p in pictures], side)
    cut = [np.asarray(p.picture, np.float64)[..., top : top + side, left : left + side] for p in pictures]
    if not encoded:
        bright = max(float(np.quantile(cut[0], 0.995)), 1e-9)
        cut = [np.asarray(srgb_encode(np.clip(0.9 * c / bright, 0, 1))) for c in cut]
    scale = max(1, SHOWN // side)
    box, label, gap, head = scale * side, 22, 8, 30
    across = min(COLUMNS, len(pictures))
    down = -(-len(pictures) // across)
    width, height = across * (box + gap) + gap, head + down * (box + label + gap) + gap
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    place = f" ({side} x {side} pixels from row {top}, column {left})"
    figure.text(gap / width, 1 - 0.55 * head / height, title + place, ha="left", va="center", fontsize=9)
    for number, (one, crop) in enumerate(zip(pictures, cut, strict=True)):
        shown = np.moveaxis(crop[:3] if len(crop) >= 3 else np.repeat(crop[:1], 3, axis=0), 0, -1)
        shown = np.repeat(np.repeat(np.clip(shown, 0, 1), scale, axis=0), scale, axis=1)
        row, column = divmod(number, across)
        x = gap + column * (box + gap)
        y = height - head - row * (box + label + gap) - box
        figure.figimage(shown, xo=x, yo=y, origin="upper")
        figure.text((x + box / 2) / width, (y - 3) / height, one.label, ha="center", va="top", fontsize=8)
    picture = BytesIO()
    figure.savefig(picture, format="png")
    return picture.getvalue()
