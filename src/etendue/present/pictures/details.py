"""Details: the same place of the scene in every stage, sample by sample, where blur and noise are visible.

In:  the grids of the shown pictures; later, the rows of each picture kept at full resolution.
Out: rows of every picture that are kept while it is reduced; within them, the detail that shows a strong edge between
     flat areas.

Pictures that fit are kept whole. From each larger picture a band of rows is kept that shows the same part of the scene
in all pictures. The position of the band is fixed, because the content of the picture is unknown when its first stage
is computed; the detail is chosen within the band later.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from etendue.contract.arrays.grid import Grid, Line
from etendue.transfer.resampling import area_weights
from etendue.types.arrays import Array

SIDE = 132  # dots, and maximum samples, along the side of a detail
BAND = 1 << 18  # samples of the coarsest picture kept at full resolution
MIDDLE = 0.45  # position of the band as a share of the height: charts often have gaps exactly half way


@dataclass(frozen=True)
class PlaneWindow:
    """A rectangle of the image plane, um."""

    top: float
    bottom: float
    left: float = -np.inf
    right: float = np.inf

    def rows(self, line: Line) -> tuple[int, int]:
        return _within(line, self.top, self.bottom)

    def columns(self, line: Line) -> tuple[int, int]:
        return _within(line, self.left, self.right)


def _within(line: Line, low: float, high: float) -> tuple[int, int]:
    """Return the index of the first sample between two positions (um), and the index after the last; for a line without
    positions, the whole line.
    """
    start, step = line.um()
    if not step > 0:
        return 0, line.size
    first = 0 if np.isinf(low) else min(max(0, round((low - start) / step + 0.5)), line.size - 1)
    last = line.size if np.isinf(high) else min(max(first + 1, round((high - start) / step + 0.5)), line.size)
    return first, last


def lines_of(grid: Grid) -> tuple[Line, Line] | None:
    """Return the coordinates of a picture along y and x; None if it has none."""
    if "y" not in grid or "x" not in grid:
        return None
    y, x = grid["y"], grid["x"]
    return (y, x) if isinstance(y, Line) and isinstance(x, Line) else None


def kept_window(grids: Sequence[Grid]) -> PlaneWindow | None:
    """Return the window of the image plane that every picture keeps at full resolution: some rows of the coarsest
    picture.
    """
    lines = [found for grid in grids if (found := lines_of(grid))]
    if not lines:
        return None
    y, x = min(lines, key=lambda pair: pair[0].size * pair[1].size)
    start, step = y.um()
    rows = min(y.size, max(side_of((y.size, x.size)), BAND // max(x.size, 1)))
    first = min(max(0, round(MIDDLE * y.size - rows / 2)), y.size - rows)
    left, across = x.um()
    return PlaneWindow(
        start + (first - 0.5) * step,
        start + (first + rows - 0.5) * step,
        left - 0.5 * across,
        left + (x.size - 0.5) * across,
    )


def side_of(shape: tuple[int, int]) -> int:
    """Return the side of a detail in samples of the coarsest picture. Small pictures get fewer, because they are drawn
    enlarged anyway.
    """
    largest = max(shape)
    return min(33 if largest >= 128 else 22 if largest >= 64 else 11, *shape)


def part_of(picture: Array, side: int) -> tuple[int, int]:
    """Return the first row and column of the window with the strongest edge between flat areas, in a (y, x, 3) or (3,
    y, x) picture with values from 0 to 1.

    The score is the standard deviation of brightness times the ratio of root mean square to mean step between samples:
    many times larger for one edge than for a ramp or a texture. Areas clipped at black or white do not count, because
    noise is invisible there.
    """
    grey = np.asarray(picture, np.float64).mean(axis=0 if picture.shape[0] == 3 and picture.shape[-1] != 3 else -1)
    rows, columns = grey.shape
    side = min(side, rows, columns)
    down = np.abs(np.diff(grey, axis=0, append=grey[-1:]))
    across = np.abs(np.diff(grey, axis=1, append=grey[:, -1:]))
    mean = _means(grey, side)
    spread = np.sqrt(np.maximum(_means(grey**2, side) - mean**2, 0))
    steps = np.hypot(down, across)
    sharp = np.sqrt(np.maximum(_means(steps**2, side), 0))
    score = spread * sharp / (_means(steps, side) + 0.02 * spread + 1e-6)
    score = score * (1.02 - _means(((grey > 0.995) | (grey < 0.005)).astype(float), side))
    top, left = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(top), int(left)


def _means(values: Array, side: int) -> Array:
    """Return the mean over every square window of ``side`` samples."""
    total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    total[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
    return (total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]) / side**2


def limited(part: Array) -> Array:
    """Return the (3, y, x) detail, averaged over areas if it has more samples than dots."""
    y, x = part.shape[-2:]
    if max(y, x) <= SIDE:
        return part
    share = SIDE / max(y, x)
    return area_weights(y, max(1, round(y * share))) @ part @ area_weights(x, max(1, round(x * share))).T
