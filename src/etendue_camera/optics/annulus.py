"""A perfect lens with a central obstruction: the annular aperture of mirror lenses, in closed form.

In:  radius (um) or radial spatial frequency (cycles/um), wavelength (um), working f-number of the full circle,
     obstruction.
Out: transfer function; without an obstruction it equals the transfer function of the circle exactly.
Sources: O'Neill, Transfer function for an annular aperture, Journal of the Optical Society of America 46 (1956), 285.

The obstruction eps is the diameter of the dark disc over the diameter of the aperture. The f-number refers to the whole
circle: the light blocked by the disc, a fraction eps^2, is counted in the transmittance or the T-number.
"""

from math import factorial

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray, Floats
from etendue_camera.optics import airy, diffraction

_SEGMENT_SERIES = [(-1) ** k / factorial(2 * k + 3) for k in range(9)]


def annular_otf(frequency: Floats, wavelength: Floats, f_number: Floats, obstruction: float) -> Floats:
    """Return the transfer function of a diffraction-limited annular aperture in incoherent light.

    Parameters
    ----------
    frequency : (...) array, cycles/um
        Radial spatial frequency; the sign does not matter.
    wavelength, f_number : float, um and 1
        Above 0; arrays broadcast against the frequency.
    obstruction : float, 1
        From 0 to below 1.

    Returns
    -------
    (...) array, 1
        Exactly 1 at zero frequency, exactly 0 at the cut-off 1/(lambda N) and beyond, never negative. For obstruction 0
        exactly `diffraction.circular_otf`.

    Raises
    ------
    ValueError
        For a wavelength or f-number that is not above 0, or an obstruction outside [0, 1).

    Notes
    -----
    Source: O'Neill 1956. The result is the overlap area of the annulus and its shifted copy, divided by pi (1 - eps^2).
    This area is circle on circle, plus hole on hole, minus twice circle on hole. The last area is bounded by two arcs
    and computed from half angles, which stay accurate where the circles touch.
    Error: 1e-15/(1 - eps^2) absolute in float64, from the difference of the areas; 1e-7/(1 - eps^2) in float32, which
    is computed in float64 internally.
    """
    require.must(0.0 <= obstruction < 1.0, "obstruction", obstruction, "at least 0 and below 1")
    if obstruction == 0.0:
        return diffraction.circular_otf(frequency, wavelength, f_number)
    given = np.asarray(np.abs(frequency) * diffraction.spot(wavelength, f_number))
    nu = given.astype(float)
    hole = obstruction * obstruction
    with np.errstate(over="ignore"):
        inner = hole * diffraction.circular_otf(nu / obstruction, 1.0, 1.0)
    found = diffraction.circular_otf(nu, 1.0, 1.0) + inner - 2.0 * disc_overlap(2.0 * nu, obstruction)
    found = np.clip(found / ((1.0 - obstruction) * (1.0 + obstruction)), 0.0, 1.0)
    found = np.where(nu == 0.0, 1.0, np.where(nu >= 1.0, 0.0, found))
    return found.astype(given.dtype, copy=False)[()]


def disc_overlap(distance: Floats, radius: float) -> Floats:
    """Return the overlap area of the unit disc and a disc of a radius below 1, in units of pi.

    Parameters
    ----------
    distance : (...) array, 1
        Distance between the centres, 0 or above.
    radius : float, 1
        In (0, 1).

    Returns
    -------
    (...) array, 1
        radius^2 where the small disc lies inside, 0 where the discs do not touch.

    Notes
    -----
    The overlap is the sum of two circular segments, whose area in a unit circle is (y - sin y)/2. sin^2(y/4) is
    computed from products of differences (Heron) rather than from the law of cosines, to avoid cancellation.
    Error: 3e-16 absolute.
    """
    distance = np.asarray(distance, float)
    shared = np.where(distance <= 1.0 - radius, radius * radius, 0.0)
    across = (distance > 1.0 - radius) & (distance < 1.0 + radius)
    d = distance[across]
    slack = np.maximum(1.0 + radius - d, 0.0)
    large = 4.0 * np.arcsin(np.sqrt(np.clip(slack * (radius + d - 1.0) / (4.0 * d), 0.0, 1.0)))
    small = 4.0 * np.arcsin(np.sqrt(np.minimum(slack * (1.0 - radius + d) / (4.0 * d * radius), 1.0)))
    shared[across] = (_segment(large) + radius * radius * _segment(small)) / (2.0 * np.pi)
    return shared[()]


def _segment(y: FloatArray) -> FloatArray:
    """Return y - sin y, as a series below 1.04."""
    near = np.minimum(y, 1.04)
    square = near * near
    return np.where(y < 1.04, near * square * airy.horner(_SEGMENT_SERIES, square), y - np.sin(y))
