"""Exact distributions of counts and codes, the reference for samplers and converters.

In:  counts and means (electrons); mean and noise of a signal before an ADC (LSB).
Out: probabilities, total variation, moments.
Sources: Loader 2000, "Fast and accurate computation of binomial probabilities"; Fourier series of the
rounding error.
"""

import math

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue_camera.electronics.noise import SMALLEST_NORMAL_MEAN

_FACTORIAL_ERROR = np.array(
    [math.inf]
    + [math.log(math.factorial(n)) - (n + 0.5) * math.log(n) + n - 0.5 * math.log(math.tau) for n in range(1, 16)]
)


def poisson_logpmf(count: ArrayLike, mean: ArrayLike) -> NDArray:
    """Return the logarithm of the Poisson probability of a count.

    Parameters
    ----------
    count : (...) array, electrons
        Whole numbers at or above 0.
    mean : (...) array, electrons
        At or above 0, finite.

    Returns
    -------
    (...) array of float64
        -inf for any count but 0 at mean 0.

    Raises
    ------
    ValueError
        If a count is negative or not whole, or a mean is not allowed.

    Notes
    -----
    Source: Loader's saddle point form. The textbook form k log m - m - lgamma(k + 1) loses digits: 4.7e-7 of -11.28 at
    k = m = 1e9. Relative error: below 2e-16 times the condition number (reference values
    `poisson_logpmf`).
    """
    count, mean = np.broadcast_arrays(np.asarray(count, np.float64), np.asarray(mean, np.float64))
    if not np.all((count >= 0) & (count == np.floor(count)) & (count < np.inf)):
        raise ValueError(f"count ranges from {count.min()} to {count.max()}; it must be integers at or above 0")
    if not np.all((mean >= 0) & (mean < np.inf)):
        raise ValueError(f"mean ranges from {mean.min()} to {mean.max()}; it must be finite and at or above 0")
    some = np.maximum(count, 1)
    with np.errstate(divide="ignore"):
        saddle = -_stirling_error(some) - _deviance(some, mean) - 0.5 * np.log(math.tau * some)
    return np.where(count == 0, -mean, saddle)[()]


def poisson_pmf(count: ArrayLike, mean: ArrayLike) -> NDArray:
    """Return the Poisson probability of a count; arguments, errors and source as for `poisson_logpmf`.

    Returns
    -------
    (...) array of float64, dimensionless

    Notes
    -----
    Relative error: below 2e-16 times the condition number (reference values `poisson_pmf`).
    """
    return np.exp(poisson_logpmf(count, mean))


def poisson_total_variation(mean: float, exact_below: float = 30.0) -> float:
    """Return the largest error that `noise.poisson` makes in the probability of any event, at one mean.

    Parameters
    ----------
    mean : float, electrons
        At or above 0.
    exact_below : float, electrons
        As in `noise.poisson`: 10 or more.

    Returns
    -------
    float, dimensionless
        Half the sum of |p(k) - q(k)|. 0 where the draw is exact.

    Raises
    ------
    ValueError
        If an argument is not allowed.

    Notes
    -----
    q(k) is taken from the normal CDF at the roots of the cubic of `noise.cornish_fisher`, p(k) from `poisson_pmf`, over
    mean +- 12 sigma (less than 1e-30 outside). The result decreases as mean^-1.5. For means above 1e5 the value at 1e5,
    5.1e-10, is returned as a bound, since the sum can no longer resolve it. Draws in float32 add rounding: of the
    normal (6e-8) and of counts above 1.7e7.
    """
    require.that(0 <= mean < math.inf, f"mean is {mean!r} electrons; it must be finite and at or above 0")
    require.that(
        exact_below >= SMALLEST_NORMAL_MEAN,
        f"exact_below is {exact_below!r} electrons; it must be {SMALLEST_NORMAL_MEAN} or more, or inf",
    )
    if mean < exact_below:
        return 0.0
    counts, drawn = normal_form_pmf(min(float(mean), 1e5))
    return 0.5 * float(np.abs(drawn - poisson_pmf(counts, min(float(mean), 1e5))).sum())


