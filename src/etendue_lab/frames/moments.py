"""Moments of the levels of a measurement, read one frame at a time.

In:  frames of one level; the site of a colour filter array.
Out: mean, temporal variance, row and column variance, histogram; each also for all pixels except one group.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from etendue.errors import RequestError
from etendue_camera.arrays import Array
from etendue_camera.electronics.jackknife import BLOCKS
from etendue_lab.frames.frame_set import FrameSet, Level

LONGEST_HISTOGRAM = 1 << 20  # codes
Site = tuple[int, int, int]  # first row, first column, step
MONO: Site = (0, 0, 1)


@dataclass(frozen=True)
class LevelMoments:
    """Moments of the frames of one level. The first axis of the arrays holds the value from all pixels, then the values
    with one of the 8 x 8 blocks of pixels left out.
    """

    time: float
    light: float
    frames: int
    pixels: int
    shape: tuple[int, int]
    mean: Array  # DN
    variance: Array  # DN^2, temporal; offsets of whole frames are removed
    spatial: Array  # DN^2, over the mean frame; its temporal part is removed
    row_variance: float  # DN^2, temporal, of offsets of whole rows; may be negative
    column_variance: float
    drift: float  # DN, standard deviation of the means of the frames
    histogram: Array  # counts of codes from 0

    @property
    def top(self) -> int:
        """Highest code."""
        return int(self.histogram.size - 1)

    def variance_error(self, lines: tuple[float, float] = (0.0, 0.0)) -> float:
        """Return the sampling standard error of the temporal variance, DN^2. ``lines``: the variances (DN^2) of row and
        of column offsets, whose sampling error is larger because there are few lines.
        """
        parts = [(float(self.variance[0]), self.pixels), (lines[0], self.shape[0]), (lines[1], self.shape[1])]
        return math.sqrt(2 / (self.frames - 1) * sum(max(own, 0.0) ** 2 / count for own, count in parts))

    def share_at(self, code: int) -> float:
        """Return the share of pixels at or above a code."""
        return float(self.histogram[code:].sum() / self.histogram.sum())


def sites(frames: FrameSet) -> dict[str, Site]:
    """Return the sites of a 2 x 2 mosaic by channel name. The green sites are named Gr and Gb after the other colour in
    their row.
    """
    if frames.pattern == "mono":
        return {"W": MONO}
    letters = frames.pattern.upper()
    if (window := frames.window) is not None:  # the pattern starts at the first pixel of the window
        letters = "".join(letters[2 * ((window.y + i // 2) % 2) + (window.x + i) % 2] for i in range(4))
    found = {}
    for at, letter in enumerate(letters):
        row = letters[2 * (at // 2) : 2 * (at // 2) + 2]
        other = row.replace(letter, "", 1)
        name = f"{letter}{other.lower()}" if letters.count(letter) == 2 else letter
        found[name if name not in found else f"{name}{at + 1}"] = (at // 2, at % 2, 2)
    return found


def moments(frames: FrameSet, level: Level, site: Site = MONO) -> LevelMoments:
    """Return the moments of a level, which needs two frames.

    Memory: 12 bytes per pixel for the sums of codes and of their squares, plus one frame.

    Raises
    ------
    RequestError
        The level has one frame, or a channel has fewer than 8 x 8 pixels.
    """
    count, (first, left, step) = len(level.frames), site
    if count < 2:
        frame = level.frames[0]
        raise RequestError(
            f"{frame.source.path}: the only frame of time {level.time:g} s and light {level.light:g}; two or more of "
            f"each exposure are needed to distinguish noise from patterns"
        )
    total: Array | None = None
    for number, frame in enumerate(level.frames):
        codes = frames.cut(frame)[first::step, left::step]
        if total is None:
            if min(codes.shape) < BLOCKS:
                raise RequestError(
                    f"{frames.path}: {codes.shape[1]} x {codes.shape[0]} pixels; at least 8 x 8 are needed"
                )
            edges = [np.linspace(0, size, BLOCKS + 1).astype(int) for size in codes.shape]
            kind = codes.dtype
            wide = codes.dtype.itemsize > 2 or count > 1 << 15
            total = np.zeros(codes.shape, np.uint64 if wide else np.uint32)
            squares = np.zeros(codes.shape, np.uint64)
            by_frame = np.zeros((count, BLOCKS, BLOCKS))
            lines = [np.zeros((count, size)) for size in codes.shape]
            histogram = np.zeros(0, np.int64)
        if codes.dtype != kind:
            raise RequestError(
                f"{frame.source.path}: has codes of {8 * codes.itemsize} bits, and another frame of its exposure has "
                f"{8 * kind.itemsize}; all frames must have the same number of bits"
            )
        total += codes
        for band in range(BLOCKS):
            part = codes[edges[0][band] : edges[0][band + 1]].astype(np.uint64)
            squares[edges[0][band] : edges[0][band + 1]] += part * part
            by_frame[number, band] = np.add.reduceat(part.sum(axis=0, dtype=np.float64), edges[1][:-1])
            lines[0][number, edges[0][band] : edges[0][band + 1]] = part.mean(axis=1)
            lines[1][number] += part.sum(axis=0, dtype=np.float64)
            histogram = _counted(histogram, part, frames)
    assert total is not None
    lines[1] /= total.shape[0]
    return _moments(level, count, total, squares, edges, by_frame, lines, histogram)


def _counted(histogram: Array, codes: Array, frames: FrameSet) -> Array:
    if int(codes.max()) >= LONGEST_HISTOGRAM:
        raise RequestError(f"{frames.path}: holds the code {int(codes.max())}; codes of at most 20 bits are read")
    own = np.bincount(codes.ravel().astype(np.int64))
    if own.size > histogram.size:
        own[: histogram.size] += histogram
        return own
    histogram[: own.size] += own
    return histogram


def _moments(
    level: Level,
    count: int,
    total: Array,
    squares: Array,
    edges: list[Array],
    by_frame: Array,
    lines: list[Array],
    histogram: Array,
) -> LevelMoments:
    centre = float(by_frame.sum()) / count / total.size
    sums = np.zeros((3, BLOCKS, BLOCKS))  # sums of the mean frame, of its square, and of the temporal variance
    for band in range(BLOCKS):
        rows = slice(edges[0][band], edges[0][band + 1])
        still = total[rows] / count - centre
        # the sums are exact integers below 2^53, so the difference is exact
        moving = (squares[rows].astype(float) - total[rows].astype(float) ** 2 / count) / (count - 1)
        for kind, plane in enumerate((still, still**2, moving)):
            sums[kind, band] = np.add.reduceat(plane.sum(axis=0), edges[1][:-1])
    size = np.outer(np.diff(edges[0]), np.diff(edges[1])).astype(float)
    n, still_sum, still_squares, moving_sum = (_left_out(one) for one in (size, *sums))
    drift = np.stack([_left_out(one) for one in by_frame - centre * size]) / n
    mean = still_sum / n
    # offsets of whole frames are not pixel noise; removing their variance removes 1/n of the noise too
    variance = (moving_sum / n - drift.var(axis=0, ddof=1)) * n / (n - 1)
    line_variances = [  # subtract the contributions of the frame's offset and of pixel noise
        float(
            (one - one.mean(axis=1, keepdims=True) - (one - one.mean(axis=1, keepdims=True)).mean(axis=0)).var()
            * count
            / (count - 1)
            * one.shape[1]
            / (one.shape[1] - 1)
            - variance[0] / (total.size / one.shape[1])
        )
        for one in lines
    ]
    return LevelMoments(
        level.time,
        level.light,
        count,
        int(n[0]),
        (total.shape[0], total.shape[1]),
        mean + centre,
        variance,
        (still_squares - n * mean**2) / (n - 1) - variance / count,
        line_variances[0],
        line_variances[1],
        float(drift[:, 0].std(ddof=1)),
        histogram,
    )


def _left_out(blocks: Array) -> Array:
    whole = blocks.sum()
    return np.concatenate([[whole], whole - blocks.ravel()])
