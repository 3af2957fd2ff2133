"""Encodings: how linear light becomes the numbers of a display file, and back.

In:  linear or encoded values, 1 = display white; any shape.
Out: the other kind, same shape and dtype (float32 stays float32; integers become float64).
Sources: IEC 61966-2-1 (sRGB), ITU-R BT.709, seed paper eq. 15.

numpy's `power` is 4 times slower on a picture with 20 % exact zeros, as clipping leaves them: each base is
lifted above 0 first, to the end of the linear toe or to the smallest number.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require


def srgb_encode(linear: ArrayLike) -> NDArray:
    """Linear light to sRGB values; negative light is the mirror image, infinite slope nowhere.

    Parameters
    ----------
    linear : (...) array, dimensionless
        Any sign and size; 1 is white.

    Returns
    -------
    (...) array, dimensionless

    Notes
    -----
    Source: IEC 61966-2-1 with its printed break 0.0031308, where the two branches differ by 3e-8.
    Error: below 6e-16 relative in float64 (reference group srgb_encode), 3e-7 in float32 (|v| <= 10).

    Examples
    --------
    >>> from etendue_camera.colour.encoding import srgb_encode
    >>> srgb_encode([0.0, 0.18, 1.0]).round(3).tolist()
    [0.0, 0.461, 1.0]
    """
    value = require.floating(linear)
    size = value if _no_negative(value) else np.abs(value)
    curve = _at_least(size, 0.0031308)
    np.power(curve, 1 / 2.4, out=curve)
    curve *= 1.055
    curve -= 0.055
    _with_toe(curve, size, 0.0031308, 12.92)
    return curve if size is value else np.copysign(curve, value, out=curve)


def srgb_decode(encoded: ArrayLike) -> NDArray:
    """sRGB values to linear light, the inverse of `srgb_encode`.

    Parameters
    ----------
    encoded : (...) array, dimensionless

    Returns
    -------
    (...) array, dimensionless

    Notes
    -----
    Source: IEC 61966-2-1 with its printed break 0.04045. Within 3e-8 of the break it is the inverse only to
    2e-9. Error: below 3e-16 x condition in float64 (reference group srgb_decode), 5e-7 in float32 (|v| <= 4).
    """
    value = require.floating(encoded)
    size = value if _no_negative(value) else np.abs(value)
    curve = _at_least(size, 0.04045)
    curve += 0.055
    curve /= 1.055
    np.power(curve, 2.4, out=curve)
    _with_toe(curve, size, 0.04045, 12.92, divide=True)
    return curve if size is value else np.copysign(curve, value, out=curve)


def bt709_encode(linear: ArrayLike) -> NDArray:
    """Linear light to BT.709 camera values; negative light stays on the linear toe.

    Parameters
    ----------
    linear : (...) array, dimensionless

    Returns
    -------
    (...) array, dimensionless

    Notes
    -----
    Source: ITU-R BT.709, 4.5 v below 0.018, else 1.099 v^0.45 - 0.099. The three-digit constants leave a step
    of 2.5e-4 at 0.018. Error: below 2e-16 relative in float64 (reference group bt709_encode), 4e-7 in float32
    (v <= 10).
    """
    value = require.floating(linear)
    curve = _at_least(value, 0.018)
    np.power(curve, 0.45, out=curve)
    curve *= 1.099
    curve -= 0.099
    # the float nearest to 0.018 lies below it: '<=' between floats is '<' between numbers
    return _with_toe(curve, value, 0.018, 4.5)


def bt709_decode(encoded: ArrayLike) -> NDArray:
    """BT.709 camera values to linear light, the inverse of `bt709_encode`.

    Parameters
    ----------
    encoded : (...) array, dimensionless

    Returns
    -------
    (...) array, dimensionless
        Values inside the step of `bt709_encode`, 0.081 to 0.08125, which no light has, give 0.01795 to 0.018.

    Notes
    -----
    Source: ITU-R BT.709 solved for light, v / 4.5 up to 0.081.
    """
    value = require.floating(encoded)
    curve = _at_least(value, 0.081)
    curve += 0.099
    curve /= 1.099
    np.power(curve, 1 / 0.45, out=curve)
    return _with_toe(curve, value, 0.081, 4.5, divide=True)


def gamma_signed(value: ArrayLike, gamma: float) -> NDArray:
    """Pure power of the size with the sign kept; the seed paper's encoding is gamma = 0.45.

    Parameters
    ----------
    value : (...) array, dimensionless
    gamma : float
        Finite, above 0. Below 1 the slope at 0 is infinite: 1e-12 becomes 4e-6, and dark noise grows with it.

    Returns
    -------
    (...) array, dimensionless
        Zeros stay zeros.

    Raises
    ------
    ValueError
        If gamma is not allowed.

    Notes
    -----
    Source: seed paper eq. 15, sign(v) |v|^gamma. Error: below 2e-17 x condition in float64 (reference group
    gamma_signed); 8e-7 relative in float32 (gamma up to 2.2, 1e-6 <= |v| <= 10).
    """
    gamma = float(gamma)
    require.allowed(0 < gamma < np.inf, "gamma", gamma, "finite numbers above 0")
    value = require.floating(value)
    # the smallest number stands in for 0, which is put back
    plain = _no_negative(value)
    size = _at_least(value if plain else np.abs(value), np.finfo(value.dtype).smallest_subnormal)
    np.power(size, gamma, out=size)
    if plain:
        size *= value != 0  # by mask it would take as long as the power
    else:
        size *= np.sign(value)
    return size


def _no_negative(value: NDArray) -> bool:
    """False also where there is a NaN, and for no values at all."""
    return bool(value.size and value.min() >= 0)


def _with_toe(curve: NDArray, value: NDArray, end: float, slope: float, divide: bool = False) -> NDArray:
    """A straight line up to ``end`` in place of the curve, in place: by products with the mask, a third of the time
    of a choice.
    """
    toe = value <= end
    line = np.minimum(value, end, out=np.empty_like(curve))
    (np.divide if divide else np.multiply)(line, slope, out=line)
    line *= toe
    curve *= ~toe
    curve += line
    return curve


def _at_least(values: NDArray, floor: float) -> NDArray:
    """Lifted to the floor; `clip` takes half the time of `maximum`."""
    kind = values.dtype.type
    lifted = np.empty_like(values)
    np.clip(values, kind(floor), kind(np.inf), out=lifted)
    return lifted
