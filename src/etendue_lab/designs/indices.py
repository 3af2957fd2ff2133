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


@dataclass(frozen=True)
class Indices:
    """Indices of every factor, each with the ends of its interval."""

    first: Array  # (factors, 3): value, low, high
    total: Array
    points: int


def mixed_of(metric: Array, factors: int) -> Array:
    """Return a metric as (points, factors + 2): at A, at B, and at A with each column from B; without points that lack
    any.
    """
    whole = len(metric) // (factors + 2)
    found = metric[: whole * (factors + 2)].reshape(whole, factors + 2)
    return found[np.isfinite(found).all(axis=1)]


def saltelli(mixed: Array) -> Array:
    """Return first-order and total indices, (.., 2, factors), of metrics (.., points, factors + 2)."""
    a, b, ab = mixed[..., 0], mixed[..., 1], np.moveaxis(mixed[..., 2:], -1, -2)
    both = np.concatenate([a, b], axis=-1)
    mean, variance = both.mean(axis=-1, keepdims=True), both.var(axis=-1)
    a, b, ab = a - mean, b - mean, ab - mean[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        first = (b[..., None, :] * (ab - a[..., None, :])).mean(axis=-1) / variance[..., None]
        total = 0.5 * ((a[..., None, :] - ab) ** 2).mean(axis=-1) / variance[..., None]
    return np.asarray(np.nan_to_num(np.stack([first, total], axis=-2), nan=0.0, posinf=0.0, neginf=0.0))


def indices(mixed: Array, resampled: int = RESAMPLED, level: float = LEVEL, seed: int = 0) -> Indices:
    """Return the indices with intervals: percentiles of indices of resampled points, centred on the estimate.

    Resampling takes points for independent. Those of a scrambled sequence fill space more evenly, so that the
    intervals are too wide rather than too narrow.
    """
    found = saltelli(mixed)
    points, generator = len(mixed), np.random.default_rng(seed)
    again = np.empty((resampled, *found.shape))
    for number in range(resampled):
        again[number] = saltelli(mixed[generator.integers(0, points, points)])
    ends = np.quantile(again, [(1 - level) / 2, (1 + level) / 2], axis=0)
    whole = np.stack([found, *ends], axis=-1)
    return Indices(whole[0], whole[1], points)
