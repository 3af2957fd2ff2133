"""What a perfect lens with a circular aperture does to a point of light.

In:  radius (um) or radial spatial frequency (cycles/um), wavelength (um), f-number.
Out: the Airy pattern, its encircled energy, its transfer function, its energy per pixel, resolution limits.
Sources: Born and Wolf, Principles of Optics, section 8.5; Goodman, Introduction to Fourier Optics, section
6.3; seed paper eqs. 3 and 4, of which eq. 3 is misprinted (its argument grows without bound towards the
centre) and the 2.44 of eq. 4 is kept with all its digits.

Throughout v = pi r / (lambda N). N is the working f-number: see `radiometry.working_f_number`. A wavelength or an
f-number that is not above 0 is a ValueError.
"""

from math import factorial

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray, Floats
from etendue_camera.optics import airy

AIRY_DIAMETER = 2.43933978253300891
"""Diameter of the first dark ring in lambda N: twice the first zero of J1 over pi."""
RAYLEIGH = 1.21966989126650445
"""Rayleigh's separation in lambda N: one spot on the other's first dark ring."""
SPARROW = 0.947155252709185545
"""Sparrow's separation in lambda N: the dip between two spots disappears."""


def airy_intensity(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Airy pattern relative to its peak, [2 J1(v)/v]^2.

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
    Error: 1e-15 relative for v < 1, and 1e-15 v times the pattern's envelope 8/(pi v^3) beyond, for v up to
    1e8: the rounding of v itself, which the argument of any Bessel function carries. Relative error means
    nothing at a dark ring.
    """
    v = _argument(r, wavelength, f_number)
    return airy.pattern(v)


def airy_psf_density(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Point spread function with unit energy over the plane, pi / (4 (lambda N)^2) [2 J1(v)/v]^2.

    Parameters
    ----------
    r, wavelength, f_number
        As in `airy_intensity`, with its errors.

    Returns
    -------
    (...) array, um-2

    Notes
    -----
    Error: as `airy_intensity`.
    """
    return np.pi / (4.0 * spot(wavelength, f_number) ** 2) * airy_intensity(r, wavelength, f_number)


def airy_psf_stack(
    y: FloatArray, x: FloatArray, wavelengths: FloatArray, f_number: float, tolerance: float = 0.0
) -> FloatArray:
    """Airy point spread functions on one grid at many wavelengths.

    Parameters
    ----------
    y : (ny,) array, um
    x : (nx,) array, um
        Positions from the centre of the spot. Rows and columns that are mirror images to the last bit are computed
        once: an even grid about the centre, spacing x (i - n // 2), costs an eighth of its samples.
    wavelengths : (bands,) array, um
        Above 0.
    f_number : float, 1
        Working f-number, above 0.
    tolerance : float, 1
        Largest error relative to the peak. 0: the closed form everywhere; above it a table of the pattern may be used.

    Returns
    -------
    (bands, ny, nx) array, um-2
        Unit energy over the plane, as `airy_psf_density`; float32 if y and x are.

    Raises
    ------
    ValueError
        For positions that are not one-dimensional, wavelengths or an f-number not above 0, a negative tolerance.

    Notes
    -----
    The pattern is a function of v = pi r/(lambda N) alone: one table serves all wavelengths. It holds values and
    slopes; cubic interpolation between them errs by step^4/384 times the fourth derivative, which is largest at the
    centre, 5/8.
    Error: that of `airy_psf_density` with tolerance 0; measured below the tolerance else.
    """
    y, x, bands = np.asarray(y), np.asarray(x), np.atleast_1d(np.asarray(wavelengths, float))
    require.that(y.ndim == 1 and x.ndim == 1, f"y has shape {y.shape} and x {x.shape}; both must be one-dimensional")
    require.must(0.0 <= tolerance < 1.0, "tolerance", tolerance, "at least 0 and below 1")
    spots = np.atleast_1d(spot(bands, f_number))
    kind = np.result_type(y, x, np.float32)
    rows, row_of = np.unique(np.abs(y).astype(float), return_inverse=True)
    columns, column_of = np.unique(np.abs(x).astype(float), return_inverse=True)
    if rows.shape == columns.shape and np.array_equal(rows, columns):
        first, second = np.tril_indices(rows.size)
        radius = np.hypot(rows[first], columns[second])
        low, high = np.minimum(row_of[:, None], column_of), np.maximum(row_of[:, None], column_of)
        where = high * (high + 1) // 2 + low
    else:
        radius = np.hypot(rows[:, None], columns).ravel()
        where = row_of[:, None] * columns.size + column_of
    farthest = np.pi * radius.max(initial=0.0) / spots.min(initial=np.inf)
    step = (384.0 * tolerance / 0.625) ** 0.25
    table = airy.hermite_table(farthest, step) if step > 0.0 and farthest / step < radius.size else None
    stack = np.empty((bands.size, y.size, x.size), kind)
    for plane, size in zip(stack, spots, strict=True):
        v = radius * (np.pi / size)
        values = airy.pattern(v) if table is None else airy.from_hermite_table(table, step, v)
        np.take((values * (np.pi / (4.0 * size * size))).astype(kind), where, out=plane, mode="clip")
    return stack


def airy_encircled(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Share of the energy inside a circle, 1 - J0(v)^2 - J1(v)^2.

    Parameters
    ----------
    r, wavelength, f_number
        As in `airy_intensity`, with its errors.

    Returns
    -------
    (...) array, 1
        In [0, 1], growing with the radius.

    Notes
    -----
    Source: Lord Rayleigh 1881; Born and Wolf section 8.5.2. The printed form is all error for small v
    (200 % at 1e-9), so below v = 1 its power series is used.
    Error: below 2e-15 relative for v up to 1e8.
    """
    return airy.encircled(_argument(r, wavelength, f_number))


def airy_outside(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Share of the energy outside a circle, J0(v)^2 + J1(v)^2: what a kernel cut at that radius loses.

    Parameters
    ----------
    r, wavelength, f_number
        As in `airy_intensity`, with its errors.

    Returns
    -------
    (...) array, 1
        In [0, 1], about 2/(pi v) far out.

    Notes
    -----
    Source: as `airy_encircled`. Error: below 3e-15 relative for v up to 1e8 (10 m at f/1).
    """
    return airy.outside(_argument(r, wavelength, f_number))


_BLOCK = 1 << 14
_SINE_SERIES = [(-1) ** k / factorial(2 * k + 3) for k in range(8)]


def circular_otf(frequency: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    """Transfer function of a diffraction-limited circular aperture in incoherent light.

    Parameters
    ----------
    frequency : (...) array, cycles/um
        Radial spatial frequency; the sign does not matter.
    wavelength, f_number : float, um and 1
        Above 0; arrays broadcast against the frequency.

    Returns
    -------
    (...) array, 1
        Falls from exactly 1 at zero to exactly 0 at the cut-off 1/(lambda N) and beyond.

    Raises
    ------
    ValueError
        For a wavelength or an f-number that is not above 0.

    Notes
    -----
    Source: Goodman eq. 6-32, (2/pi)(acos nu - nu sqrt(1 - nu^2)) with nu = f lambda N. Near the cut-off the
    two terms cancel (9e-10 of the value at nu = 1 - 1e-4), so above nu = 0.87 it is (y - sin y)/pi with y = 2
    acos nu, as a series.
    Error: below 2e-15 (float64) and 1e-6 (float32) relative for a given nu; the rounding of nu adds its own,
    which is 1.5/(1 - nu) times larger near the cut-off.

    Examples
    --------
    >>> from etendue_camera.optics.diffraction import circular_otf
    >>> circular_otf([0.0, 0.25, 0.5], wavelength=0.5, f_number=4.0).round(3).tolist()  # half the cut-off in the middle
    [1.0, 0.391, 0.0]
    """
    nu = np.asarray(np.abs(frequency) * spot(wavelength, f_number))
    out = np.zeros(nu.shape, nu.dtype)
    inside = ~(nu >= 1.0)  # NaN stays in, and comes out as NaN
    out[inside] = _otf(nu[inside])
    return out[()]


def cutoff_frequency(wavelength: Floats, f_number: Floats) -> Floats:
    """Frequency (cycles/um) from which a diffraction-limited lens passes nothing, 1/(lambda N)."""
    return 1.0 / spot(wavelength, f_number)


def airy_diameter(wavelength: Floats, f_number: Floats) -> Floats:
    """Diameter (um) of the first dark ring, 2.4393... lambda N; seed paper eq. 4 rounds it to 2.44."""
    return AIRY_DIAMETER * spot(wavelength, f_number)


def rayleigh_separation(wavelength: Floats, f_number: Floats) -> Floats:
    """Distance (um) of two spots one of which sits on the other's first dark ring, 1.2196... lambda N."""
    return RAYLEIGH * spot(wavelength, f_number)


def sparrow_separation(wavelength: Floats, f_number: Floats) -> Floats:
    """Distance (um) at which the dip between two equal incoherent spots disappears, 0.9471... lambda N."""
    return SPARROW * spot(wavelength, f_number)


def pixel_airy(row: Floats, column: Floats, pitch: float, wavelength: float, f_number: float) -> FloatArray:
    """Share of an Airy spot's energy that falls on one square pixel, the spot centred on pixel (0, 0).

    Parameters
    ----------
    row, column : (...) array of whole numbers, pixel
        Which pixel; broadcast against each other.
    pitch : float, um
        Side of the pixel, which is sensitive all over; above 0.
    wavelength, f_number : float, um and 1
        Above 0.

    Returns
    -------
    (...) array of float64, 1
        Sums to 1 over the infinite plane.

    Raises
    ------
    ValueError
        For row or column that is not whole, and for pitch, wavelength or f-number not above 0.

    Notes
    -----
    The energy in a sector of angle dphi that ends at radius R is the encircled energy times dphi/(2 pi), so
    the share is that quantity integrated along the pixel's outline, dphi = d ds / (d^2 + s^2) along an edge
    at distance d. Far from the centre the energy outside R takes its place (round a closed outline the
    difference is 1 or 0: whether the centre is inside), which keeps the digits of faint pixels.
    Gauss-Legendre on every edge, with nodes in proportion to pitch/(lambda N).
    Error: below 1e-15 absolute, and for pixels wider than a dark ring (pitch/(lambda N) of 1 and above: every camera at
    f/1) below 1e-14 + 2e-15 x the distance in pixels relative, a rounding of the four edges, which exceed their sum by
    as much: 2e-14 at 39 pixels, 4e-13 at 1000, 1e-10 at 100 000 (21 pixels against 25 digits, pitch/(lambda N) from 1
    to 40). Narrower ones the same but on a dark ring, where relative errors mean nothing; 3e-11 for 2e-9 of the energy,
    from 0.003 on and up to 39 rows and columns away.
    """
    scale = np.pi * pitch / spot(wavelength, f_number)
    require.positive("pitch", pitch, " um")
    row, column = np.broadcast_arrays(np.abs(np.asarray(row, float)), np.abs(np.asarray(column, float)))
    if not (np.all(row == np.rint(row)) and np.all(column == np.rint(column))):
        raise ValueError(f"row is {row} and column is {column}; they must be whole numbers of pixels")
    # eight pixels share a value; the far one of row and column comes first
    pairs = np.stack([np.maximum(row, column).ravel(), np.minimum(row, column).ravel()])
    distinct, back = np.unique(pairs, axis=1, return_inverse=True)
    return _pixel_energy(distinct[0], distinct[1], scale)[back].reshape(row.shape)[()]


def two_point_saddle(separation: Floats) -> tuple[Floats, Floats]:
    """How deep the dip is between two equal incoherent Airy spots.

    Parameters
    ----------
    separation : (...) array, lambda/NA
        Distance of the two spots, 0 or above. lambda/NA is 2 lambda N.

    Returns
    -------
    ratio : (...) array, 1
        Brightness midway over the brightness of a peak; exactly 1 where the two have merged.
    offset : (...) array, lambda/NA
        Distance of a peak from the midpoint, exactly 0 where the two have merged.

    Raises
    ------
    ValueError
        For a negative or NaN separation.

    Notes
    -----
    Source: seed paper figure 2; the merging point is Sparrow's, 0.4735776 lambda/NA. The peak
    is where 8 J1 J2 / v^2 of one spot balances that of the other, by bisection to the last bit.
    Error: below 1e-15 for the ratio; for the offset 1e-15 times its sensitivity to the separation s, which is
    s / (2 (s - Sparrow's)) close to Sparrow's separation.
    """
    separation = np.asarray(separation, float)
    require.must(separation >= 0.0, "separation", separation, "0 or above")
    half = np.pi * separation
    merged = 2.0 * separation <= SPARROW
    # one sign change of the slope between the bounds: at most 1 inwards of a spot once the two stand apart
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
    """lambda N in um, a plain float where it is a scalar so that float32 arrays stay float32."""
    require.positive("wavelength", wavelength, " um")
    require.positive("f_number", f_number)
    product = np.asarray(wavelength) * f_number
    return product if product.ndim else float(product)


def _argument(r: Floats, wavelength: Floats, f_number: Floats) -> Floats:
    return np.abs(r) * (np.pi / spot(wavelength, f_number))


def _pixel_energy(row: FloatArray, column: FloatArray, scale: float) -> FloatArray:
    """`pixel_airy` for one row of pixels, scale being v per pixel."""
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
    # half the node spacing over the full turn; the centre pixel holds everything that is not outside
    inside = (row == 0.0) & (column == 0.0) & ~near
    return inside + total / (4.0 * np.pi)


def _otf(nu: FloatArray) -> FloatArray:
    """Inside the cut-off only, (n,): in blocks that stay in a core's cache, the series only where it is needed."""
    out = np.empty_like(nu)
    for start in range(0, nu.size, _BLOCK):
        block = nu[start : start + _BLOCK]
        angle = np.arccos(block)
        found = (2.0 / np.pi) * (angle - block * np.sqrt((1.0 - block) * (1.0 + block)))
        near = angle < 0.5
        y = 2.0 * angle[near]
        square = y * y
        # (y - sin y)/pi; the terms left out are below 1e-17 of it for y < 1.04
        found[near] = y * square * airy.horner(_SINE_SERIES, square) / np.pi
        found[block == 0.0] = 1.0
        out[start : start + _BLOCK] = found
    return out
