"""Random draws of electron counts about a mean.

In:  expected charge (electrons); a generator, or a uniform per pixel.
Out: whole numbers of electrons in the dtype of the mean.
Source: Cornish and Fisher 1938 (normal form of a Poisson quantile).

The exact distributions, the reference for these draws, are in `distributions.py`.
"""

import math
from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue_camera.electronics import poisson_table

LARGEST_EXACT = 9.2e18  # numpy's exact sampler counts in int64
LARGEST_MEAN = 1e36  # a normal about it still fits into 32 bits
LARGEST_INVERTED = 200.0  # electrons, up to which `poisson_by_inversion` searches
SMALLEST_NORMAL_MEAN = 10.0  # below, the cubic of `cornish_fisher` folds inside the range of normals
BLOCK = 1 << 16  # number of pixels whose temporaries fit into the cache


def poisson(mean: ArrayLike, rng: np.random.Generator, exact_below: float = 30.0) -> NDArray:
    """Draw Poisson counts: exact for small means, a corrected normal for large ones.

    Parameters
    ----------
    mean : (...) array, electrons
        0 to 1e36; to 9.2e18 where exact_below is larger than that.
    rng : numpy Generator
        Advances by one uniform for each mean below both 64 and exact_below, then by numpy's exact draws, then by one
        normal for each remaining mean.
    exact_below : float, electrons
        10 or more; infinity makes every draw exact.

    Returns
    -------
    (...) array, electrons, dtype of mean (integers become float64)
        Integers. float32 is exact for integers up to 1.7e7 and rounds beyond, by 6e-8 of the count.

    Raises
    ------
    ValueError
        If a mean is NaN, negative or too large, or exact_below is not allowed.

    Notes
    -----
    Source: `poisson_table.quantiles` of a uniform, numpy's sampler, and `cornish_fisher` of a normal. Total variation
    from Poisson: 0 below exact_below; 5.6e-4 at a mean of 10, 1.0e-4 at 30, 5.1e-7 at 1000
    (`distributions.poisson_total_variation`).
    """
    exact_below = float(exact_below)
    mean = _means(mean, LARGEST_EXACT if exact_below > LARGEST_EXACT else LARGEST_MEAN)
    require.that(
        exact_below >= SMALLEST_NORMAL_MEAN,
        f"exact_below is {exact_below!r} electrons; it must be {SMALLEST_NORMAL_MEAN} or more, or inf",
    )
    flat = np.ascontiguousarray(mean).reshape(-1)
    counts = np.empty_like(flat)
    tabled = min(exact_below, float(poisson_table.LIMIT))
    _drawn(counts, flat, (0.0, tabled), lambda some: poisson_table.quantiles(some, rng.random(some.size)))
    _drawn(counts, flat, (tabled, exact_below), rng.poisson)
    _drawn(
        counts, flat, (exact_below, math.inf), lambda some: cornish_fisher(some, _normals(rng, some.shape, some.dtype))
    )
    return counts.reshape(mean.shape)


def _drawn(counts: NDArray, mean: NDArray, limits: tuple[float, float], draw: Callable[[NDArray], NDArray]) -> None:
    """Draw the counts of the means within limits, lowest <= mean < highest, in the order of the pixels."""
    low, high = limits
    if low == high:
        return
    for start in range(0, mean.size, BLOCK):  # the draws continue from block to block
        block = mean[start : start + BLOCK]
        inside = block < high if low == 0 else block >= low if high == math.inf else (block >= low) & (block < high)
        number = np.count_nonzero(inside)
        if number == block.size:
            counts[start : start + BLOCK] = draw(block)
        elif number:
            some = np.flatnonzero(inside)  # by index, a fifth faster than by mask for mixed means
            counts[start : start + BLOCK][some] = draw(block[some])


