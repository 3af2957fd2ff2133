"""Dynamic range of a sensor: from the smallest signal above its noise to the full well.

In:  dark current (A or A/cm2), time (s), full well, read noise and DSNU (electrons), gain (DN/electron).
Out: dark electrons, limiting photocurrents (A), signal-to-noise ratio and dynamic range (dB).
Sources: the paper (docs/paper.md), eqs. 12-13, in electrons (as printed, eq. 13 adds A s to A2 s2); EMVA 1288 release 4
linear.

All quantities are in electrons: in SI units q^2 is 2.6e-38, at the edge of float32. Results are float32
if all arguments are.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue import require
from etendue_camera.constants import ELEMENTARY_CHARGE

UM2_IN_CM2 = 1e-8


def dark_electrons(dark_current_density_A_per_cm2: ArrayLike, area_um2: ArrayLike, time_s: ArrayLike) -> NDArray:
    """Return the mean number of dark electrons in a pixel.

    Parameters
    ----------
    dark_current_density_A_per_cm2 : (...) array, A/cm2
        At or above 0.
    area_um2 : (...) array, um2
        Pixel area that collects dark current, at or above 0.
    time_s : (...) array, s
        Integration time, at or above 0.

    Returns
    -------
    (...) array, electrons

    Raises
    ------
    ValueError
        If an argument is negative or NaN.

    Notes
    -----
    Source: n_d = i_dc t / q with i_dc = density x area. Error: 4 roundings, below 5e-16 relative.
    """
    density = require.at_least_zero("dark_current_density_A_per_cm2", dark_current_density_A_per_cm2)
    area, time = require.at_least_zero("area_um2", area_um2), require.at_least_zero("time_s", time_s)
    # density / q is about 1e10 for real sensors: dividing first keeps float32 away from its denormals
    return density / ELEMENTARY_CHARGE * (area * UM2_IN_CM2) * time


def saturation_current(full_well: ArrayLike, time: ArrayLike, dark_current: ArrayLike) -> NDArray:
    """Return the largest photocurrent that does not saturate the pixel.

    Parameters
    ----------
    full_well : (...) array, electrons
        At or above 0.
    time : (...) array, s
        Integration time, above 0.
    dark_current : (...) array, A
        At or above 0.

    Returns
    -------
    (...) array, A
        Negative if dark current alone fills the well.

    Raises
    ------
    ValueError
        If an argument is outside the range given above.

    Notes
    -----
    Source: the paper, eq. 12, i_max = q Qmax / t - i_dc.
    Error: below 2e-16 relative to the larger term (reference values i_max).
    """
    well, dark = require.at_least_zero("full_well", full_well), require.at_least_zero("dark_current", dark_current)
    return ELEMENTARY_CHARGE * well / require.above_zero("time", time) - dark


def smallest_current(time: ArrayLike, dark_current: ArrayLike, read_noise: ArrayLike, dsnu: ArrayLike) -> NDArray:
    """Return the photocurrent whose charge equals the standard deviation of the dark signal.

    Parameters
    ----------
    time : (...) array, s
        Integration time, above 0.
    dark_current : (...) array, A
        At or above 0.
    read_noise, dsnu : (...) array, electrons
        Standard deviations, at or above 0.

    Returns
    -------
    (...) array, A

    Raises
    ------
    ValueError
        If an argument is outside the range given above.

    Notes
    -----
    Source: denominator of the paper's eq. 13 over t, with q^2 (not q) before the variances, which are in
    electrons squared. Error: below 4e-16 relative (reference values i_min).
    """
    time = require.above_zero("time", time)
    dark = require.at_least_zero("dark_current", dark_current) * time / ELEMENTARY_CHARGE
    return ELEMENTARY_CHARGE * _dark_noise(dark, read_noise, dsnu) / time


def dynamic_range_elgamal(
    full_well: ArrayLike, dark_electrons: ArrayLike, read_noise: ArrayLike, dsnu: ArrayLike
) -> NDArray:
    """Return the largest photosignal over the noise of the dark signal, the paper's dynamic range.

    Parameters
    ----------
    full_well, dark_electrons : (...) array, electrons
        Capacity of the well and mean dark charge in it, at or above 0.
    read_noise, dsnu : (...) array, electrons
        Standard deviations, at or above 0.

    Returns
    -------
    (...) array, dB
        -inf if the dark charge fills the well, +inf without noise if the well is not full.

    Raises
    ------
    ValueError
        If an argument is negative or NaN.

    Notes
    -----
    Source: the paper, eq. 13 with q^2 before the variances; as printed it is wrong by up to sqrt(1/q) (-119 dB for a
    sensor of 68 dB). The smallest signal is the dark noise alone; `dynamic_range_emva` requires SNR = 1. Error: below
    3e-16 times the condition number (reference values `dr_db`, 68.05 dB to -111.6 dB).
    """
    well = require.at_least_zero("full_well", full_well)
    dark = require.at_least_zero("dark_electrons", dark_electrons)
    return _decibel(np.maximum(well - dark, 0), _dark_noise(dark, read_noise, dsnu))


def snr_db(
    electrons: ArrayLike, dark_electrons: ArrayLike, read_noise: ArrayLike, dsnu: ArrayLike, prnu: ArrayLike
) -> NDArray:
    """Return the signal-to-noise ratio of one pixel, with fixed patterns counted as noise.

    Parameters
    ----------
    electrons, dark_electrons : (...) array, electrons
        Mean photocharge and mean dark charge, at or above 0.
    read_noise, dsnu : (...) array, electrons
        Standard deviations, at or above 0.
    prnu : (...) array, dimensionless
        Relative standard deviation of the pixels' gain, at or above 0.

    Returns
    -------
    (...) array, dB
        -inf without signal.

    Raises
    ------
    ValueError
        If an argument is negative or NaN.

    Notes
    -----
    Source: El Gamal's SNR with the PRNU term, 20 log10(S / sqrt(S + n_d + s_r^2 + s_D^2 + (prnu S)^2)).
    Error: below 4e-16 relative (reference values snr_db).
    """
    signal = require.at_least_zero("electrons", electrons)
    gain_noise = require.at_least_zero("prnu", prnu) * signal
    dark = require.at_least_zero("dark_electrons", dark_electrons)
    return _decibel(signal, np.hypot(_dark_noise(signal + dark, read_noise, dsnu), gain_noise))


def emva_snr(
    photons: ArrayLike, quantum_efficiency: ArrayLike, gain_dn_per_electron: ArrayLike, dark_noise: ArrayLike
) -> NDArray:
    """Return the signal-to-noise ratio of a linear camera, including quantisation.

    Parameters
    ----------
    photons : (...) array, photons per pixel and exposure
        At or above 0.
    quantum_efficiency : (...) array, electrons/photon
        Above 0.
    gain_dn_per_electron : (...) array, DN/electron
        Above 0; infinity excludes quantisation.
    dark_noise : (...) array, electrons
        Temporal standard deviation in the dark: read noise and the shot noise of dark current.

    Returns
    -------
    (...) array, dimensionless
        A ratio of amplitudes, not dB; 0 without light.

    Raises
    ------
    ValueError
        If an argument is outside the range given above.

    Notes
    -----
    Source: EMVA 1288 R4 linear, eta mu / sqrt(s_d^2 + 1/(12 K^2) + eta mu).
    Error: below 4e-16 relative (reference values emva_snr).
    """
    charge = require.at_least_zero("photons", photons) * require.above_zero("quantum_efficiency", quantum_efficiency)
    floor = _emva_floor(gain_dn_per_electron, dark_noise)
    noise = np.hypot(np.sqrt(charge), floor)
    return np.divide(charge, noise, out=np.zeros_like(noise), where=noise > 0)


def emva_smallest_photons(
    quantum_efficiency: ArrayLike, gain_dn_per_electron: ArrayLike, dark_noise: ArrayLike
) -> NDArray:
    """Return the number of photons at which `emva_snr` is exactly 1; arguments as for `emva_snr`.

    Returns
    -------
    (...) array, photons per pixel and exposure
        1 / quantum_efficiency for a noiseless camera.

    Raises
    ------
    ValueError
        If an argument is outside the range given in `emva_snr`.

    Notes
    -----
    Source: root of EMVA 1288 SNR = 1, (1/2 + sqrt(1/4 + s_d^2 + 1/(12 K^2))) / eta.
    Error: below 4e-16 relative (reference values emva_mu_p_min).
    """
    floor = _emva_floor(gain_dn_per_electron, dark_noise)
    return (np.hypot(floor, 0.5) + 0.5) / require.above_zero("quantum_efficiency", quantum_efficiency)


def emva_smallest_photons_approx(
    quantum_efficiency: ArrayLike, gain_dn_per_electron: ArrayLike, dark_noise: ArrayLike
) -> NDArray:
    """Return `emva_smallest_photons` as in the EMVA reference implementation, to compare data sheets.

    Returns
    -------
    (...) array, photons per pixel and exposure
        Below the exact value: by half for a noiseless camera, by 1/(8 s) electrons for a large noise s.

    Raises
    ------
    ValueError
        If an argument is outside the range given in `emva_snr`.

    Notes
    -----
    Source: EMVA 1288 R4 linear, (s_y.dark / K + 1/2) / eta. Error: below 4e-16 relative (reference values
    emva_mu_p_min_approx).
    """
    floor = _emva_floor(gain_dn_per_electron, dark_noise)
    return (floor + 0.5) / require.above_zero("quantum_efficiency", quantum_efficiency)


def dynamic_range_emva(
    full_well: ArrayLike, dark_electrons: ArrayLike, read_noise: ArrayLike, gain_dn_per_electron: ArrayLike
) -> NDArray:
    """Return the largest photosignal over the photosignal at SNR = 1, the EMVA 1288 dynamic range.

    Parameters
    ----------
    full_well : (...) array, electrons
        Charge at which the output saturates: the smaller of full well and ADC limit, (top code - black) / gain.
    dark_electrons : (...) array, electrons
        Mean dark charge: fills the well and adds its shot noise.
    read_noise : (...) array, electrons
        Temporal standard deviation. DSNU is a fixed pattern, which this standard excludes from the SNR.
    gain_dn_per_electron : (...) array, DN/electron
        Above 0; infinity excludes quantisation.

    Returns
    -------
    (...) array, dB
        -inf if the dark charge fills the well; otherwise finite, since even one electron has shot noise.

    Raises
    ------
    ValueError
        If an argument is outside the range given above.

    Notes
    -----
    Source: EMVA 1288 R4 linear, mu_p.sat / mu_p.min, from which quantum efficiency cancels.
    """
    well, dark = require.at_least_zero("full_well", full_well), require.at_least_zero("dark_electrons", dark_electrons)
    noise = _dark_noise(dark, read_noise, 0.0)
    return _decibel(np.maximum(well - dark, 0), emva_smallest_photons(1.0, gain_dn_per_electron, noise))


def _dark_noise(shot_variance: NDArray, read_noise: ArrayLike, dsnu: ArrayLike) -> NDArray:
    """Return sqrt(n + s_r^2 + s_D^2) without squaring, which would overflow float32 at 2e19."""
    read, fixed = require.at_least_zero("read_noise", read_noise), require.at_least_zero("dsnu", dsnu)
    return np.hypot(np.hypot(np.sqrt(shot_variance), read), fixed)


def _emva_floor(gain: ArrayLike, dark_noise: ArrayLike) -> NDArray:
    """Return sqrt(s_d^2 + 1/(12 K^2)), electrons."""
    quantisation = 1 / (require.above_zero("gain_dn_per_electron", gain) * 12**0.5)
    return np.hypot(require.at_least_zero("dark_noise", dark_noise), quantisation)


def _decibel(signal: NDArray, noise: NDArray) -> NDArray:
    """Return 20 log10(signal / noise): -inf without signal for any noise; +inf with signal and no noise."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(signal > 0, 20 * np.log10(signal / noise), -np.inf)[()]
