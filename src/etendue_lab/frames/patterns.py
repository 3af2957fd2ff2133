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
FEWEST = 4  # groups whose scatter tells how patterns move
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

    def less(self, other: Pattern, scale: float) -> Pattern:
        """Return the pattern less another, group by group: the noise of a group of the other is in no second group,
        and so in no product of two.
        """
        k = min(len(self.groups), len(other.groups))
        one, own = (np.stack([groups[i::k].mean(axis=0) for i in range(k)]) for groups in (self.groups, other.groups))
        return Pattern(one - scale * own, self.frames)

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


@dataclass(frozen=True)
class DarkPatterns:
    """Patterns of the dark: the mean of all frames, and what grows with the exposure time."""

    mean: Pattern  # DN
    growth: Pattern | None  # DN/s; None: too few frames at different times
    times: Array  # s, mean of each group

    @property
    def grows(self) -> bool:
        """Whether a test at 1 % accepts that it grows."""
        return self.growth is not None and self.growth.variance(0.98).low > 0

    def at(self, time: float) -> Pattern:
        """Return the pattern at a time, from all frames; their mean where it does not grow."""
        if self.growth is None or not self.grows or not np.isfinite(time):
            return self.mean
        return Pattern(self.mean.groups + self.growth.groups * (time - self.times)[:, None, None], self.mean.frames)


def differ(times: Array) -> bool:
    """Return whether exposure times differ by more than their rounding, one in a million."""
    return bool(times.size and np.ptp(times) > 1e-6 * times.max())


def dark_patterns(frames: FrameSet, levels: Iterable[Level], site: Site = MONO) -> DarkPatterns | None:
    """Return the patterns of dark levels; growth by least squares in every group of frames. None: fewer than two."""
    first, left, step = site
    given = [frame for level in levels for frame in level.frames]
    if len(given) < 2:
        return None
    groups = most = min(GROUPS, len(given))
    times = np.array([frame.time for frame in given])
    # every group has two times or more; fewer than four groups do not tell what moves
    while groups >= FEWEST and not all(differ(times[i::groups]) for i in range(groups)):
        groups -= 1
    timed = groups >= FEWEST and not np.isnan(times).any()
    groups = groups if timed else most
    means = np.array([times[i::groups].mean() for i in range(groups)])
    spans = np.array([((times[i::groups] - means[i]) ** 2).sum() for i in range(groups)])
    counts = np.array([times[i::groups].size for i in range(groups)])
    sums: Array | None = None
    for number, frame in enumerate(given):
        codes = _centre(frames.cut(frame)[first::step, left::step]).astype(np.float64)
        if sums is None:
            sums = np.zeros((2 if timed else 1, groups, *codes.shape))
        codes -= codes.mean()
        own = number % groups
        sums[0, own] += codes / counts[own]
        if timed:
            sums[1, own] += (times[number] - means[own]) / spans[own] * codes
    assert sums is not None
    growth = Pattern(sums[1], len(given)) if timed else None
    return DarkPatterns(Pattern(sums[0], len(given)), growth, means)


def _centre(codes: Array) -> Array:
    cut = tuple(slice(max(0, (size - LARGEST) // 2), max(0, (size - LARGEST) // 2) + LARGEST) for size in codes.shape)
    return codes[cut]


def smallest(shape: tuple[int, int]) -> bool:
    """Return whether a pattern has enough pixels for its blocks."""
    return min(shape) >= BLOCKS
