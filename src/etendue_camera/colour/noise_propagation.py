"""Noise propagation: how a chain of linear steps transforms noise that is independent from pixel to pixel.

In:  the chain's response to one pixel at each site of the mosaic's unit cell, and the variance there; or planes of
     noise.
Out: covariance between channels at one pixel and between neighbours.
Sources: linear propagation of covariance, C = sum over pixels of v h h^T.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require

FloatArray = NDArray[np.float64]


def carried_covariance(responses: ArrayLike, variance: ArrayLike, lag: tuple[int, int] = (0, 0)) -> FloatArray:
    """Return the covariance of the output's channels at two pixels, averaged over the sites of the mosaic's unit cell.

    Parameters
    ----------
    responses : (place, channel, y, x) array
        The output's response to a unit change of one pixel, for each site of the cell, in a window that contains the
        whole response.
    variance : (place,) array
        Variance of the independent noise at these sites, at or above 0.
    lag : two ints, pixels
        From the first pixel to the second, along y and x; smaller than the window.

    Returns
    -------
    (channel, channel) array, unit of variance x response^2
        Entry (i, j): channel i at a pixel, channel j at that pixel plus the lag.

    Raises
    ------
    ValueError
        If the shapes do not fit or a variance is negative.

    Notes
    -----
    Each site occurs once per cell, so the mean over output pixels is the sum over the response divided by the number
    of sites. Exact for a linear chain that repeats with the cell; error: rounding of the sum.
    """
    h, v = np.asarray(responses, np.float64), np.asarray(variance, np.float64)
    require.that(
        h.ndim == 4 and v.shape == h.shape[:1],
        f"responses has shape {h.shape} and variance {v.shape}; allowed: (place, channel, y, x) and (place,)",
    )
    require.allowed(np.all(v >= 0), "variance", v.tolist(), "numbers at or above 0")
    first, second = h[_shifted(lag, 1, h.shape)], h[_shifted(lag, -1, h.shape)]
    return np.asarray(np.einsum("p,pcyx,pdyx->cd", v, first, second) / len(h))


def slow_covariance(responses: ArrayLike, variance: ArrayLike) -> FloatArray:
    """Return the noise power at zero frequency, (channel, channel): the covariance of the sum over a large window, per
    pixel.

    Subtracting a smooth trend from noise (see `without_trend`) removes this power once per term of the trend. For white
    noise it equals the variance; for noise that is correlated between neighbours it is several times the variance.
    """
    h, v = np.asarray(responses, np.float64).sum(axis=(-2, -1)), np.asarray(variance, np.float64)
    return np.asarray(np.einsum("p,pc,pd->cd", v, h, h) / len(h))


def terms(degree: int) -> int:
    """Return the number of terms of a polynomial of two variables."""
    return (degree + 1) * (degree + 2) // 2


def _shifted(lag: tuple[int, int], sign: int, shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Return slices with the positions of the first (sign 1) or second (sign -1) of two pixels a lag apart, where both
    are inside the window.
    """
    parts = [slice(None), slice(None)]
    for step, size in zip(lag, shape[-2:], strict=True):
        require.allowed(abs(step) < size, "lag", lag, f"steps smaller than the window, {shape[-2]} x {shape[-1]}")
        step *= sign
        parts.append(slice(max(0, -step), size - max(0, step)))
    return tuple(parts)


def found_covariance(noise: ArrayLike, lag: tuple[int, int] = (0, 0)) -> FloatArray:
    """Measure, in planes of noise whose mean is 0, the covariance that `carried_covariance` predicts.

    Parameters
    ----------
    noise : (channel, y, x) or (frame, channel, y, x) array
        See `without_trend`.
    lag : two ints, pixels

    Returns
    -------
    (channel, channel) array, unit of noise squared
    """
    noise = np.asarray(noise, np.float64)
    require.that(
        noise.ndim in (3, 4), f"noise has shape {noise.shape}; allowed: (channel, y, x) and (frame, channel, y, x)"
    )
    planes = noise if noise.ndim == 4 else noise[None]
    first, second = planes[_shifted(lag, 1, planes.shape)], planes[_shifted(lag, -1, planes.shape)]
    return np.asarray(np.einsum("fcyx,fdyx->cd", first, second) / (first.size / first.shape[1]))


def correlation(covariance: ArrayLike, variances: ArrayLike) -> FloatArray:
    """Return covariance over the geometric mean of the variances, (channel, channel); NaN for noise-free channels."""
    spread = np.sqrt(np.asarray(variances, np.float64))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.asarray(covariance, np.float64) / np.outer(spread, spread))


def without_trend(planes: ArrayLike, degree: int = 2) -> FloatArray:
    """Return planes minus their least-squares polynomial of this total degree in y and x.

    Parameters
    ----------
    planes : (..., y, x) array
    degree : int
        At or above 0; 2 removes the fall-off of a lens within a window.

    Returns
    -------
    (..., y, x) array
        The noise. Its variance is reduced by terms/pixels times its power at zero frequency, see `slow_covariance`.
    """
    planes = np.asarray(planes, np.float64)
    rows, columns = planes.shape[-2:]
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    powers = [y**i * x**j for i in range(degree + 1) for j in range(degree + 1 - i)]
    basis, _ = np.linalg.qr(np.stack([power.ravel() for power in powers], axis=1))
    flat = planes.reshape(*planes.shape[:-2], -1)
    return np.asarray((flat - (flat @ basis) @ basis.T).reshape(planes.shape))


def standard_error_of_variance(noise: ArrayLike, block: int = 16) -> FloatArray:
    """Return the standard error of each channel's variance, (channel,), from the scatter between blocks.

    The blocks must be larger than the correlation length of the noise. ``noise`` is (frame, channel, y, x); the result
    is NaN for fewer than four blocks.
    """
    noise = np.asarray(noise, np.float64)
    rows, columns = noise.shape[-2] // block, noise.shape[-1] // block
    count = noise.shape[0] * rows * columns
    if count < 4:
        return np.full(noise.shape[1], np.nan)
    cut = noise[..., : rows * block, : columns * block].reshape(
        noise.shape[0], noise.shape[1], rows, block, columns, block
    )
    means = np.mean(cut**2, axis=(3, 5))
    return np.asarray(means.std(axis=(0, 2, 3), ddof=1) / np.sqrt(count))
