"""Poisson quantiles of small means from a table: most quantiles need one look-up, the others a comparison with the
distribution.

In:  expected charge below 64 electrons, a uniform per pixel.
Out: the count whose cumulative probability first exceeds the uniform.
Sources: Devroye 1986, "Non-Uniform Random Variate Generation", III.2.4 (guide tables); Taylor series of F in the mean.
"""

from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

LIMIT = 64  # electrons; the table covers means below
BINS = 16  # per electron of the mean: a power of two, so that the bin of a mean is exact
CELLS = 512  # of the uniform: a power of two as well
COUNTS = 152  # F(149; 64) is 1 in 64 bits; two columns before the first are 0, for differences
OPEN = 128  # flag of a cell in which the uniform alone does not determine the count
DARK = 0.1  # electrons, up to which nearly all counts are 0
SHORT = 2  # single steps before a bisection
NEAR = 1.7e-4  # more than the remainder of the series: (1/16)^3 / 6 x the largest third derivative, below 4


def quantiles(mean: NDArray, uniform: NDArray) -> NDArray:
    """Return the smallest count whose cumulative Poisson probability exceeds a uniform.

    Parameters
    ----------
    mean : (n,) array, electrons
        0 <= mean < 64.
    uniform : (n,) array of float64, dimensionless
        0 <= u < 1.

    Returns
    -------
    (n,) array, electrons, dtype of mean
        The smallest k with u < F(k; mean): bit for bit as found by stepping through scipy's `pdtr`.

    Notes
    -----
    For multiples u of 2^-53 the count k is drawn with probability F(k) - F(k - 1) = exp(-m) m^k / k!, within 2^-53 and
    the error of `pdtr` (1e-15): the Poisson law itself, not a mixture near it.

    Proof. F(k; m) decreases with m. Let m lie in the bin [a, b) and u in the cell [c, d). If F(k - 1; a) <= c and d <=
    F(k; b), then F(k - 1; m) <= u < F(k; m): k is the answer for the whole cell. Such cells hold k; both inequalities
    are required with a margin of 1e-12, a thousand times the rounding of the table. All other cells hold the smallest
    possible count and a flag. From there the count steps up while u >= F(k; m). F at m follows from its values at a: F'
    = -p_k, F'' = p_k - p_(k-1), and |F'''| < 4. Where u is closer to that sum than the remainder, `pdtr` decides.

    10 % of the uniforms fall into flagged cells: 6 % because the bins have a width, the rest because F has steps.
    """
    if not mean.size or mean.max() > DARK:
        return _looked_up(mean, uniform)
    counts = np.zeros_like(mean)
    some = np.flatnonzero(uniform >= (1 - 1e-15) - mean)  # F(0; m) = exp(-m) > 1 - m: all others are 0
    counts[some] = _looked_up(mean[some], uniform[some])
    return counts


def _looked_up(mean: NDArray, uniform: NDArray) -> NDArray:
    cells, cumulative = _table()
    bins = (mean * mean.dtype.type(BINS)).astype(np.intp)
    at = (uniform * CELLS).astype(np.intp)
    at += bins * CELLS
    found = cells.take(at)
    undecided = np.flatnonzero(found < 0)
    found &= OPEN - 1
    counts = found.astype(mean.dtype)
    if undecided.size:
        counts[undecided] = _stepped(
            found[undecided].astype(np.intp), mean[undecided], uniform[undecided], bins[undecided], cumulative
        )
    return counts


def _stepped(
    count: NDArray[np.intp], mean: NDArray, uniform: NDArray, bins: NDArray[np.intp], cumulative: NDArray
) -> NDArray[np.intp]:
    """Increase each count while its uniform is not below F(count; mean); no count is too large at the start."""
    beyond = mean.astype(np.float64)
    beyond -= bins / BINS
    at = bins * COUNTS
    at += count
    active, turn = np.arange(count.size), 0
    while active.size:
        f, before = cumulative.take(at + 2), cumulative.take(at + 1)
        p = f - before
        bend = p - (before - cumulative.take(at))
        f -= beyond * (p - 0.5 * beyond * bend)
        gap = uniform - f
        near = np.flatnonzero(np.abs(gap) < NEAR)
        if near.size:
            one = active[near]
            gap[near] = uniform[near] - scipy.special.pdtr(count[one], mean[one].astype(np.float64))
        larger = np.flatnonzero(gap >= 0)
        active, at, uniform, beyond = active[larger], at[larger] + 1, uniform[larger], beyond[larger]
        count[active] += 1
        turn += 1
        if turn == SHORT:  # what is left lies in the tails, where one cell holds many counts
            ahead = _ahead(at, uniform, cumulative)
            at += ahead
            count[active] += ahead
    return count


def _ahead(at: NDArray[np.intp], uniform: NDArray, cumulative: NDArray) -> NDArray[np.intp]:
    """Return how far each count is below the quantile at the lowest mean of its bin. No other mean in the bin has a
    smaller quantile.
    """
    ahead = np.zeros_like(at)
    room = COUNTS - 3 - at % COUNTS
    for stride in (64, 32, 16, 8, 4, 2, 1):
        trial = np.minimum(ahead + stride, room)
        np.copyto(ahead, trial, where=cumulative.take(at + 1 + trial) <= uniform - 1e-12)
    return ahead


@cache
def _table() -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Return two flattened tables: the cells, each a count, with the flag if it is the smallest of several possible
    counts; and F at the lower end of each bin, with two zeros before the first count.
    """
    means = np.arange(LIMIT * BINS + 1)[:, None] / BINS
    cumulative = np.zeros((len(means), COUNTS))
    probability = cumulative[:, 2:]
    probability[:, :1] = np.exp(-means)
    np.divide(means, np.arange(1, COUNTS - 2), out=probability[:, 1:])
    np.cumprod(probability, axis=1, out=probability)
    np.cumsum(probability, axis=1, out=probability)
    steps = probability * CELLS
    least = _at_or_below(np.ceil(steps[:-1] + 1e-9))
    most = _at_or_below(np.floor(steps[1:] - 1e-9))
    np.minimum(least, OPEN - 1, out=least)
    least |= np.where(least == most, 0, OPEN).astype(np.uint8)
    cells, table = least.view(np.int8).reshape(-1), cumulative.reshape(-1)
    cells.flags.writeable = table.flags.writeable = False
    return cells, table


def _at_or_below(edge: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return, for every bin and cell, how many of the bin's steps are at or below the lower end of the cell."""
    rows = len(edge)
    at = np.clip(edge, 0, CELLS).astype(np.intp)
    at += np.arange(rows)[:, None] * (CELLS + 1)
    number = np.bincount(at.reshape(-1), minlength=rows * (CELLS + 1)).astype(np.uint8).reshape(rows, CELLS + 1)
    return np.cumsum(number, axis=1, dtype=np.uint8)[:, :CELLS]
