"""Image of a point formed by a perfect lens with a circular aperture.

In:  radius (um) or radial spatial frequency (cycles/um), wavelength (um), f-number.
Out: the Airy pattern, its encircled energy, its transfer function, its energy per pixel, resolution limits.
Sources: Born and Wolf, Principles of Optics, section 8.5; Goodman, Introduction to Fourier Optics, section 6.3; seed
paper eqs. 3 and 4. Eq. 3 is misprinted: its argument grows without bound towards the centre. The 2.44 of eq. 4 is used
with all its digits.

Throughout, v = pi r / (lambda N), where N is the working f-number (see `radiometry.working_f_number`). A wavelength or
f-number that is not above 0 raises ValueError.
"""

from math import factorial

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray, Floats
from etendue_camera.optics import airy

AIRY_DIAMETER = 2.43933978253300891
"""Diameter of the first dark ring in lambda N: twice the first zero of J1 over pi."""
RAYLEIGH = 1.21966989126650445
"""Rayleigh separation in lambda N: the peak of one spot lies on the first dark ring of the other."""
SPARROW = 0.947155252709185545
"""Sparrow separation in lambda N, at which the dip between two spots disappears."""


def airy_intensity(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Return the Airy pattern relative to its peak, [2 J1(v)/v]^2.

    Parameters
    ----------
    r : (...) array, um
        Distance from the centre; the sign does not matter.
    wavelength : float, um
        Above 0.
    f_number : float, 1
        Working f-number, above 0.

    Returns
    -------
    (...) array, 1
        In [0, 1], exactly 1 at r = 0, 0 at infinity.

    Raises
    ------
    ValueError
        For a wavelength or an f-number that is not above 0.

    Notes
    -----
    Error: 1e-15 relative for v < 1. For larger v, up to 1e8, 1e-15 v times the envelope of the pattern, 8/(pi v^3):
    this is the rounding of v itself, which any Bessel function inherits. Relative error is meaningless at a dark ring.
    """
    v = _argument(r, wavelength, f_number)
    return airy.pattern(v)


def airy_psf_density(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Return the point spread function, pi / (4 (lambda N)^2) [2 J1(v)/v]^2, whose integral over the plane is 1.

    Parameters
    ----------
    r, wavelength, f_number
        As for `airy_intensity`, which also lists the exceptions.

    Returns
    -------
    (...) array, um-2

    Notes
    -----
    Error: as for `airy_intensity`.
    """
    return np.pi / (4.0 * spot(wavelength, f_number) ** 2) * airy_intensity(r, wavelength, f_number)


def airy_encircled(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Return the fraction of the energy inside a circle, 1 - J0(v)^2 - J1(v)^2.

    Parameters
    ----------
    r, wavelength, f_number
        As for `airy_intensity`, which also lists the exceptions.

    Returns
    -------
    (...) array, 1
        In [0, 1], increasing with the radius.

    Notes
    -----
    Source: Lord Rayleigh 1881; Born and Wolf section 8.5.2. The printed form cancels for small v (error 200 % at 1e-9),
    so below v = 1 its power series is used.
    Error: below 2e-15 relative for v up to 1e8.
    """
    return airy.encircled(_argument(r, wavelength, f_number))


def airy_outside(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Return the fraction of the energy outside a circle, J0(v)^2 + J1(v)^2: the loss of a kernel truncated at that
    radius.

    Parameters
    ----------
    r, wavelength, f_number
        As for `airy_intensity`, which also lists the exceptions.

    Returns
    -------
    (...) array, 1
        In [0, 1], about 2/(pi v) for large v.

    Notes
    -----
    Source: as for `airy_encircled`. Error: below 3e-15 relative for v up to 1e8 (10 m at f/1).
    """
    return airy.outside(_argument(r, wavelength, f_number))


_BLOCK = 1 << 14
_SINE_SERIES = [(-1) ** k / factorial(2 * k + 3) for k in range(8)]


def circular_otf(frequency: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Return the transfer function of a diffraction-limited circular aperture in incoherent light.

    Parameters
    ----------
    frequency : (...) array, cycles/um
        Radial spatial frequency; the sign does not matter.
    wavelength, f_number : float, um and 1
        Above 0; arrays broadcast against the frequency.

    Returns
    -------
    (...) array, 1
        Decreases from exactly 1 at zero frequency to exactly 0 at the cut-off 1/(lambda N) and beyond.

    Raises
    ------
    ValueError
        For a wavelength or an f-number that is not above 0.

    Notes
    -----
    Source: Goodman eq. 6-32, (2/pi)(acos nu - nu sqrt(1 - nu^2)) with nu = f lambda N. Near the cut-off the two terms
    cancel (error 9e-10 of the value at nu = 1 - 1e-4), so above nu = 0.88 the function is computed from the series of
    (y - sin y)/pi with y = 2 acos nu.
    Error: below 2e-15 (float64) and 1e-6 (float32) relative for a given nu. The rounding error of nu adds to this,
    amplified by 1.5/(1 - nu) near the cut-off.

    Examples
    --------
    >>> from etendue_camera.optics.diffraction import circular_otf
    >>> circular_otf([0.0, 0.25, 0.5], wavelength=0.5, f_number=4.0).round(3).tolist()  # the middle is half the cut-off
    [1.0, 0.391, 0.0]
    """
    nu = np.asarray(np.abs(frequency) * spot(wavelength, f_number))
    out = np.zeros(nu.shape, nu.dtype)
    inside = ~(nu >= 1.0)  # NaN stays in, and comes out as NaN
    out[inside] = _otf(nu[inside])
    return out[()]


def cutoff_frequency(wavelength: Floats, f_number: Floats) -> Floats:
    """Return the cut-off frequency (cycles/um) of a diffraction-limited lens, 1/(lambda N)."""
    return 1.0 / spot(wavelength, f_number)


def airy_diameter(wavelength: Floats, f_number: Floats) -> Floats:
    """Return the diameter (um) of the first dark ring, 2.4393... lambda N; the paper's eq. 4 rounds it to 2.44."""
    return AIRY_DIAMETER * spot(wavelength, f_number)


def rayleigh_separation(wavelength: Floats, f_number: Floats) -> Floats:
    """Return the distance (um) at which one spot lies on the first dark ring of the other, 1.2196... lambda N."""
    return RAYLEIGH * spot(wavelength, f_number)


def sparrow_separation(wavelength: Floats, f_number: Floats) -> Floats:
    """Return the distance (um) at which the dip between two equal incoherent spots disappears, 0.9471... lambda N."""
    return SPARROW * spot(wavelength, f_number)


def pixel_airy(row: Floats, column: Floats, pitch: float, wavelength: float, f_number: float) -> FloatArray:
    """Return the fraction of the energy of an Airy spot centred on pixel (0, 0) that falls on a square pixel.

    Parameters
    ----------
    row, column : (...) array of whole numbers, pixel
        Index of the pixel; broadcast against each other.
    pitch : float, um
        Side of the pixel, whose whole area is sensitive; above 0.
    wavelength, f_number : float, um and 1
        Above 0.

    Returns
    -------
    (...) array of float64, 1
        Sums to 1 over the infinite plane.

    Raises
    ------
    ValueError
        For a row or column that is not a whole number, or a pitch, wavelength or f-number that is not above 0.

    Notes
    -----
    The energy in a sector of angle dphi that ends at radius R is the encircled energy times dphi/(2 pi). The fraction
    on the pixel is that energy integrated along the outline of the pixel, with dphi = d ds / (d^2 + s^2) along an edge
    at distance d. Far from the centre the energy outside R is integrated instead, which preserves the digits of faint
    pixels; around a closed outline the two integrals differ by 1 if the centre is inside and by 0 if not. Each edge is
    integrated by Gauss-Legendre quadrature with a number of nodes that grows with pitch/(lambda N).
    Error: below 1e-15 absolute. For pixels wider than a dark ring (pitch/(lambda N) of 1 and above: every camera at
    f/1), the relative error is below 1e-14 + 2e-15 x the distance in pixels: 2e-14 at 39 pixels, 4e-13 at 1000, 1e-10
    at 100 000 (21 pixels against 25 digits, pitch/(lambda N) from 1 to 40). The error grows with distance because the
    integrals along the four edges increasingly cancel. Narrower pixels, with pitch/(lambda N) from 0.003 and up to 39
    rows and columns away, reach the same error except on a dark ring, where relative error is meaningless: 3e-11 for
    2e-9 of the energy.
    """
    scale = np.pi * pitch / spot(wavelength, f_number)
    require.positive("pitch", pitch, " um")
    row, column = np.broadcast_arrays(np.abs(np.asarray(row, float)), np.abs(np.asarray(column, float)))
    if not (np.all(row == np.rint(row)) and np.all(column == np.rint(column))):
        raise ValueError(f"row is {row} and column is {column}; they must be whole numbers of pixels")
    # eight pixels share a value by symmetry: sort row and column so that the larger comes first
    pairs = np.stack([np.maximum(row, column).ravel(), np.minimum(row, column).ravel()])
    distinct, back = np.unique(pairs, axis=1, return_inverse=True)
    return _pixel_energy(distinct[0], distinct[1], scale)[back].reshape(row.shape)[()]


def two_point_saddle(separation: Floats) -> tuple[Floats, Floats]:
    """Return the depth of the dip between two equal incoherent Airy spots, and the positions of their peaks.

    Parameters
    ----------
    separation : (...) array, lambda/NA
        Distance between the spots, 0 or above. lambda/NA is 2 lambda N.

    Returns
    -------
    ratio : (...) array, 1
        Brightness midway between the spots over the brightness of a peak; exactly 1 where they have merged.
    offset : (...) array, lambda/NA
        Distance of a peak from the midpoint; exactly 0 where they have merged.

    Raises
    ------
    ValueError
        For a negative or NaN separation.

    Notes
    -----
    Source: the paper, figure 2. The spots merge at the Sparrow separation, 0.4735776 lambda/NA. The peak lies where the
    slopes 8 J1 J2 / v^2 of the two spots cancel; bisection finds it to the last bit.
    Error: below 1e-15 for the ratio. For the offset, 1e-15 times its sensitivity to the separation s, which is s / (2
    (s - s0)) close to the Sparrow separation s0.
    """
    separation = np.asarray(separation, float)
    require.must(separation >= 0.0, "separation", separation, "0 or above")
    half = np.pi * separation
    merged = 2.0 * separation <= SPARROW
    # the slope changes sign once between the bounds: the peak of a resolved spot lies at most 1 inside its centre
    low = np.where(half > 1.9, half - 1.0, 0.0)
    high = half + 0.5
    for _ in range(64):
        middle = 0.5 * (low + high)
        rising = airy.slope(middle - half) + airy.slope(middle + half) > 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    peak = np.where(merged, 0.0, 0.5 * (low + high))
    ratio = 2.0 * airy.pattern(half) / (airy.pattern(peak - half) + airy.pattern(peak + half))
    return np.where(merged, 1.0, ratio)[()], (peak / (2.0 * np.pi))[()]


def spot(wavelength: Floats, f_number: Floats) -> Floats:
    """Return lambda N in um; a scalar is returned as a plain float, so that float32 arrays stay float32."""
    require.positive("wavelength", wavelength, " um")
    require.positive("f_number", f_number)
    product = np.asarray(wavelength) * f_number
    return product if product.ndim else float(product)


def _argument(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    return np.abs(r) * (np.pi / spot(wavelength, f_number))


def _pixel_energy(row: FloatArray, column: FloatArray, scale: float) -> FloatArray:
    """Compute `pixel_airy` for a one-dimensional array of pixels; ``scale`` is v per pixel."""
    nodes, weights = np.polynomial.legendre.leggauss(32 + int(np.ceil(1.5 * scale)))
    near = scale * np.hypot(row + 0.5, column + 0.5) < 1.5
    total = np.zeros(row.shape)
    for across, along in ((row, column), (column, row)):
        for side in (0.5, -0.5):
            distance = across + side
            for node, weight in zip(nodes, weights, strict=True):
                radius = np.hypot(distance, along + 0.5 * node)
                v = scale * radius
                energy = np.where(near, airy.encircled(v), -airy.outside(v))
                total += weight * np.copysign(1.0, side) * energy * distance / radius**2
    # half the node spacing over a full turn; for the centre pixel the integral is minus the energy outside it
    inside = (row == 0.0) & (column == 0.0) & ~near
    return inside + total / (4.0 * np.pi)


def _otf(nu: FloatArray) -> FloatArray:
    """Compute the transfer function of (n,) values of nu below 1, in blocks that fit in the cache of a core."""
    out = np.empty_like(nu)
    for start in range(0, nu.size, _BLOCK):
        block = nu[start : start + _BLOCK]
        angle = np.arccos(block)
        found = (2.0 / np.pi) * (angle - block * np.sqrt((1.0 - block) * (1.0 + block)))
        near = angle < 0.5
        y = 2.0 * angle[near]
        square = y * y
        # (y - sin y)/pi; the omitted terms are below 1e-17 of it for y < 1.04
        found[near] = y * square * airy.horner(_SINE_SERIES, square) / np.pi
        found[block == 0.0] = 1.0
        out[start : start + _BLOCK] = found
    return out
