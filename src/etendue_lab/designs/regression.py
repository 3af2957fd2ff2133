"""The importance of factors, from the rows of any design: regression, ranks, main effects and products of pairs.

In:  factors as columns of numbers, a metric.
Out: coefficients and shares of the variance, with intervals from resampled rows.
"""

from __future__ import annotations

import numpy as np

from etendue.types.arrays import Array
from etendue_lab.designs.indices import LEVEL, resampling

RESAMPLED = 400


def standardised(factors: Array) -> Array:
    """Return the columns scaled to mean 0 and standard deviation 1; a constant column becomes 0."""
    spread = factors.std(axis=0)
    return np.asarray((factors - factors.mean(axis=0)) / np.where(spread > 0, spread, 1))


def coefficients(factors: Array, metric: Array) -> tuple[Array, float]:
    """Return standardised regression coefficients, and the share of the variance that they explain together."""
    spread = float(metric.std())
    if spread == 0 or len(metric) <= factors.shape[1] + 1:
        return np.zeros(factors.shape[1]), 0.0
    scaled, own = standardised(factors), (metric - metric.mean()) / spread
    found = np.linalg.lstsq(scaled, own, rcond=None)[0]
    return found, float(1 - np.mean((own - scaled @ found) ** 2))


def with_interval(factors: Array, metric: Array, seed: int = 0) -> Array:
    """Return the coefficients as (factors, 3): value, low, high."""
    found, generator = coefficients(factors, metric)[0], resampling(seed)
    again = np.empty((RESAMPLED, len(found)))
    for number in range(RESAMPLED):
        chosen = generator.integers(0, len(metric), len(metric))
        again[number] = coefficients(factors[chosen], metric[chosen])[0]
    return np.stack([found, *np.quantile(again, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)], axis=-1)


def rank_correlations(factors: Array, metric: Array) -> Array:
    """Return Spearman's correlation of every factor with a metric."""
    from scipy.stats import rankdata

    ranks = standardised(np.apply_along_axis(rankdata, 0, factors))
    own = standardised(rankdata(metric)[:, None])[:, 0]
    return np.asarray(ranks.T @ own / len(metric))


def main_effect(factor: Array, metric: Array) -> float:
    """Return the share of the variance that one factor explains alone, minus the share expected by chance (epsilon
    squared). The explained variance is that of group means of the metric. Rows with the same value of the factor form a
    group if values repeat; otherwise rows are sorted by the factor and split into groups of equal size.
    """
    values, group = np.unique(factor, return_inverse=True)
    if 4 * len(values) > len(factor):
        count = int(max(2, min(32, round(len(factor) ** 0.5 / 2))))
        group = np.argsort(np.argsort(factor, kind="stable"), kind="stable") * count // len(factor)
    sizes = np.bincount(group)
    means = np.bincount(group, metric) / np.maximum(sizes, 1)
    within = float(((metric - means[group]) ** 2).sum())
    whole, groups, rows = float(((metric - metric.mean()) ** 2).sum()), int((sizes > 0).sum()), len(metric)
    if whole == 0 or rows <= groups:
        return 0.0
    return max(0.0, 1 - within / (rows - groups) / (whole / (rows - 1)))


def pairs(factors: Array, metric: Array) -> Array:
    """Return (factors, factors): the share of the variance that the product of two standardised factors explains,
    beyond linear and squared terms.
    """
    count, scaled = factors.shape[1], standardised(factors)
    found = np.zeros((count, count))
    before, own = [scaled, scaled**2], metric - metric.mean()
    base = np.concatenate([np.ones((len(metric), 1)), *before], axis=1)
    left = own - base @ np.linalg.lstsq(base, own, rcond=None)[0]
    for i in range(count):
        for j in range(i):
            product = scaled[:, i] * scaled[:, j]
            product = product - base @ np.linalg.lstsq(base, product, rcond=None)[0]
            power = float(product @ product) * float(own @ own)
            found[i, j] = found[j, i] = float(product @ left) ** 2 / power if power > 0 else 0.0
    return found
