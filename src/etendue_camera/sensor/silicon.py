"""Optical absorption of silicon.

In:  vacuum wavelength (um).
Out: absorption coefficient (1/um) of intrinsic crystalline silicon at 300 K.
Sources: M. A. Green, Solar Energy Materials and Solar Cells 92, 1305-1310 (2008), doi 10.1016/j.solmat.2008.06.009, as
tabulated by refractiveindex.info (public domain, CC0 1.0).
"""

from functools import cache
from importlib.resources import files

import numpy as np

from etendue_camera.arrays import FloatArray, Floats


def absorption(wavelength: Floats) -> Floats:
    """Return the absorption coefficient of silicon, 4 pi k / lambda.

    Parameters
    ----------
    wavelength : (...) array, um
        0.25 to 1.45.

    Returns
    -------
    (...) array, 1/um
        From 2e2 in the ultraviolet to 1e-12 in the infrared.

    Raises
    ------
    ValueError
        For a wavelength outside the table, or NaN.

    Notes
    -----
    Source: table of Green 2008, band-to-band absorption at 300 K, every 10 nm. Its logarithm is interpolated linearly
    because the values span 14 decades: linear interpolation of the coefficient itself would be up to 19 % higher
    between samples near the band edge. Temperature is not modelled; absorption increases with it.
    Error: rounding at the samples. Predicting every other sample from its neighbours 10 nm away has an error of 0.8 %
    (median) and 7 % (worst) for 0.4 to 1.1 um, so the error between samples is about a quarter of that. The measurement
    itself is less certain (a second source, Schinke 2015, states 11 % at 0.6 um).
    """
    wavelengths, logarithms = _table()
    values = np.asarray(wavelength)
    kind = values.dtype if np.issubdtype(values.dtype, np.floating) else np.dtype(float)
    low, high = wavelengths[[0, -1]].astype(kind)
    if not np.all((values >= low) & (values <= high)):
        raise ValueError(f"wavelength is {wavelength}; it must be within the silicon table, {low} to {high} um")
    result = np.exp(np.interp(values, wavelengths, logarithms))
    return np.asarray(result, kind)[()]


@cache
def _table() -> tuple[FloatArray, FloatArray]:
    """Return wavelengths and natural logarithms of the coefficient, both read-only because they are shared."""
    with files("etendue_camera").joinpath("data", "silicon_absorption.csv").open(encoding="utf-8") as lines:
        wavelengths, extinction = np.loadtxt(lines, delimiter=",", unpack=True)
    logarithms = np.log(4.0 * np.pi * extinction / wavelengths)
    for column in (wavelengths, logarithms):
        column.flags.writeable = False
    return wavelengths, logarithms
