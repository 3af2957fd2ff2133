"""Transfer functions of real lenses: a Gaussian blur, a radial PSF table, a measured image of a point.

In:  spatial frequencies (cycles/um); blur widths, radii and sample spacings (um); the point spread function.
Out: transfer functions, 1 at zero frequency: real where the blur is symmetric, complex for an image.
Sources: the Fourier and Hankel transforms (Goodman, Introduction to Fourier Optics, sections 2.1 and 2.3).
PSF_lens of the paper (docs/paper.md, eq. 1) comes from an optical design program. Such programs, and measurements,
export a table or an image of a point.
"""

from math import pi, sqrt

import numpy as np
import scipy

from etendue import require
from etendue_camera.arrays import FloatArray, Floats

_BLOCK = 2**20  # elements of a block of frequencies x radii, 8 MB


def gaussian_otf(fy: FloatArray, fx: FloatArray, sigma: float) -> FloatArray:
    """Return the transfer function of a round Gaussian blur, exp(-2 pi^2 sigma^2 (fy^2 + fx^2)).

    Parameters
    ----------
    fy, fx : arrays that broadcast, cycles/um
        Shapes (ny, 1) and (1, nx) need only ny + nx exponentials.
    sigma : float, um
        Standard deviation along each axis, 0 or above.

    Returns
    -------
    broadcast array, 1
        In [0, 1]; exactly 1 everywhere for sigma = 0.

    Raises
    ------
    ValueError
        For a negative, infinite or NaN sigma.

    Notes
    -----
    Error: 2e-16 max(1, 2 pi^2 sigma^2 f^2) relative, the sensitivity to the inputs.
    """
    require.must(0.0 <= sigma < np.inf, "sigma", sigma, "finite and 0 or above, in um")
    scale = sqrt(2.0) * pi * float(sigma)  # a plain float keeps float32 arrays float32
    return np.exp(-((scale * fy) ** 2)) * np.exp(-((scale * fx) ** 2))


def mean_square_radius(radius: FloatArray, psf: FloatArray) -> float:
    """Return the mean squared radius (um^2) of a round point spread function, weighted by its absolute values.

    Parameters
    ----------
    radius : (n,) array, um
    psf : (n,) array, any unit per area
        As for `radial_psf_otf`.

    Notes
    -----
    2 pi^2 times the result bounds the second derivative of the transfer function with respect to frequency, because the
    second derivative of J0 is at most 1/2. Between radii the integrands are polynomials, for which four Gauss points
    are exact.
    """
    nodes, weights = scipy.special.roots_legendre(4)
    half = 0.5 * np.diff(radius)[:, None]
    r = radius[:-1, None] + half * (1.0 + nodes)
    share = half * weights * r
    own = np.interp(r.ravel(), radius, psf).reshape(r.shape)
    return float(np.sum(share * np.abs(own) * r * r) / abs(np.sum(share * own)))


def radial_psf_otf(frequency: Floats, radius: FloatArray, psf: FloatArray) -> Floats:
    """Return the transfer function of a round point spread function given as a table.

    Parameters
    ----------
    frequency : (...) array, cycles/um
        Radial spatial frequency; the sign does not matter.
    radius : (n,) array, um
        At least two values, ascending from 0; they need not be evenly spaced.
    psf : (n,) array, any unit per area
        Interpolated linearly between the radii, zero beyond the last. Its scale cancels.

    Returns
    -------
    (...) array, 1
        Exactly 1 at zero frequency.

    Raises
    ------
    ValueError
        For radii that do not start at 0 or do not ascend, lengths that differ, values that are not finite, or a total
        energy that is not above 0.

    Notes
    -----
    Source: Hankel transform of order zero, the integral of psf J0(2 pi f r) r dr over the integral of psf r dr. The
    number of Gauss points per interval of the table grows with the highest frequency. Many frequencies (a grid) are
    interpolated from a Chebyshev series in f, which converges to rounding because the table has a finite extent. Error:
    below 3e-15 absolute for the piecewise linear function, for up to 100 cycles over the table. The table itself
    deviates from the true function by up to one eighth of its spacing squared times the second derivative.
    """
    frequency = np.asarray(frequency)
    if not np.issubdtype(frequency.dtype, np.floating):
        frequency = frequency.astype(float)
    nodes, weights = _table_quadrature(radius, psf, float(np.max(np.abs(frequency), initial=0.0)))
    flat = np.abs(frequency).ravel().astype(float)
    highest = flat.max(initial=0.0)
    # an entire function of exponential type 2 pi R needs degree pi R f_max, plus a margin for the last digits
    degree = int(np.ceil(np.pi * nodes[-1] * highest)) + 40
    if flat.size <= 2 * degree:
        values = _hankel(flat, nodes, weights)
    else:
        angles = np.pi * (np.arange(degree) + 0.5) / degree
        samples = _hankel(0.5 * highest * (1.0 + np.cos(angles)), nodes, weights)
        series = scipy.fft.dct(samples, type=2) / degree
        series[0] *= 0.5
        values = np.polynomial.chebyshev.chebval(2.0 * flat / highest - 1.0, series) if highest else flat
    values = np.where(flat == 0.0, 1.0, values)
    return values.reshape(frequency.shape).astype(frequency.dtype, copy=False)[()]


def _table_quadrature(radius: FloatArray, psf: FloatArray, highest: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights of the integral of psf r dr, fine enough for frequencies up to ``highest``."""
    radius, psf = np.asarray(radius, float), np.asarray(psf, float)
    require.that(
        radius.ndim == 1 and radius.shape == psf.shape and radius.size >= 2,
        f"radius has shape {radius.shape} and psf {psf.shape}; they must be one-dimensional, of equal length, and "
        f"hold at least two samples",
    )
    steps = np.diff(radius)
    require.that(
        radius[0] == 0.0 and np.all(steps > 0.0) and np.all(np.isfinite(radius)),
        "radius must start at 0 um and grow from sample to sample",
    )
    require.that(np.all(np.isfinite(psf)), "psf must be finite at every radius")
    count = 6 + int(np.ceil(np.pi * highest * steps.max()))
    x, w = scipy.special.roots_legendre(count)
    share = 0.5 * (1.0 + x)
    nodes = radius[:-1, None] + steps[:, None] * share
    values = psf[:-1, None] * (1.0 - share) + psf[1:, None] * share
    weights = 0.5 * steps[:, None] * w * values * nodes
    total = np.sum(weights)
    if not total > 0.0:
        raise ValueError(f"psf holds a total energy of {2 * np.pi * total}; it must be above 0")
    return nodes.ravel(), (weights / total).ravel()


def _hankel(frequency: FloatArray, nodes: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the sum of weights J0(2 pi f r), computed in blocks to bound memory."""
    rows = max(1, _BLOCK // nodes.size)
    blocks = np.array_split(frequency, range(rows, frequency.size, rows))
    return np.concatenate([scipy.special.j0(np.outer(2.0 * np.pi * block, nodes)) @ weights for block in blocks])