def normal_form_pmf(mean: float) -> tuple[NDArray, NDArray]:
    """Return the distribution of `noise.cornish_fisher` for a standard normal: counts and their probabilities.

    Parameters
    ----------
    mean : float, electrons
        10 to 1e6.

    Returns
    -------
    counts : (n,) array, electrons
        Whole numbers within 12 sigma of the mean.
    probability : (n,) array, dimensionless

    Raises
    ------
    ValueError
        If the mean is outside the range given above.

    Notes
    -----
    Probabilities are differences of the normal CDF at the roots of the cubic. Error: 1e-15 absolute.
    """
    require.that(
        SMALLEST_NORMAL_MEAN <= mean <= 1e6, f"mean is {mean!r} electrons; it must be {SMALLEST_NORMAL_MEAN} to 1e6"
    )
    width = 12 * math.sqrt(mean) + 30
    counts = np.arange(max(math.floor(mean - width), 0), math.ceil(mean + width))
    upper = _cubic_root(mean, counts[1:].astype(np.float64))
    # the narrower tail keeps its digits; a difference of values near 1 would not
    low, high = scipy.special.ndtr(upper), scipy.special.ndtr(-upper)
    below = np.concatenate([[0.0], low, [1.0]])
    above = np.concatenate([[1.0], high, [0.0]])
    return counts, np.where(below[1:] < 0.5, np.diff(below), -np.diff(above))


def quantised_gauss_moments(mu: ArrayLike, sigma: ArrayLike) -> tuple[NDArray, NDArray]:
    """Return mean error and variance of a Gaussian signal after rounding to integer codes.

    Parameters
    ----------
    mu : (...) array, LSB
        Mean before rounding, finite.
    sigma : (...) array, LSB
        Standard deviation before rounding, finite, at or above 0.

    Returns
    -------
    mean_error : (...) array of float64, LSB
        E[floor(x + 1/2)] - mu; exactly 0 where mu is a whole or half number (sigma > 0).
    variance : (...) array of float64, LSB^2
        sigma^2 + 1/12 only for sigma above 0.5 or so: at mu = 0, sigma = 0.2 it is 0.0124, not 0.123.

    Raises
    ------
    ValueError
        If mu is not finite, or sigma not finite or negative.

    Notes
    -----
    Source: sums of normal tails for sigma < 0.35, else the Fourier series of the rounding error, whose terms fall as
    exp(-2 pi^2 k^2 sigma^2). Error, reference values quantised_gauss: mean error below 2e-15 relative, variance below
    3e-16 x max(1, 1/(4 sigma^2)).
    """
    mu, sigma = np.broadcast_arrays(np.asarray(mu, np.float64), np.asarray(sigma, np.float64))
    if not np.isfinite(mu).all():
        raise ValueError(f"mu ranges from {mu.min()} to {mu.max()} LSB; it must be finite")
    if not np.all((sigma >= 0) & (sigma < np.inf)):
        raise ValueError(f"sigma ranges from {sigma.min()} to {sigma.max()} LSB; it must be finite and at or above 0")
    offset = mu - np.floor(mu + 0.5)  # -1/2 to below 1/2
    narrow, wide = np.minimum(sigma, 0.35), np.maximum(sigma, 0.35)
    direct, series = _by_tails(offset, narrow), _by_series(offset, wide)
    small = sigma < 0.35
    return np.where(small, direct[0], series[0])[()], np.where(small, direct[1], series[1])[()]


def cut_normal_moments(rms: float) -> tuple[float, float]:
    """Return mean and variance of the non-negative gain factors of pixels, max(0, 1 + rms Z) with Z standard normal.

    Parameters
    ----------
    rms : float, dimensionless
        At least 0.

    Returns
    -------
    mean, variance : float, dimensionless
        1 and rms^2 where nothing is clipped.

    Raises
    ------
    ValueError
        If rms is negative or not finite.

    Notes
    -----
    Source: integrals of z^k over the part of the normal density above -1/rms. Below rms = 0.1 less than 1e-23 is
    clipped, so the unclipped moments are returned. Error: 3e-14 relative against quadrature for rms in 0.1 to 1.
    """
    require.amount("rms", rms)
    if rms < 0.1:
        return 1.0, rms**2
    above, density = 0.5 * math.erfc(-1 / (rms * math.sqrt(2))), math.exp(-0.5 / rms**2) / math.sqrt(2 * math.pi)
    mean = above + rms * density
    return mean, (1 + rms**2) * above + rms * density - mean**2


