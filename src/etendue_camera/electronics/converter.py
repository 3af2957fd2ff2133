"""The analogue-to-digital converter, and conversion back to a linear scale.

In:  charge (electrons), gain (DN/electron), black level (DN), bits.
Out: raw codes (DN, unsigned integers); their fraction of the range above black (dimensionless).
Sources: EMVA 1288 release 4 (linear); DNG 1.6 for black and white levels.
"""

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from etendue import require

BLOCK = 1 << 16  # pixels whose temporaries stay in the cache


def digitise(charge: ArrayLike, gain_dn_per_electron: float, black_level: float, bits: int) -> NDArray:
    """Return raw codes of a linear ADC: pedestal, rounding, clipping at both ends.

    Parameters
    ----------
    charge : (...) array, electrons
        Any sign: read noise makes it negative in the dark. Infinite charge gives the lowest or highest code.
    gain_dn_per_electron : float, DN/electron
        Above 0.
    black_level : float, DN
        Pedestal, from 0 to below the top code. Above 4 sigma of read noise, the dark tail is not clipped.
    bits : int
        1 to 32.

    Returns
    -------
    (...) array, DN
        uint16 up to 16 bits, uint32 beyond; 0 to 2**bits - 1.

    Raises
    ------
    ValueError
        If a number is outside the range above, or a charge is NaN, for which there is no code.

    Notes
    -----
    Source: floor(K e + offset + 1/2), clipped; halves round up, so that steps are equally wide. float32 charge is
    processed in float32 up to 16 bits (codes may be off by one, within 2**-8 DN of a step) and in float64 beyond.

    Examples
    --------
    >>> from etendue_camera.electronics.converter import digitise
    >>> digitise([0.0, 100.0, 1e6], gain_dn_per_electron=0.5, black_level=64, bits=12).tolist()
    [64, 114, 4095]
    """
    charge = np.asarray(charge)
    if not np.issubdtype(charge.dtype, np.floating):
        charge = charge.astype(np.float64)
    top = top_code(bits, black_level)
    gain = float(gain_dn_per_electron)
    require.allowed(0 < gain < np.inf, "gain_dn_per_electron", gain, "finite numbers above 0")
    if bits > 16:
        charge = charge.astype(np.float64, copy=False)
    flat = charge.reshape(-1)
    raw = np.empty(flat.shape, np.uint16 if bits <= 16 else np.uint32)
    for start in range(0, flat.size, BLOCK):
        codes = flat[start : start + BLOCK] * gain
        codes += float(black_level) + 0.5
        np.floor(codes, out=codes)
        np.clip(codes, 0, top, out=codes)
        require.that(
            not np.isnan(codes).any(),
            "charge contains NaN, for which there is no raw code; it must be numbers in electrons",
        )
        raw[start : start + BLOCK] = codes
    return raw.reshape(charge.shape)


def unrounded(charge: ArrayLike, gain_dn_per_electron: float, black_level: float, bits: int) -> NDArray:
    """Return the output of a linear ADC before rounding: pedestal, clipping at both ends.

    Parameters
    ----------
    charge : (...) array, electrons
    gain_dn_per_electron : float, DN/electron
        Above 0.
    black_level : float, DN
        From 0 to below the top code.
    bits : int
        1 to 32.

    Returns
    -------
    (...) array, DN
        Floats of the precision of ``charge``, 0 to 2**bits - 1.

    Raises
    ------
    ValueError
        If a number is outside the range given above.

    Notes
    -----
    Source: K e + offset, clipped. The result is within half a code of ``digitise``, and equals its mean if noise
    spreads the charge over many codes.
    """
    charge = np.asarray(charge)
    top = top_code(bits, black_level)
    gain = float(gain_dn_per_electron)
    require.allowed(0 < gain < np.inf, "gain_dn_per_electron", gain, "finite numbers above 0")
    return np.clip(charge * gain + float(black_level), 0, top)


def linearise(
    raw: NDArray, black_level: float, bits: int, dtype: DTypeLike = np.float32, white: float | None = None
) -> NDArray:
    """Return raw codes as a fraction of the range above black; 1 is clipping, negative values are kept.

    Parameters
    ----------
    raw : (...) array, DN
    black_level : float, DN
        From 0 to below the top code.
    bits : int
        1 to 32.
    dtype : float32 or float64
        Dtype of the result.
    white : float, DN above black
        Level at which pixels saturate: above 0 and at most 2**bits - 1 - black, the default.

    Returns
    -------
    (...) array, dimensionless
        Exactly 0 at black and exactly 1 at white. Clipping the negative half of the dark noise here would
        raise the mean of a black frame by 0.4 sigma.

    Raises
    ------
    ValueError
        If a number is outside the range given above.

    Notes
    -----
    Source: (DN - black) / (white - black). Error: one rounding in float64; in float32 one rounding for up to 16 bits
    and an integer black level, otherwise two.
    """
    top = top_code(bits, black_level)
    work = np.result_type(dtype, np.float64) if bits > 16 else np.dtype(dtype)
    values = np.asarray(raw).astype(work)
    values -= float(black_level)
    white = float(top - black_level) if white is None else float(white)
    if not 0 < white <= top - black_level:
        raise ValueError(f"white is {white!r} above black; it must be above 0 and at most {top - black_level:g}")
    values /= white
    return values.astype(dtype, copy=False)


def top_code(bits: int, black_level: float) -> int:
    require.allowed(int(bits) == bits and 1 <= bits <= 32, "bits", bits, "whole numbers from 1 to 32")
    top = 2 ** int(bits) - 1
    require.that(
        0 <= black_level < top, f"black_level is {black_level!r} DN; it must be from 0 to below the top code {top}"
    )
    return top
