"""The same crop of several pictures side by side, where they differ most; for pictures of several sizes, crops of the
same area of the image plane.

In:  pictures (channel, y, x), the first of them the reference; the positions of their pixels, in um.
Out: a PNG, each sample a whole number of screen pixels, with the size of each crop in pixels and um.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np
import scipy

from etendue.contract.arrays.drawn import Drawn
from etendue.present.pictures.appearance import Appearance, brightness, rendered
from etendue.types.arrays import Array

SIDE, SHOWN, COLUMNS = 56, 280, 5  # samples of a crop, its size on the screen, crops in a row
COARSE = 28  # samples of a crop of the coarsest picture, if pixel sizes differ
BORDER = 10
Plane = tuple[tuple[float, float], tuple[float, float]]  # (first, step) of pixel centres along y and x, um


@dataclass(frozen=True)
class Strip:
    """One picture and its caption."""

    label: str
    picture: Array
    plane: Plane | None = None


def where_most(pictures: list[Array], side: int) -> tuple[int, int]:
    """Return the first row and column of the window in which the pictures differ most from each other."""
    spread = np.stack([np.asarray(p, np.float64) for p in pictures]).std(axis=0).mean(axis=0)
    rows, columns = spread.shape
    edge = BORDER if min(rows, columns) >= side + 2 * BORDER else 0
    mean = scipy.ndimage.uniform_filter(spread**2, side, mode="constant")
    half = side // 2
    mean = mean[edge + half : rows - edge - (side - half) + 1, edge + half : columns - edge - (side - half) + 1]
    row, column = np.unravel_index(int(np.argmax(mean)), mean.shape)
    return int(row) + edge, int(column) + edge


def strip(pictures: list[Strip], encoded: bool, title: str) -> bytes:
    """Return a PNG of the reference and the alternatives; linear pictures share one scale and are encoded for the
    screen.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    alike = len({(p.picture.shape[-2:], p.plane) for p in pictures}) == 1
    windows, said = (_of_one_size if alike else _of_several)(pictures)
    cut = [
        p.picture[..., top : top + high, left : left + wide]
        for p, (top, left, high, wide) in zip(pictures, windows, strict=True)
    ]
    own = Appearance(Drawn("encoded" if encoded else "linear"))
    white = brightness(own.drawn, own.rgb(cut[0]))
    largest = [max(high, wide) for _, _, high, wide in windows]
    scales = [max(1, SHOWN // own) for own in largest]
    box, label, gap, head = (
        max(scale * own for scale, own in zip(scales, largest, strict=True)),
        22 if alike else 34,
        8,
        30,
    )
    across = min(COLUMNS, len(pictures))
    down = -(-len(pictures) // across)
    width, height = across * (box + gap) + gap, head + down * (box + label + gap) + gap
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(gap / width, 1 - 0.55 * head / height, f"{title} ({said})", ha="left", va="center", fontsize=9)
    for number, (one, crop, scale) in enumerate(zip(pictures, cut, scales, strict=True)):
        shown = rendered(own.drawn, own.rgb(crop), white).repeat(scale, axis=0).repeat(scale, axis=1)
        row, column = divmod(number, across)
        x = gap + column * (box + gap)
        y = height - head - row * (box + label + gap) - box
        figure.figimage(shown, xo=x + (box - shown.shape[1]) // 2, yo=y + (box - shown.shape[0]) // 2, origin="upper")
        text = one.label if alike else f"{one.label}\n{sized(crop.shape[-2:], one.plane)}"
        figure.text((x + box / 2) / width, (y - 3) / height, text, ha="center", va="top", fontsize=8)
    picture = BytesIO()
    figure.savefig(picture, format="png")
    return picture.getvalue()


def sized(shape: tuple[int, int], plane: Plane | None) -> str:
    """Return ``56 x 56 pixels of 5.4 um: 302 x 302 um``, width first."""
    pixels = f"{shape[1]} x {shape[0]} pixels"
    if plane is None:
        return pixels
    dy, dx = plane[0][1], plane[1][1]
    pitch = f"{dx:.4g} um" if dx == dy else f"{dx:.4g} x {dy:.4g} um"
    return f"{pixels} of {pitch}: {shape[1] * dx:.4g} x {shape[0] * dy:.4g} um"


def _of_one_size(pictures: list[Strip]) -> tuple[list[tuple[int, int, int, int]], str]:
    """Return the window in which the compared pictures differ most, repeated for each picture, and a text with its
    position.
    """
    rows, columns = pictures[0].picture.shape[-2:]
    side = min(SIDE, rows, columns)
    compared = [p.picture for p in pictures[1:]]
    top, left = where_most(compared if len(compared) > 1 else [p.picture for p in pictures], side)
    return [(top, left, side, side)] * len(
        pictures
    ), f"{sized((side, side), pictures[0].plane)}, from row {top}, column {left}"


def _of_several(pictures: list[Strip]) -> tuple[list[tuple[int, int, int, int]], str]:
    """Return the window of each picture that shows the square of the image plane where the first compared picture
    differs most from the reference; and a text with its size.
    """
    planes = [p.plane for p in pictures if p.plane is not None]
    steps = [step for plane in planes for _, step in plane]
    fields = [
        n * step
        for p, plane in zip(pictures, planes, strict=True)
        for n, (_, step) in zip(p.picture.shape[-2:], plane, strict=True)
    ]
    side = min(COARSE * max(steps), SHOWN * min(steps), *fields)
    first = planes[0]
    own = max(1, min(round(side / first[0][1]), *pictures[0].picture.shape[-2:]))
    corner = where_most([p.picture for p in pictures[:2]], own)
    centre = [start + step * (place + (own - 1) / 2) for (start, step), place in zip(first, corner, strict=True)]
    windows = []
    for picture, plane in zip(pictures, planes, strict=True):
        size = [
            max(1, min(round(side / step), n)) for (_, step), n in zip(plane, picture.picture.shape[-2:], strict=True)
        ]
        place = [
            min(max(round((at - start) / step - (n - 1) / 2), 0), whole - n)
            for at, (start, step), n, whole in zip(centre, plane, size, picture.picture.shape[-2:], strict=True)
        ]
        windows.append((place[0], place[1], size[0], size[1]))
    return windows, f"the same {side:.4g} x {side:.4g} um of the image plane in each"