def poisson_by_inversion(mean: ArrayLike, uniform: ArrayLike, exact_below: float = 30.0) -> NDArray:
    """Draw Poisson counts from given uniforms: for a fixed uniform the count never decreases as the mean increases.

    Parameters
    ----------
    mean : (...) array, electrons
        0 to 1e36.
    uniform : (...) array, dimensionless
        0 <= u < 1; the shapes broadcast. float32 uniforms have no tail beyond 6e-8.
    exact_below : float, electrons
        From 10 to 200. Below, the inverse is searched; above, the corrected normal is used.

    Returns
    -------
    (...) array, electrons, dtype of mean (integers become float64)
        The smallest k with u < F(k; mean), F from scipy's `pdtr` (1e-15); from exact_below on, approximately.

    Raises
    ------
    ValueError
        If a mean, a uniform or exact_below is not allowed.

    Notes
    -----
    Source: inversion. Below 64 electrons, `poisson_table.quantiles` is used; above, the search starts at a
    Cornish-Fisher quantile and corrects it one step at a time. From exact_below on, the result is `cornish_fisher` of
    the normal quantile, limited to 8.3 sigma. Just above the transition the count is at least the exact count at
    exact_below, so that it does not decrease there. Intended for sweeps with the same noise in all cells
    ("common"): with a rejection sampler, counts from equal generator states decorrelate if the mean changes by 1e-4.
    """
    mean, uniform = np.broadcast_arrays(_means(mean), np.asarray(uniform, np.float64))
    if not np.all((uniform >= 0) & (uniform < 1)):
        raise ValueError(f"uniform ranges from {uniform.min()} to {uniform.max()}; 0 <= u < 1 is required")
    require.that(
        SMALLEST_NORMAL_MEAN <= exact_below <= LARGEST_INVERTED,
        f"exact_below is {exact_below!r} electrons; it must be {SMALLEST_NORMAL_MEAN} to {LARGEST_INVERTED}",
    )
    work = mean.astype(np.float64).reshape(-1)
    uniform = uniform.reshape(-1)
    normal = np.clip(scipy.special.ndtri(uniform), -8.3, 8.3)
    counts = np.empty_like(work)
    few = work < exact_below
    tabled = work < min(exact_below, poisson_table.LIMIT)
    counts[tabled] = poisson_table.quantiles(work[tabled], uniform[tabled])
    searched = few & ~tabled
    counts[searched] = _inverse(work[searched], uniform[searched], normal[searched])
    counts[~few] = cornish_fisher(work[~few], normal[~few])
    near = ~few & (work < exact_below + 4 * exact_below**0.5)
    seam = np.full(np.count_nonzero(near), float(exact_below))
    counts[near] = np.maximum(counts[near], _inverse(seam, uniform[near], normal[near]))
    return counts.reshape(mean.shape).astype(mean.dtype)


def cornish_fisher(mean: NDArray, normal: NDArray) -> NDArray:
    """Return the approximate Poisson quantile at a normal quantile.

    Parameters
    ----------
    mean : (...) array, electrons
        10 or more; for smaller means the cubic folds within 7 sigma.
    normal : (...) array, dimensionless

    Returns
    -------
    (...) array, electrons
        floor(m + sqrt(m) z + 1/3 + z^2/6 - (z^3 + 2 z)/(72 sqrt(m))), at least 0.

    Notes
    -----
    Source: Cornish-Fisher expansion to third order, the continuity correction folded into 1/3.
    """
    root = np.sqrt(mean)
    thin = 1 / (72 * root)
    count = np.asarray(normal * thin)
    np.subtract(1 / 6, count, out=count)
    count *= normal
    thin *= 2
    root -= thin
    count += root
    count *= normal
    count += 1 / 3
    count += mean
    np.floor(count, out=count)
    return np.maximum(count, 0, out=count)


def mean_factor(spread: float) -> float:
    """Return the mean of 1 + spread z over standard normals z, with negative values set to 0.

    Parameters
    ----------
    spread : float, dimensionless
        At or above 0.

    Returns
    -------
    float
        1 for spreads below 0.1, and 1.083 at 1.

    Notes
    -----
    Source: Phi(1 / s) + s phi(1 / s), the mean of a normal distribution clipped at 0. Error: below 1e-15.
    """
    if spread < 0.02:  # less than 1e-500 is below 0
        return 1.0
    away = 1 / spread
    return 0.5 * (1 + math.erf(away / math.sqrt(2))) + spread * math.exp(-0.5 * away**2) / math.sqrt(2 * math.pi)


def _inverse(mean: NDArray, uniform: NDArray, normal: NDArray) -> NDArray:
    """Return the smallest k with uniform < F(k; mean): it is searched from the normal quantile in steps of one."""
    guess = mean + np.sqrt(mean) * normal + 1 / 3 + normal**2 / 6
    counts = np.maximum(np.floor(guess), 0)

    for step in (-1, 1):
        active = np.arange(counts.size)
        while active.size:
            k, m, u = counts[active], mean[active], uniform[active]
            wrong = (k > 0) & (u < scipy.special.pdtr(k - 1, m)) if step < 0 else u >= scipy.special.pdtr(k, m)
            active = active[wrong]
            counts[active] += step
    return counts


def _normals(rng: np.random.Generator, shape: tuple[int, ...], dtype: np.dtype) -> NDArray:
    """Draw one normal per mean, in float32 for float32 means, which takes half the time."""
    if dtype == np.float32:
        return rng.standard_normal(shape, dtype=np.float32)
    return rng.standard_normal(shape).astype(dtype, copy=False)


def _means(mean: ArrayLike, largest: float = LARGEST_MEAN) -> NDArray:
    mean = np.asarray(mean)
    if not np.issubdtype(mean.dtype, np.floating):
        mean = mean.astype(np.float64)
    if mean.size and not (mean.min() >= 0 and mean.max() <= largest):
        raise ValueError(
            f"mean ranges from {mean.min()} to {mean.max()} electrons; it must be from 0 to {largest:g} with "
            "no NaN (negative means come from an undershooting blur: clip them, and count the clipped values)"
        )
    return mean