def _by_tails(offset: NDArray, sigma: NDArray) -> tuple[NDArray, NDArray]:
    """Return mean error and variance by a sum over the thresholds, with each normal tail taken on the side of the mean
    where it is small.
    """

    def beyond(distance: NDArray) -> NDArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return 0.5 * scipy.special.erfc(distance / (sigma * math.sqrt(2)))

    steps = np.arange(1, 9).reshape(-1, *[1] * offset.ndim)
    above, below = beyond(steps - 0.5 - offset), beyond(steps - 0.5 + offset)
    # sigma = 0 on a threshold is 0/0: the code there is the upper one, from which `offset` is counted
    above, below = (np.nan_to_num(tail, nan=0.0) for tail in (above, below))
    first = (above - below).sum(axis=0)
    second = ((2 * steps - 1) * (above + below)).sum(axis=0)
    # near a threshold, counting from it instead of from the code cancels exactly where it should
    side = np.where(offset < 0, -1.0, 1.0)
    near = offset - 0.5 * side
    with np.errstate(divide="ignore", invalid="ignore"):
        centre = 0.5 * scipy.special.erf(near / (sigma * math.sqrt(2)))
    about = centre - near + (beyond(steps - near) - beyond(steps + near)).sum(axis=0)
    error = np.where((np.abs(offset) > 0.25) & (sigma > 0), about, first - offset)
    return error, second - first**2


def _by_series(offset: NDArray, sigma: NDArray) -> tuple[NDArray, NDArray]:
    k = np.arange(1, 6).reshape(-1, *[1] * offset.ndim)
    sign = np.where(k % 2, -1.0, 1.0)
    with np.errstate(under="ignore"):
        damping = np.exp(-2 * (np.pi * k * sigma) ** 2)
    # sin(2 pi k x) from the nearer of its zeros at x = 0 and x = +-1/2, so that it is 0 there and not 1e-16
    from_half = np.sin(2 * np.pi * k * (0.5 - np.abs(offset)))
    sine = np.where(np.abs(offset) <= 0.25, sign * np.sin(2 * np.pi * k * offset), -np.copysign(1, offset) * from_half)
    error = (sine * damping / (np.pi * k)).sum(axis=0)
    cosine = sign * np.cos(2 * np.pi * k * offset)
    variance = sigma**2 + 1 / 12 + (cosine * damping * (1 / (np.pi * k) ** 2 + 4 * sigma**2)).sum(axis=0) - error**2
    return error, variance


def _stirling_error(count: NDArray) -> NDArray:
    """Return log(k!) minus Stirling's formula, for k >= 1."""
    inverse = 1 / np.maximum(count, 16) ** 2
    series = 1 / 1188 - inverse * (691 / 360360 - inverse / 156)
    series = 1 / 12 - inverse * (1 / 360 - inverse * (1 / 1260 - inverse * (1 / 1680 - inverse * series)))
    return np.where(count < 16, _FACTORIAL_ERROR[np.minimum(count, 15).astype(int)], series / np.maximum(count, 16))


def _deviance(count: NDArray, mean: NDArray) -> NDArray:
    """Return k log(k/m) + m - k, from a series where these terms cancel."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        ratio = (count - mean) / (count + mean)
        direct = count * np.log(count / mean) + mean - count
    square = np.where(np.abs(ratio) < 0.1, ratio, 0) ** 2
    series = np.zeros_like(square)
    for j in range(9, 0, -1):
        series = square * (1 / (2 * j + 1) + series)
    return np.where(np.abs(ratio) < 0.1, (count - mean) * ratio + 2 * count * ratio * series, direct)


def _cubic_root(mean: float, target: NDArray) -> NDArray:
    """Return the z at which the unrounded `noise.cornish_fisher` reaches a target, by Newton's method."""
    root = math.sqrt(mean)
    thin = 1 / (72 * root)
    z = 2 * (np.sqrt(np.maximum(target, 0.25)) - root)  # square-root transform: within 0.4 everywhere
    for _ in range(12):
        value = mean + 1 / 3 + z * (z * (1 / 6 - z * thin) + (root - 2 * thin))
        slope = root - 2 * thin + z * (1 / 3 - 3 * z * thin)
        z = np.clip(z - (value - target) / np.maximum(slope, 0.05 * root), -14, 14)
    return z
