"""Fixed patterns of a measurement, from every frame there is: of the dark, and of the response.

In:  frames of many levels.
Out: mean patterns of groups of frames; their variance from products of different groups, free of temporal noise.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import scipy

from etendue_camera.arrays import Array
from etendue_camera.electronics.jackknife import BLOCKS, Estimate, left_out
from etendue_lab.frames.frame_set import FrameSet, Level
from etendue_lab.frames.moments import MONO, Site

GROUPS = 8
LARGEST = 1 << 10  # rows and columns; patterns of larger frames are those of their centre


@dataclass(frozen=True)
class Pattern:
    """Mean patterns by group of frames, (group, y, x), each without its mean."""

    groups: Array
    frames: int

    @property
    def mean(self) -> Array:
        return np.asarray(self.groups.mean(axis=0))

    def without(self, part: Array) -> Pattern:
        """Return the pattern without a part that all groups share."""
        return Pattern(self.groups - part, self.frames)

    def scaled(self, factor: float) -> Pattern:
        return Pattern(self.groups * factor, self.frames)

    def variance(self, confidence: float = 0.95) -> Estimate:
        """Return the variance over pixels from products of different groups.

        Its interval joins the jackknife over blocks of pixels with that over groups of frames (four or more): patterns
        that move between frames are no independent noise of pixels.
        """
        g = len(self.groups)

        def crossed(groups: Array) -> Array:
            k = len(groups)
            sums = [left_out(groups.sum(axis=0) ** 2 - (groups**2).sum(axis=0)), left_out(np.ones(groups.shape[1:]))]
            return np.asarray(sums[0] / sums[1] / (k * (k - 1)))

        by_pixels = crossed(self.groups)
        blocks = by_pixels.size - 1
        square = (blocks - 1) * float(np.mean((by_pixels[1:] - by_pixels[1:].mean()) ** 2))
        freedom = float(blocks - 1)
        if g >= 4:
            own = np.array([float(crossed(np.delete(self.groups, i, axis=0))[0]) for i in range(g)])
            moving = (g - 1) * float(np.mean((own - own.mean()) ** 2))
            # Satterthwaite: the freedom of a sum of two variances
            total = square + moving
            freedom = total**2 / max(square**2 / (blocks - 1) + moving**2 / (g - 1), 1e-300)
            square = total
        wide = float(scipy.special.stdtrit(max(freedom, 1.0), 0.5 + 0.5 * confidence)) * float(np.sqrt(square))
        value = float(by_pixels[0])
        return Estimate(value, value - wide, value + wide, "")


def pattern(frames: FrameSet, levels: Iterable[tuple[Level, float, float]], site: Site = MONO) -> Pattern | None:
    """Return the pattern of levels, each with the offset that is subtracted and the weight of one of its frames.

    The frame of a level counts as weight x (frame - its mean), so a response is given by weights of 1 / signal times
    the information of the level; groups are normalised by ``offset``, a signal. None: fewer than two frames.
    """
    first, left, step = site
    given = [(frame, signal, weight) for level, signal, weight in levels for frame in level.frames]
    if len(given) < 2:
        return None
    groups = min(GROUPS, len(given))
    sums: Array | None = None
    weights = np.zeros(groups)
    # frames of one level go to different groups, so that every group has all levels
    for number, (frame, signal, weight) in enumerate(given):
        codes = _centre(frames.cut(frame)[first::step, left::step]).astype(np.float64)
        if sums is None:
            sums = np.zeros((groups, *codes.shape))
        codes -= codes.mean()
        sums[number % groups] += (weight / signal) * codes
        weights[number % groups] += weight
    assert sums is not None
    return Pattern(sums / weights[:, None, None], len(given))


def growing(frames: FrameSet, levels: Iterable[Level], site: Site = MONO) -> Pattern | None:
    """Return the pattern of what grows with the exposure time: DN/s of every pixel, less the mean, by least squares.

    None: the frames have one time, or no two groups of them have two.
    """
    first, left, step = site
    given = [frame for level in levels for frame in level.frames if frame.time == frame.time]
    for groups in range(min(GROUPS, len(given) // 2), 1, -1):
        times = [np.array([frame.time for frame in given[i::groups]]) for i in range(groups)]
        if all(np.ptp(own) > 0 for own in times):
            break
    else:
        return None
    sums: Array | None = None
    for number, frame in enumerate(given):
        own = times[number % groups]
        codes = _centre(frames.cut(frame)[first::step, left::step]).astype(np.float64)
        if sums is None:
            sums = np.zeros((groups, *codes.shape))
        codes -= codes.mean()
        sums[number % groups] += (frame.time - own.mean()) / float(((own - own.mean()) ** 2).sum()) * codes
    assert sums is not None
    return Pattern(sums, len(given))


def _centre(codes: Array) -> Array:
    cut = tuple(slice(max(0, (size - LARGEST) // 2), max(0, (size - LARGEST) // 2) + LARGEST) for size in codes.shape)
    return codes[cut]


def smallest(shape: tuple[int, int]) -> bool:
    """Return whether a pattern has enough pixels for its blocks."""
    return min(shape) >= BLOCKS
