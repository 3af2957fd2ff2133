"""Filters in the light path: a smooth short-pass over wavelength, and the birefringent low-pass in front of a sensor.

In:  wavelengths (nm); spatial frequencies (cycles/um), spot separations (um), rotation (rad).
Out: transmission (1); transfer functions, real and signed, 1 at zero frequency.
Sources: a birefringent plate splits a ray in two; two crossed plates with a retarder between them make four equal
spots.
"""

import numpy as np
import scipy

from etendue import require
from etendue_camera.arrays import Floats


def smooth_cut(wavelength: Floats, cut_off: float, edge: float) -> Floats:
    """Return the transmission of a short-pass filter with a smooth edge, 1/(1 + exp(2 (w - cut_off)/edge)).

    Parameters
    ----------
    wavelength : (...) array, nm
    cut_off : float, nm
        Wavelength of half transmission; inf for no cut-off.
    edge : float, nm
        Above 0. Transmission falls from 73 to 27 per cent over one edge width, and from 98 to 2 over four.

    Returns
    -------
    (...) array, 1
        In [0, 1], decreasing.

    Raises
    ------
    ValueError
        For an edge that is not above 0.

    Notes
    -----
    This is a generic model. Use a table for a real infrared cut filter of glass or with coatings.
    """
    require.positive("edge", edge, " nm")
    return scipy.special.expit(2.0 * (cut_off - np.asarray(wavelength)) / edge)


def four_spot_otf(fy: Floats, fx: Floats, separation_y: Floats, separation_x: Floats, rotation: float = 0.0) -> Floats:
    """Return the transfer function of a filter that splits light into four equal spots at (+-d_y/2, +-d_x/2).

    Parameters
    ----------
    fy, fx : arrays that broadcast, cycles/um
    separation_y, separation_x : float, or arrays that broadcast, um
        Distance between the spots along the two axes of the filter; 0 for no split along that axis.
    rotation : float, rad
        Angle of the filter axes relative to the sensor axes, from x towards y.

    Returns
    -------
    broadcast array, 1
        cos(pi d_y f_y) cos(pi d_x f_x) along the filter axes: in [-1, 1], with the first zero at 1/(2 d).

    Notes
    -----
    Source: the mean of four shifted copies. The sign is kept: contrast is reversed beyond 1/(2 d). Error: 2e-16 (1 + 3
    pi d f) absolute in float64.
    """
    if rotation == 0.0:  # separable: cheaper, and exactly even in either frequency
        return np.cos(np.pi * separation_y * fy) * np.cos(np.pi * separation_x * fx)
    sine, cosine = np.sin(rotation), np.cos(rotation)
    along_x, along_y = cosine * fx + sine * fy, cosine * fy - sine * fx
    return np.cos(np.pi * separation_y * along_y) * np.cos(np.pi * separation_x * along_x)
