"""Black-body radiation, as photons and as a relative spectrum.

In:  wavelengths (um), temperatures (K).
Out: photon radiance, and energy radiance relative to a reference wavelength.
Source: Planck's law with the constants of the SI of 2019.
"""

import numpy as np

from etendue import require
from etendue_camera.arrays import Floats
from etendue_camera.constants import BOLTZMANN, PLANCK, SPEED_OF_LIGHT

SECOND_RADIATION_UM = 1e6 * PLANCK * SPEED_OF_LIGHT / BOLTZMANN
"""The second radiation constant hc/k, um K."""


def planck_photon_radiance(wavelength_um: Floats, temperature: Floats) -> Floats:
    """Return the spectral photon radiance of a black body, 2 c / (lambda^4 (exp(hc / (lambda k T)) - 1)).

    Parameters
    ----------
    wavelength_um : (...) array, um
        Above 0.
    temperature : (...) array, K
        Above 0.

    Returns
    -------
    (...) array, photons s-1 m-2 sr-1 m-1
        Per metre of wavelength. 0 where the true value is below the smallest float; never NaN.

    Raises
    ------
    ValueError
        For a wavelength or a temperature that is not above 0.

    Notes
    -----
    Source: Planck's law. Error: 6e-16 max(1, hc/(lambda k T)) relative, the sensitivity to the inputs.
    """
    require.positive("wavelength_um", wavelength_um)
    require.positive("temperature", temperature)
    wavelength = np.asarray(wavelength_um)
    exponent = SECOND_RADIATION_UM / (wavelength * temperature)
    # exp(-x) / (1 - exp(-x)) instead of 1 / expm1(x): underflows where the other overflows
    return 2e24 * SPEED_OF_LIGHT / wavelength**4 * np.exp(-exponent) / -np.expm1(-exponent)


def planck_ratio(wavelength_um: Floats, temperature: Floats, reference_um: float) -> Floats:
    """Return the black-body spectral energy radiance relative to its value at a reference wavelength.

    Parameters
    ----------
    wavelength_um : (...) array, um
        Above 0.
    temperature : (...) array, K
        Above 0.
    reference_um : float, um
        Above 0; the result is exactly 1 there. CIE illuminant A is 2856 K (2848 K in its original constants)
        with 0.56 um.

    Returns
    -------
    (...) array, 1

    Raises
    ------
    ValueError
        For an input that is not above 0.

    Notes
    -----
    Source: Planck's law as a ratio, with the two exponentials combined into one that overflows only if the ratio
    does. Error: 6e-16 max(1, hc/(lambda k T)) relative, the sensitivity to the inputs.
    """
    require.positive("wavelength_um", wavelength_um)
    require.positive("temperature", temperature)
    require.positive("reference_um", reference_um)
    wavelength = np.asarray(wavelength_um)
    gap = SECOND_RADIATION_UM / temperature * ((wavelength - reference_um) / (wavelength * reference_um))
    slow = np.expm1(-SECOND_RADIATION_UM / (temperature * reference_um))
    fast = np.expm1(-SECOND_RADIATION_UM / (temperature * wavelength))
    return (reference_um / wavelength) ** 5 * np.exp(gap) * (slow / fast)
