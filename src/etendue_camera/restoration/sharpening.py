"""Sharpening with the paper's Laplacian or an unsharp mask, and its effect on frequencies and noise.

In:  planes (..., y, x) in any unit, strength or radius; or spatial frequency (cycles/pixel).
Out: sharpened planes; transfer function and noise gain, dimensionless.
Sources: the paper (docs/paper.md), eq. 11, whose taps sum to 0: the Laplacian L alone gives an edge image, and
sharpening is identity + k L. Unsharp masking subtracts a blurred copy.
"""

import math

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue import require

LAPLACIAN = np.array([[-1.0, -1.0, -1.0], [-1.0, 8.0, -1.0], [-1.0, -1.0, -1.0]])
LAPLACIAN.setflags(write=False)
BLOCK = 1 << 16  # pixels whose temporaries stay in the cache
REACH = 7.0  # standard deviations: as the radius grows, a new tap enters at e^-24.5 of the middle tap


def sharpen(planes: NDArray, strength: float) -> NDArray:
    """Add `strength` times the Laplacian to each plane; nothing is clipped.

    Parameters
    ----------
    planes : (..., y, x) array, any unit
        At least 1 x 1. Beyond the border the edge sample is repeated.
    strength : float, dimensionless
        k, finite, at or above 0. 1, as in the paper, multiplies white noise by 9.4; below 0.2 is usual.

    Returns
    -------
    (..., y, x) array, unit and dtype of planes (integers become float64)
        The sum of each plane is kept, and a constant plane is kept exactly; overshoot may leave the range.

    Raises
    ------
    ValueError
        If there are fewer than two axes, or strength is out of range.

    Notes
    -----
    Source: eq. 11. The box sum is 9 + 3 dx + 3 dy + dx dy with second differences dx, dy. In this form the Laplacian is
    separable, and exactly 0 for a constant.
    Error: below 4e-15 (1 + k) of the largest value in float64, against direct convolution.
    """
    planes = np.asarray(planes)
    require.shape(planes.ndim >= 2, "planes", planes, "(..., y, x)")
    strength = _strength(strength)
    if not np.issubdtype(planes.dtype, np.floating):
        planes = planes.astype(np.float64)
    result = np.empty_like(planes)
    rows, columns = planes.shape[-2:]
    some = max(BLOCK // max(columns, 1), 1)
    for index in np.ndindex(planes.shape[:-2]):
        for top in range(0, rows, some):  # some rows of a plane, and one above and below, stay in the cache
            low = max(top - 1, 0)
            part = planes[index][low : top + some + 1]
            own = slice(top - low, top - low + some)
            across = _second_difference(part, -1)
            weighted = 3 * part
            weighted += across
            box, across = _second_difference(weighted, -2)[own], across[own]
            across *= 3
            box += across
            box *= -strength
            np.add(box, part[own], out=result[index][top : top + some])
    return result


def laplacian_response(fy: ArrayLike, fx: ArrayLike) -> NDArray:
    """Return the transfer function of eq. 11.

    Parameters
    ----------
    fy, fx : (...) array, cycles/pixel

    Returns
    -------
    (...) array, dimensionless
        0 at zero, 12 at (0, 1/2) and (1/2, 0), 8 at (1/2, 1/2).

    Notes
    -----
    Source: 9 - (1 + 2 cos 2 pi fx)(1 + 2 cos 2 pi fy), written in sines as 12 (sy^2 + sx^2) - 16 sy^2 sx^2 to avoid
    cancellation near zero, where the response is 12 pi^2 f^2. Error: below 4e-16 relative (reference values
    laplacian_response).
    """
    sy, sx = np.sin(np.pi * np.asarray(fy)) ** 2, np.sin(np.pi * np.asarray(fx)) ** 2
    return 12 * (sy + sx) - 16 * sy * sx


def sharpen_response(fy: ArrayLike, fx: ArrayLike, strength: float) -> NDArray:
    """Return the transfer function of `sharpen` away from borders: 1 + k times `laplacian_response`.

    Parameters
    ----------
    fy, fx : (...) array, cycles/pixel
    strength : float, dimensionless
        Finite, at or above 0.

    Returns
    -------
    (...) array, dimensionless
        1 at zero, up to 1 + 12 k.

    Raises
    ------
    ValueError
        If strength is out of range.
    """
    return 1 + _strength(strength) * laplacian_response(fy, fx)


def noise_gain(strength: float) -> float:
    """Return the factor by which `sharpen` multiplies the standard deviation of white noise.

    Parameters
    ----------
    strength : float, dimensionless
        Finite, at or above 0.

    Returns
    -------
    float, dimensionless
        Square root of the sum of squared taps: centre 1 + 8 k and eight times k; sqrt(89) = 9.43 at k = 1.

    Raises
    ------
    ValueError
        If strength is out of range.
    """
    strength = _strength(strength)
    return math.hypot(1 + 8 * strength, math.sqrt(8) * strength)


def sharpen_mosaic(mosaic: NDArray, strength: float, period: tuple[int, int] = (2, 2)) -> NDArray:
    """Apply `sharpen` before demosaicing, within each of the planes that a colour filter array samples.

    Parameters
    ----------
    mosaic : (..., y, x) array, any unit
    strength : float, dimensionless
        As in `sharpen`.
    period : (rows, columns)
        Period of the array, which is the distance to the neighbours used, so that only samples behind the same filter
        are combined. (1, 1) applies the printed kernel across colours, which adds 8 k times their differences to every
        pixel.

    Returns
    -------
    (..., y, x) array, unit and dtype of mosaic (integers become float64)

    Raises
    ------
    ValueError
        If there are fewer than two axes, strength is out of range, or a period is below 1.

    Notes
    -----
    Source: section 2.8 of the paper ("right before interpolation"), which its abstract, section 4 and figures
    contradict. The response equals the response of `sharpen` at (rows fy, columns fx). For a 2 x 2 array it is largest
    at a quarter of the sampling frequency, and 1 at half the sampling frequency.
    """
    mosaic = np.asarray(mosaic)
    require.shape(mosaic.ndim >= 2, "mosaic", mosaic, "(..., y, x)")
    rows, columns = period
    require.allowed(rows >= 1 and columns >= 1, "period", period, "whole numbers from 1")
    result = np.empty_like(mosaic, dtype=mosaic.dtype if np.issubdtype(mosaic.dtype, np.floating) else np.float64)
    for row in range(min(rows, mosaic.shape[-2])):
        for column in range(min(columns, mosaic.shape[-1])):
            place = np.s_[..., row::rows, column::columns]
            result[place] = sharpen(mosaic[place], strength)
    return result


def unsharp(planes: NDArray, radius: float, amount: float, threshold: float = 0.0) -> NDArray:
    """Add `amount` times the difference from a blurred copy; nothing is clipped.

    Parameters
    ----------
    planes : (..., y, x) array, any unit
        At least 1 x 1; mirrored beyond the border.
    radius : float, pixel
        Standard deviation of the Gaussian, above 0.
    amount : float, dimensionless
        Finite, at or above 0.
    threshold : float, unit of planes
        Differences are first reduced in magnitude by the threshold, or to 0 if they are smaller, so that noise in flat
        areas is not amplified.

    Returns
    -------
    (..., y, x) array, unit and dtype of planes (integers become float64)
        Without a threshold, the sum of each plane is kept.

    Raises
    ------
    ValueError
        If there are fewer than two axes, or an argument is out of range.

    Notes
    -----
    The taps come from `gaussian_taps`. Reducing differences by the threshold is continuous; setting only small
    differences to 0 would create steps. Error: below 2e-15 (1 + amount) of the largest value in float64 against direct
    convolution.
    """
    planes = np.asarray(planes)
    require.shape(planes.ndim >= 2, "planes", planes, "(..., y, x)")
    amount, threshold = require.amount("amount", amount), require.amount("threshold", threshold)
    taps = gaussian_taps(radius)
    if not np.issubdtype(planes.dtype, np.floating):
        planes = planes.astype(np.float64)
    blurred = scipy.ndimage.correlate1d(planes, taps, axis=-2, mode="reflect")
    blurred = scipy.ndimage.correlate1d(blurred, taps, axis=-1, mode="reflect")
    detail = planes - blurred
    if threshold:
        detail = np.copysign(np.maximum(np.abs(detail) - planes.dtype.type(threshold), planes.dtype.type(0)), detail)
    detail *= planes.dtype.type(amount)
    detail += planes
    return detail


def gaussian_taps(radius: float) -> NDArray:
    """Return the weights of a sampled Gaussian out to seven standard deviations, normalised to sum 1.

    Parameters
    ----------
    radius : float, pixel
        Standard deviation, above 0, at most 1000.

    Returns
    -------
    (2 n + 1,) array, dimensionless

    Raises
    ------
    ValueError
        If radius is out of range.
    """
    radius = float(radius)
    require.allowed(0 < radius <= 1000, "radius", radius, "numbers above 0 and at most 1000 pixel")
    reach = max(math.ceil(REACH * radius), 1)
    with np.errstate(over="ignore"):  # for a radius near 0
        taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / radius) ** 2)
    return taps / taps.sum()


