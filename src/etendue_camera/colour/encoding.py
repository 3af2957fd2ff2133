"""Encodings: linear light to the values of a display file, and back.

In:  linear or encoded values, 1 = display white; any shape.
Out: encoded or linear values, same shape and dtype (float32 stays float32; integers become float64).
Sources: IEC 61966-2-1 (sRGB), ITU-R BT.709, the paper (docs/paper.md), eq. 15.

The function `power` of numpy is 4 times slower if 20 % of a picture is exactly 0, as after clipping. Values are
therefore first raised above 0: to the end of the linear segment, or to the smallest number.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require


def srgb_encode(linear: ArrayLike) -> NDArray:
    """Encode linear light as sRGB; negative light is encoded as the mirror image of positive light.

    Parameters
    ----------
    linear : (...) array, dimensionless
        Any sign and size; 1 is white.

    Returns
    -------
    (...) array, dimensionless

    Notes
    -----
    Source: IEC 61966-2-1 with its printed break 0.0031308, where the two branches differ by 3e-8. The slope is finite.
    Error: below 6e-16 relative in float64 (reference values srgb_encode), 3e-7 in float32 (|v| <= 10).

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
    """Decode sRGB values to linear light, the inverse of `srgb_encode`.

    Parameters
    ----------
    encoded : (...) array, dimensionless

    Returns
    -------
    (...) array, dimensionless

    Notes
    -----
    Source: IEC 61966-2-1 with its printed break 0.04045. Within 3e-8 of the break it inverts the encoding only to 2e-9.
    Relative error: below 3e-16 times the condition number in float64 (reference values `srgb_decode`), 5e-7 in float32
    (|v| <= 4).
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
    """Encode linear light as BT.709 camera values; negative light follows the linear segment.

    Parameters
    ----------
    linear : (...) array, dimensionless

    Returns
    -------
    (...) array, dimensionless

    Notes
    -----
    Source: ITU-R BT.709, 4.5 v below 0.018, else 1.099 v^0.45 - 0.099. The three-digit constants leave a step
    of 2.5e-4 at 0.018. Error: below 2e-16 relative in float64 (reference values bt709_encode), 4e-7 in float32
    (v <= 10).
    """
    value = require.floating(linear)
    curve = _at_least(value, 0.018)
    np.power(curve, 0.45, out=curve)
    curve *= 1.099
    curve -= 0.099
    # the float nearest to 0.018 is below it, so '<=' on floats is '<' on real numbers
    return _with_toe(curve, value, 0.018, 4.5)


def bt709_decode(encoded: ArrayLike) -> NDArray:
    """Decode BT.709 camera values to linear light, the inverse of `bt709_encode`.

    Parameters
    ----------
    encoded : (...) array, dimensionless

    Returns
    -------
    (...) array, dimensionless
        Values in the step of `bt709_encode`, 0.081 to 0.08125, which no light produces, give 0.01795 to 0.018.

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
    """Return sign(v) |v|^gamma; the paper's encoding has gamma = 0.45.

    Parameters
    ----------
    value : (...) array, dimensionless
    gamma : float
        Finite, above 0. Below 1 the slope at 0 is infinite: 1e-12 becomes 4e-6 at gamma 0.45, and dark noise grows.

    Returns
    -------
    (...) array, dimensionless
        0 stays 0.

    Raises
    ------
    ValueError
        If gamma is out of range.

    Notes
    -----
    Source: the paper, eq. 15, sign(v) |v|^gamma. Relative error: below 2e-17 times the condition number in float64
    (reference values `gamma_signed`); 8e-7 relative in float32 (gamma up to 2.2, 1e-6 <= |v| <= 10).
    """
    gamma = float(gamma)
    require.allowed(0 < gamma < np.inf, "gamma", gamma, "finite numbers above 0")
    value = require.floating(value)
    # zeros are replaced by the smallest number, and restored below
    plain = _no_negative(value)
    size = _at_least(value if plain else np.abs(value), np.finfo(value.dtype).smallest_subnormal)
    np.power(size, gamma, out=size)
    if plain:
        size *= value != 0  # a masked assignment would take as long as the power
    else:
        size *= np.sign(value)
    return size


def _no_negative(value: NDArray) -> bool:
    """Return whether no value is negative; False if any is NaN, or if there are no values."""
    return bool(value.size and value.min() >= 0)


def _with_toe(curve: NDArray, value: NDArray, end: float, slope: float, divide: bool = False) -> NDArray:
    """Replace the curve by a straight line up to ``end``, in place.

    Products with the mask take a third of the time of ``where``.
    """
    toe = value <= end
    if not toe.any():
        return curve
    straight = toe.astype(curve.dtype)
    line = np.minimum(value, end, out=np.empty_like(curve))
    (np.divide if divide else np.multiply)(line, slope, out=line)
    line *= straight
    curve *= 1 - straight
    curve += line
    return curve


def _at_least(values: NDArray, floor: float) -> NDArray:
    """Return the values, with smaller ones raised to the floor; `clip` takes half the time of `maximum`."""
    kind = values.dtype.type
    lifted = np.empty_like(values)
    np.clip(values, kind(floor), kind(np.inf), out=lifted)
    return lifted
