"""Fixed patterns of a measurement, from all frames: the dark pattern and the pattern of the response.

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
FEWEST = 4  # minimum number of groups from whose scatter drifting patterns are recognised
LARGEST = 1 << 10  # maximum rows and columns; only the centre of larger frames is used


@dataclass(frozen=True)
class Pattern:
    """The mean frame of each group of frames, (group, y, x), minus its mean over pixels."""

    groups: Array
    frames: int

    @property
    def mean(self) -> Array:
        return np.asarray(self.groups.mean(axis=0))

    def without(self, part: Array) -> Pattern:
        """Return the pattern minus a plane (y, x), which is subtracted from every group."""
        return Pattern(self.groups - part, self.frames)

    def less(self, other: Pattern, scale: float) -> Pattern:
        """Subtract ``scale`` times another pattern, group by group. The noise of a group of the other pattern then
        enters only one group, so noise cancels in products of different groups.
        """
        k = min(len(self.groups), len(other.groups))
        one, own = (np.stack([groups[i::k].mean(axis=0) for i in range(k)]) for groups in (self.groups, other.groups))
        return Pattern(one - scale * own, self.frames)

    def scaled(self, factor: float) -> Pattern:
        return Pattern(self.groups * factor, self.frames)

    def variance(self, confidence: float = 0.95) -> Estimate:
        """Return the variance over pixels from products of different groups.

        Its interval combines the jackknife over blocks of pixels with the jackknife over groups of frames (four or
        more), because patterns that drift between frames are not independent from pixel to pixel.
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
            # Satterthwaite: degrees of freedom of a sum of two variances
            total = square + moving
            freedom = total**2 / max(square**2 / (blocks - 1) + moving**2 / (g - 1), 1e-300)
            square = total
        wide = float(scipy.special.stdtrit(max(freedom, 1.0), 0.5 + 0.5 * confidence)) * float(np.sqrt(square))
        value = float(by_pixels[0])
        return Estimate(value, value - wide, value + wide, "")


def pattern(frames: FrameSet, levels: Iterable[tuple[Level, float, float]], site: Site = MONO) -> Pattern | None:
    """Return the fixed pattern in some levels. Each level comes with its signal and the weight of each of its frames.

    The pattern of a group is the weighted mean of (frame - mean of the frame) / signal. With a signal in DN the pattern
    is relative, as PRNU is; with a signal of 1 it is in DN. Return None for fewer than two frames.
    """
    first, left, step = site
    given = [(frame, signal, weight) for level, signal, weight in levels for frame in level.frames]
    if len(given) < 2:
        return None
    groups = min(GROUPS, len(given))
    sums: Array | None = None
    weights = np.zeros(groups)
    # distribute the frames of a level over all groups, so that every group contains every level
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
    """Patterns in the dark: the mean of all frames, and the growth with exposure time."""

    mean: Pattern  # DN
    growth: Pattern | None  # DN/s; None: too few frames at different times
    times: Array  # s, mean of each group

    @property
    def grows(self) -> bool:
        """Whether the growth with exposure time is significant at 1 %."""
        return self.growth is not None and self.growth.variance(0.98).low > 0

    def at(self, time: float) -> Pattern:
        """Return the pattern (DN) at an exposure time (s), derived from all frames; the mean pattern if there is no
        growth.
        """
        if self.growth is None or not self.grows or not np.isfinite(time):
            return self.mean
        return Pattern(self.mean.groups + self.growth.groups * (time - self.times)[:, None, None], self.mean.frames)


def differ(times: Array) -> bool:
    """Return whether exposure times differ by more than their rounding, one part in a million."""
    return bool(times.size and np.ptp(times) > 1e-6 * times.max())


def dark_patterns(frames: FrameSet, levels: Iterable[Level], site: Site = MONO) -> DarkPatterns | None:
    """Return the dark pattern (DN) and its growth with exposure time (DN/s), a least-squares slope in every group of
    frames. Return None for fewer than two frames.
    """
    first, left, step = site
    given = [frame for level in levels for frame in level.frames]
    if len(given) < 2:
        return None
    groups = most = min(GROUPS, len(given))
    times = np.array([frame.time for frame in given])
    # use the largest number of groups of which each has two different times; below four, drift cannot be recognised
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
    """Return whether each side of a pattern has at least one pixel per block."""
    return min(shape) >= BLOCKS