def unsharp_response(fy: ArrayLike, fx: ArrayLike, radius: float, amount: float) -> NDArray:
    """Return the transfer function of `unsharp` without a threshold, away from borders.

    Parameters
    ----------
    fy, fx : (...) array, cycles/pixel
    radius, amount : float
        As in `unsharp`.

    Returns
    -------
    (...) array, dimensionless
        1 + amount (1 - G(fy) G(fx)), with the cosine sum G of the sampled Gaussian; 1 at zero, below 1 + 2.2 amount.

    Raises
    ------
    ValueError
        If radius or amount is out of range.
    """
    amount, taps = require.amount("amount", amount), gaussian_taps(radius)
    side = taps[taps.size // 2 + 1 :]
    steps = np.arange(1, side.size + 1)

    def lost(f: ArrayLike) -> NDArray:
        """Return 1 - G, in sines to avoid cancellation near zero."""
        return 4 * (np.sin(np.pi * np.asarray(f, dtype=float)[..., None] * steps) ** 2) @ side

    over_y, over_x = lost(fy), lost(fx)
    return 1 + amount * (over_y + over_x - over_y * over_x)


def unsharp_noise_gain(radius: float, amount: float) -> float:
    """Return the factor by which `unsharp` without a threshold multiplies the standard deviation of white noise.

    Parameters
    ----------
    radius, amount : float
        As in `unsharp`.

    Returns
    -------
    float, dimensionless
        sqrt((1 + a)^2 - 2 a (1 + a) g0^2 + a^2 s^2), with the middle tap g0 and the sum s of squared taps on an axis.

    Raises
    ------
    ValueError
        If radius or amount is out of range.
    """
    amount, taps = require.amount("amount", amount), gaussian_taps(radius)
    middle, square = float(taps[taps.size // 2]), float(taps @ taps)
    # sum of squared taps, rearranged to avoid cancellation: (1 + a - a g0^2)^2 + a^2 (s^2 - g0^4)
    return math.hypot(1 + amount * (1 - middle**2), amount * math.sqrt(max(square**2 - middle**4, 0.0)))


def _second_difference(values: NDArray, axis: int) -> NDArray:
    """Return neighbour - 2 value + neighbour of a plane along y (-2) or x (-1), with the edge sample repeated; 0 along
    an axis of length 1, and exactly 0 for a constant.
    """
    result = np.empty_like(values)
    if values.shape[axis] < 2:
        result[...] = 0
        return result
    value, view = (values.T, result.T) if axis == -1 else (values, result)
    np.add(value[:-2], value[2:], out=view[1:-1])
    np.add(value[0], value[1], out=view[0])
    np.add(value[-2], value[-1], out=view[-1])
    result -= values
    result -= values
    return result


def _strength(strength: float) -> float:
    return require.amount("strength", strength)
