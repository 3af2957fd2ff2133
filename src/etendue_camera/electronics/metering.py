"""Exposure: exposure value, metering, ISO speed, SNR of a grey card.

In:  f-number, time (s), photocurrents (electron/s), charge at saturation and noise (electrons), illuminance (lx).
Out: exposure value, time (s), ISO speed, charge (electrons).
Sources: ISO 12232:2019 (saturation-based speed), ISO 2720 (exposure value); Alakarhu 2007 (International Image
Sensor Workshop) for SNR10.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require

GREY = 0.18  # reflectance of a grey card


def exposure_value(f_number: ArrayLike, time_s: ArrayLike) -> NDArray:
    """Return log2(N^2 / t): the exposure value of an f-number and a time.

    Parameters
    ----------
    f_number : (...) array
        Above 0.
    time_s : (...) array, s
        Above 0.

    Returns
    -------
    (...) array, stops
        0 at f/1 and 1 s; 1 more for half the light.

    Raises
    ------
    ValueError
        If an argument is not above 0.

    Notes
    -----
    Source: ISO 2720, APEX. "EV100" of a scene is this number for a correct exposure at ISO 100.
    """
    number = require.above_zero("f_number", np.asarray(f_number, dtype=float))
    time = require.above_zero("time_s", np.asarray(time_s, dtype=float))
    return 2 * np.log2(number) - np.log2(time)


def saturation_iso(saturation_exposure_lx_s: ArrayLike) -> NDArray:
    """Return the saturation-based ISO speed, 78 / H_sat.

    Parameters
    ----------
    saturation_exposure_lx_s : (...) array, lx s
        Focal-plane exposure at which the first channel saturates, above 0.

    Returns
    -------
    (...) array, ISO speed

    Raises
    ------
    ValueError
        If an exposure is not above 0.

    Notes
    -----
    Source: ISO 12232: a metered scene of mean exposure 10 / S then leaves half a stop above a 100 % reflector.
    """
    return 78 / require.above_zero("saturation_exposure_lx_s", np.asarray(saturation_exposure_lx_s, dtype=float))


def metered_level(rate: NDArray, method: str, quantile: float = 0.99) -> float:
    """Return one photocurrent that represents a frame.

    Parameters
    ----------
    rate : (..., y, x) array, electron/s
        Noise-free, at or above 0 (undershoot counts as 0).
    method : str
        "mean"; "centre": mean weighted with a central Gaussian whose sigma is a quarter of each side; "highlight": the
        quantile.
    quantile : float
        Above 0, at most 1; for "highlight".

    Returns
    -------
    float, electron/s

    Raises
    ------
    ValueError
        If the method is unknown, the quantile not allowed, or the frame is empty.
    """
    require.that(rate.size != 0, "the frame is empty: there is nothing to meter")
    light = np.maximum(rate, 0)
    if method == "mean":
        return float(light.mean(dtype=np.float64))
    if method == "centre":
        rows, columns = (np.exp(-0.5 * ((np.arange(n) - 0.5 * (n - 1)) / (0.25 * n)) ** 2) for n in light.shape[-2:])
        weight = rows[:, None] * columns
        return float((light * weight).sum(dtype=np.float64) / (weight.sum() * (light.size / weight.size)))
    if method == "highlight":
        require.only(0 < quantile <= 1, "quantile", repr(quantile), "above 0 to 1")
        return float(np.quantile(light, quantile))
    raise ValueError(f"method is {method!r}; it must be 'mean', 'centre' or 'highlight'")


def metered_time(level: float, target_electrons: float, ev_bias: float, shortest: float, longest: float) -> float:
    """Return the exposure time that brings a photocurrent to a charge.

    Parameters
    ----------
    level : float, electron/s
        From `metered_level`; 0 gives the longest time.
    target_electrons : float, electrons
        Above 0.
    ev_bias : float, stops
        +1 doubles the time.
    shortest, longest : float, s
        Limits, 0 < shortest <= longest.

    Returns
    -------
    float, s

    Raises
    ------
    ValueError
        If an argument is outside the range given above.
    """
    require.that(
        0 < shortest <= longest,
        f"shortest and longest are {shortest!r} and {longest!r} s; 0 < shortest <= longest is required",
    )
    require.that(
        level >= 0 and target_electrons > 0,
        f"level and target_electrons are {level!r} and {target_electrons!r}; level >= 0 and target above 0 are "
        "required",
    )
    return longest if level == 0 else min(max(target_electrons / level * 2.0**ev_bias, shortest), longest)


def charge_at_snr(snr: ArrayLike, dark_variance: ArrayLike) -> NDArray:
    """Return the photocharge at which the temporal signal-to-noise ratio has a given value.

    Parameters
    ----------
    snr : (...) array, dimensionless
        Ratio of amplitudes, at or above 0.
    dark_variance : (...) array, electrons^2
        Temporal variance in the dark, quantisation included; at or above 0.

    Returns
    -------
    (...) array, electrons

    Raises
    ------
    ValueError
        If an argument is negative or NaN.

    Notes
    -----
    Source: positive root of S / sqrt(S + v) = q, S = q (q + sqrt(q^2 + 4 v)) / 2: a sum of positive terms.
    """
    ratio = require.at_least_zero("snr", np.asarray(snr, dtype=float))
    variance = require.at_least_zero("dark_variance", np.asarray(dark_variance, dtype=float))
    return 0.5 * ratio * (ratio + np.hypot(ratio, 2 * np.sqrt(variance)))


def grey_card_snr(white_electrons: float, dark_variance: float) -> float:
    """Return the temporal signal-to-noise ratio of an 18 % grey card, dB; -inf without light.

    Parameters
    ----------
    white_electrons : float, electrons
        Photocharge of a perfect white diffuser, at or above 0.
    dark_variance : float, electrons^2
        As in `charge_at_snr`.

    Returns
    -------
    float, dB

    Raises
    ------
    ValueError
        If an argument is negative or NaN.
    """
    require.that(
        white_electrons >= 0 and dark_variance >= 0,
        f"white_electrons and dark_variance are {white_electrons!r} and {dark_variance!r}; they must be at or above 0",
    )
    signal = GREY * white_electrons
    return 20 * math.log10(signal) - 10 * math.log10(signal + dark_variance) if signal > 0 else -math.inf
