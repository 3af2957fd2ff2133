"""Sharpening with the Laplacian of the seed paper, and what it does to frequencies and noise.

In:  planes (..., y, x) in any unit, strength; or spatial frequency (cycles/pixel).
Out: sharpened planes; transfer function and noise gain, dimensionless.
Sources: seed paper eq. 11. Its taps sum to 0: alone it makes an edge image, and sharpening is identity + k L.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

LAPLACIAN = np.array([[-1.0, -1.0, -1.0], [-1.0, 8.0, -1.0], [-1.0, -1.0, -1.0]])
LAPLACIAN.setflags(write=False)


def sharpen(planes: NDArray, strength: float) -> NDArray:
    """Add `strength` times the Laplacian to each plane; nothing is clipped.

    Parameters
    ----------
    planes : (..., y, x) array, any unit
        Any size from 1 x 1 on. Beyond the border the edge sample is repeated.
    strength : float, dimensionless
        k, finite, at or above 0. 1 is the seed paper's and multiplies white noise by 9.4; below 0.2 is usual.

    Returns
    -------
    (..., y, x) array, unit and dtype of planes (integers become float64)
        The sum of each plane is kept; a constant plane is kept exactly; overshoot leaves the range.

    Raises
    ------
    ValueError
        If there are less than two axes, or strength is not allowed.

    Notes
    -----
    Source: eq. 11. The box sum is 9 + 3 dx + 3 dy + dx dy with second differences dx, dy; written so, it is
    separable, and a constant rounds to exactly nothing.
    Error: below 4e-15 (1 + k) of the largest value in float64, against direct convolution.
    """
    planes = np.asarray(planes)
    if planes.ndim < 2:
        raise ValueError(f"planes has shape {planes.shape}; allowed is (..., y, x)")
    strength = _strength(strength)
    if not np.issubdtype(planes.dtype, np.floating):
        planes = planes.astype(np.float64)
    across = _second_difference(planes, -1)
    box = _second_difference(3 * planes + across, -2)
    across *= 3
    box += across
    box *= strength
    return planes - box


def laplacian_response(fy: ArrayLike, fx: ArrayLike) -> NDArray:
    """Transfer function of eq. 11.

    Parameters
    ----------
    fy, fx : (...) array, cycles/pixel

    Returns
    -------
    (...) array, dimensionless
        0 at zero, 12 at (0, 1/2) and (1/2, 0), 8 at (1/2, 1/2).

    Notes
    -----
    Source: 9 - (1 + 2 cos 2 pi fx)(1 + 2 cos 2 pi fy) in sines, 12 (sy^2 + sx^2) - 16 sy^2 sx^2: no
    cancellation near zero, where the response is 12 pi^2 f^2. Error: below 4e-16 relative (reference group
    laplacian_response).
    """
    sy, sx = np.sin(np.pi * np.asarray(fy)) ** 2, np.sin(np.pi * np.asarray(fx)) ** 2
    return 12 * (sy + sx) - 16 * sy * sx


def sharpen_response(fy: ArrayLike, fx: ArrayLike, strength: float) -> NDArray:
    """Transfer function of `sharpen` away from borders: 1 + k times `laplacian_response`.

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
        If strength is not allowed.
    """
    return 1 + _strength(strength) * laplacian_response(fy, fx)


def noise_gain(strength: float) -> float:
    """Factor by which `sharpen` multiplies the standard deviation of white noise.

    Parameters
    ----------
    strength : float, dimensionless
        Finite, at or above 0.

    Returns
    -------
    float, dimensionless
        sqrt of the sum of squared taps: centre 1 + 8 k and eight times k; sqrt(89) = 9.43 at k = 1.

    Raises
    ------
    ValueError
        If strength is not allowed.
    """
    strength = _strength(strength)
    return math.hypot(1 + 8 * strength, math.sqrt(8) * strength)


def _second_difference(values: NDArray, axis: int) -> NDArray:
    """Neighbour - 2 value + neighbour, the edge sample repeated; 0 along an axis of length 1."""
    steps = np.moveaxis(np.diff(values, axis=axis), axis, -1)
    result = np.zeros_like(values)
    view = np.moveaxis(result, axis, -1)
    view[..., :-1] += steps
    view[..., 1:] -= steps
    return result


def _strength(strength: float) -> float:
    strength = float(strength)
    if not 0 <= strength < math.inf:
        raise ValueError(f"strength is {strength!r}; allowed are finite numbers at or above 0")
    return strength
