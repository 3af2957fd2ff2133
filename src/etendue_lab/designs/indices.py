"""Sobol' indices from the rows of a Saltelli design, with intervals.

In:  a metric at the points A and B, and at A with each column taken from B.
Out: first-order and total indices of every factor (Saltelli et al. 2010, as ``scipy.stats.sobol_indices``), with
     intervals from resampled points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue.types.arrays import Array

RESAMPLED = 999
LEVEL = 0.95
OWN_STREAM = 0x5E5A  # resampling must not use the random numbers that drew the points
MOST_COUNTS = 4_000_000  # largest number of values in one batch of resampled points


@dataclass(frozen=True)
class Indices:
    """Indices of every factor, each with the ends of its interval."""

    first: Array  # (factors, 3): value, low, high
    total: Array
    points: int


def mixed_of(metric: Array, factors: int) -> Array:
    """Return a metric as (points, factors + 2) at the samples of a Saltelli design: at matrix A, at matrix B, and at A
    with one column at a time taken from B. Points with a missing value are omitted.
    """
    whole = len(metric) // (factors + 2)
    found = metric[: whole * (factors + 2)].reshape(whole, factors + 2)
    return found[np.isfinite(found).all(axis=1)]


def resampling(seed: int) -> np.random.Generator:
    """Return the random generator that resamples rows. Its stream differs from that of the design, which may have been
    drawn with the same seed.
    """
    return np.random.default_rng([OWN_STREAM, seed])


@dataclass(frozen=True)
class Terms:
    """Terms of the Sobol' indices at every point, computed from the metric minus its mean. The indices are ratios of
    the means of these terms.
    """

    above: Array  # (points, 2 factors): b (ab - a) and (a - ab)^2 / 2
    below: Array  # (points): (a^2 + b^2) / 2
    moved: Array  # (points, 2 factors): the change of the first with the mean, ab - a; 0 of the second
    centre: Array  # (points): (a + b) / 2

    @classmethod
    def of(cls, mixed: Array) -> Terms:
        mixed = mixed - mixed[:, :2].mean()
        a, b, change = mixed[:, 0], mixed[:, 1], mixed[:, 2:] - mixed[:, :1]
        above = np.concatenate([b[:, None] * change, 0.5 * change**2], axis=1)
        return cls(above, (a * a + b * b) / 2, np.concatenate([change, 0 * change], axis=1), (a + b) / 2)

    def ratios(self, weights: Array) -> Array:
        """Return the indices, (.., 2 factors), for points with weights (.., points) that sum to 1."""
        mean = (weights @ self.centre)[..., None]
        variance = (weights @ self.below)[..., None] - mean**2
        return _ratio(weights @ self.above - mean * (weights @ self.moved), variance)

    def errors(self, weights: Array, ratios: Array) -> Array:
        """Return the standard errors of the indices, from the linearised error of a ratio of means."""
        below = (weights @ self.below)[..., None]
        square = weights @ self.above**2 - 2 * ratios * (weights @ (self.above * self.below[:, None]))
        square = square + ratios**2 * (weights @ self.below**2)[..., None]
        return np.asarray(np.sqrt(_ratio(np.maximum(square, 0) / len(self.below), below**2)))


def _ratio(above: Array, below: Array) -> Array:
    return np.asarray(np.divide(above, below, out=np.zeros(above.shape), where=below > 0))


def saltelli(mixed: Array) -> Array:
    """Return first-order and total indices, (2, factors), of a metric (points, factors + 2)."""
    return Terms.of(mixed).ratios(np.full(len(mixed), 1 / len(mixed))).reshape(2, -1)


def indices(mixed: Array, resampled: int = RESAMPLED, level: float = LEVEL, seed: int = 0) -> Indices:
    """Return the indices with intervals: a studentised bootstrap of the points.

    Intervals from percentiles of resampled indices are too narrow with few points, because an index whose error is
    small by chance counts like any other. Here each index is divided by its own error. Resampling assumes independent
    points. Points of a scrambled sequence fill space more evenly, so the intervals are too wide rather than too narrow.
    """
    terms, points = Terms.of(mixed), len(mixed)
    even = np.full(points, 1 / points)
    found = terms.ratios(even)
    errors = terms.errors(even, found)
    generator, batch = resampling(seed), max(1, MOST_COUNTS // points)
    scaled = []
    for begin in range(0, resampled, batch):
        weights = generator.multinomial(points, even, min(batch, resampled - begin)) / points
        again = terms.ratios(weights)
        scaled.append(_ratio(again - found, terms.errors(weights, again)))
    high, low = np.quantile(np.concatenate(scaled), [(1 - level) / 2, (1 + level) / 2], axis=0)
    whole = np.stack([found, found - low * errors, found - high * errors], axis=-1).reshape(2, -1, 3)
    whole[1] = np.maximum(whole[1], 0)  # no total index is below 0
    return Indices(whole[0], whole[1], points)
