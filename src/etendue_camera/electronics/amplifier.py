"""Sensor electronics: dark current by temperature, gain, noise by gain, saturation.

In:  temperatures (K), analogue gain (dimensionless, 1 at base), noise (electrons), full well (electrons), codes (DN).
Out: factor on the dark current, read noise (electrons), gain (DN/electron), charge at saturation (electrons), white
     level and the lowest code of a clipped pixel (DN).
Sources: Janesick 2001, "Scientific Charge-Coupled Devices" (dark current); EMVA 1288 release 4 linear (doubling
temperature); Varshni's band gap of silicon as Janesick gives it.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue_camera.constants import BOLTZMANN, ELEMENTARY_CHARGE

BOLTZMANN_EV = BOLTZMANN / ELEMENTARY_CHARGE  # eV/K
COLDEST, HOTTEST = 150.0, 450.0  # K, where the law of `dark_current_factor` is used
MOST_DOUBLINGS = 100  # 1e30: the largest number that a pipeline may contain


def silicon_band_gap(temperature_K: ArrayLike) -> NDArray:
    """Return the band gap of silicon.

    Parameters
    ----------
    temperature_K : (...) array, K
        At or above 0.

    Returns
    -------
    (...) array, eV

    Raises
    ------
    ValueError
        If a temperature is negative or NaN.

    Notes
    -----
    Source: Varshni's form with Janesick's constants, 1.1557 - 7.021e-4 T^2 / (1108 + T); 1.1109 eV at 300 K, where
    1.12 eV is the textbook value.
    """
    temperature = require.at_least_zero("temperature_K", np.asarray(temperature_K, dtype=float))
    return 1.1557 - 7.021e-4 * temperature**2 / (1108.0 + temperature)


def dark_current_factor(temperature_K: float, reference_K: float, doubling_K: float = 0.0) -> float:
    """Return the factor by which dark current grows from a reference temperature to another temperature.

    Parameters
    ----------
    temperature_K, reference_K : float, K
        150 to 450: below, the remaining dark current is not from the bulk; above, the activation energy is different.
    doubling_K : float, K
        Temperature rise that doubles the dark current, as in a data sheet. 0: the law of thermal generation in the
        depletion region.

    Returns
    -------
    float, dimensionless
        Exactly 1 at the reference.

    Raises
    ------
    ValueError
        If a temperature or the doubling is outside the range named above, or the dark current would double more than a
        hundred times: no number that a pipeline may contain is that large.

    Notes
    -----
    Source: T^1.5 exp(-Eg(T) / 2kT) (Janesick 2001): half the band gap is the activation energy of generation through
    mid-gap centres. This dark current doubles every 8.5 K at 298 K. If ``doubling_K`` is given, the factor is 2^((T -
    T0) / T_d) (EMVA 1288, section on the doubling temperature).
    """
    for name, value in (("temperature_K", temperature_K), ("reference_K", reference_K)):
        require.allowed(COLDEST <= value <= HOTTEST, name, value, f"{COLDEST:g} to {HOTTEST:g} K")
    require.amount("doubling_K", doubling_K)
    if temperature_K == reference_K:
        return 1.0
    if doubling_K > 0:
        times = (temperature_K - reference_K) / doubling_K
        require.that(
            times <= MOST_DOUBLINGS,
            f"doubling_K is {doubling_K:g}, so that the dark current would double {times:.4g} times from "
            f"{reference_K:g} to {temperature_K:g} K; at most {MOST_DOUBLINGS} times are computed",
        )
        return 2.0**times
    here = float(silicon_band_gap(temperature_K)) / temperature_K
    there = float(silicon_band_gap(reference_K)) / reference_K
    return (temperature_K / reference_K) ** 1.5 * math.exp((there - here) / (2 * BOLTZMANN_EV))


def read_noise_at_gain(before_gain: ArrayLike, after_gain: ArrayLike, analogue_gain: ArrayLike) -> NDArray:
    """Return the input-referred read noise of an amplifier with noise sources before and after it.

    Parameters
    ----------
    before_gain : (...) array, electrons
        Standard deviation of the noise before the amplifier (source follower), at or above 0.
    after_gain : (...) array, electrons
        Standard deviation of the noise after the amplifier (ADC), in electrons at gain 1; at or above 0.
    analogue_gain : (...) array, dimensionless
        Above 0.

    Returns
    -------
    (...) array, electrons

    Raises
    ------
    ValueError
        If an argument is outside the range named above.

    Notes
    -----
    Source: variances of independent sources add, sqrt(s_1^2 + (s_2 / g)^2).
    """
    before = require.at_least_zero("before_gain", np.asarray(before_gain, dtype=float), " electrons")
    after = require.at_least_zero("after_gain", np.asarray(after_gain, dtype=float), " electrons")
    gain = require.above_zero("analogue_gain", np.asarray(analogue_gain, dtype=float))
    return np.hypot(before, after / gain)


def full_well(pitch: float, fraction: float, density: float) -> float:
    """Return the full well capacity of a pixel: density times light-sensitive area.

    Parameters
    ----------
    pitch : float, um
    fraction : float, dimensionless
        Side of the light-sensitive square over the pitch.
    density : float, electrons um-2

    Returns
    -------
    float, electrons
    """
    return density * (pitch * fraction) ** 2


def gain_of_speed(analogue_gain: float, iso: float, base_iso: float) -> float:
    """Return the amplifier gain, as given or from the ISO speed.

    Parameters
    ----------
    analogue_gain : float, dimensionless
        Applies if ``iso`` is 0.
    iso, base_iso : float
        ISO speed, and ISO speed at gain 1; 0: not given.

    Returns
    -------
    float, dimensionless

    Raises
    ------
    ValueError
        If a speed is given without the speed at gain 1, or together with a gain.
    """
    if iso == 0:
        return float(analogue_gain)
    if base_iso == 0:
        raise ValueError(
            f"iso = {iso:g} requires base_iso, the speed at analogue gain 1: take it from a data sheet, or omit iso, "
            f"add the stage "
            "exposure_numbers to the pipeline and copy its saturation_iso"
        )
    if analogue_gain != 1:
        raise ValueError(f"iso = {iso:g} and analogue_gain = {analogue_gain:g} are both given; give only one of them")
    return float(iso / base_iso)


def dn_per_electron(
    conversion_gain: float, analogue_gain: float, full_well: float, black_level: float, bits: int
) -> float:
    """Return the system gain: from the conversion gain, or such that a full well reaches the top code at gain 1.

    Parameters
    ----------
    conversion_gain : float, DN/electron
        At gain 1; 0: a full well reaches the top code at gain 1.
    analogue_gain : float, dimensionless
    full_well : float, electrons
    black_level : float, DN
    bits : int

    Returns
    -------
    float, DN/electron

    Raises
    ------
    ValueError
        If the black level leaves no codes.
    """
    if conversion_gain > 0:
        return float(conversion_gain) * analogue_gain
    top = 2**bits - 1 - black_level
    require.that(not top <= 0, f"black_level {black_level:g} leaves no codes of {bits} bits")
    return top / full_well * analogue_gain


def white_level(full_well: float, gain_dn_per_electron: float, black_level: float, bits: int) -> float:
    """Return the range from black to saturation, DN: up to the top code, or to the full well if it is reached first.

    Parameters
    ----------
    full_well : float, electrons
    gain_dn_per_electron : float, DN/electron
    black_level : float, DN
    bits : int

    Returns
    -------
    float, DN above black
    """
    top = float(2**bits - 1 - black_level)
    filled = full_well * gain_dn_per_electron
    return top if filled >= top * (1 - 1e-12) else filled


def saturation_charge(full_well: float, gain_dn_per_electron: float, black_level: float, bits: int) -> float:
    """Return the charge above which the output no longer changes: full well or top code, whichever is reached first.

    Parameters
    ----------
    full_well : float, electrons
    gain_dn_per_electron : float, DN/electron
        Above 0.
    black_level : float, DN
        From 0 to below the top code.
    bits : int

    Returns
    -------
    float, electrons

    Raises
    ------
    ValueError
        If the gain is not above 0, or the black level leaves no codes.
    """
    require.allowed(gain_dn_per_electron > 0, "gain_dn_per_electron", gain_dn_per_electron, "numbers above 0")
    if not 0 <= black_level < 2**bits - 1:
        raise ValueError(f"black_level is {black_level!r} DN; allowed: 0 to below the top code {2**bits - 1}")
    return min(full_well, (2**bits - 1 - black_level) / gain_dn_per_electron)


def lowest_clipped_code(
    full_well: float, gain_dn_per_electron: float, black_level: float, bits: int, sigma: float = 0.0
) -> float:
    """Return the lowest code of a pixel that is at full well or beyond the ADC range.

    Parameters
    ----------
    full_well : float, electrons
    gain_dn_per_electron : float, DN/electron
        Above 0.
    black_level : float, DN
        From 0 to below the top code.
    bits : int
    sigma : float, electrons
        Noise after the full well: a full pixel reads up to 4 sigma lower (1 of 32,000 pixels reads still lower).

    Returns
    -------
    float, DN above black
        At most the top code; at least half of the noise-free full well code, however large the noise.

    Raises
    ------
    ValueError
        As `saturation_charge`.

    Notes
    -----
    A full well is rounded to a code like any charge; where it lies within 2**-8 DN below a step, the code below the
    step is returned, since single precision may give it.
    """
    filled = gain_dn_per_electron * saturation_charge(full_well, gain_dn_per_electron, black_level, bits)
    noisy = gain_dn_per_electron * max(full_well - 4 * sigma, 0.0)
    code = math.floor(noisy + black_level + 0.5 - 2**-8) - black_level
    return max(min(float(code), 2**bits - 1 - float(black_level)), 0.5 * filled)
