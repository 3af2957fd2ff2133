"""Spatial frequency response from a picture of one slanted edge.

In:  a linear picture (y, x) with one nearly straight edge at any angle except along pixel axes and diagonals.
Out: frequencies along the edge's normal (cycles/pixel), response, MTF50 with flags, angle and place of the edge.
Sources: ISO 12233:2023 (e-SFR); its quarter-pixel bins are replaced by a least-squares spline, see `slanted_edge`, and
available as ``method="iso"``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.resolution.edges import edge_bins
from etendue_camera.resolution.edges.edge_line import Sites, distances, first_line, lost, movement
from etendue_camera.resolution.edges.edge_spread import FAINTEST, EdgeSpread, Fit, fit, whole

METHODS = ("spline", "iso")
ROUNDS = 30
STILL = 1e-5  # tolerance of the line, pixels of movement at the ends of the edge
SMALLEST = 32
NEAR = 16.0  # pixels from the edge used to locate it
NYQUIST = 0.5
EXACT = 1e-12  # cycles/pixel, of a crossing


@dataclass(frozen=True)
class EdgeResponse:
    """Results of one edge. Frequencies in cycles/pixel along the normal of the edge, lengths in pixels."""

    frequency: FloatArray
    sfr: FloatArray  # 1 at zero frequency, not negative
    mtf50: float  # NaN if not reached
    above_nyquist: bool  # MTF50 is above 0.5 cycles/pixel: finer detail is aliased
    not_reached: bool  # the response stays above one half up to the highest frequency
    angle: float  # degrees between the edge and the nearer axis of the raster, -45 to 45
    vertical: bool  # that axis is y: the edge is nearer to a column than to a row
    place: float  # along the other axis, where the edge crosses the middle of the picture, pixels from the first
    contrast: float  # (bright - dark) / (bright + dark)
    knot: float  # spacing of the spline's knots, or of the bins
    half_width: float  # distance from the edge up to which the picture itself is used; beyond it, plateau and tail
    residual: float  # rms residual about the fitted edge, relative to the step: noise, texture, curvature
    mtf10: float = math.nan  # NaN if not reached
    mtf_nyquist: float = math.nan  # the response at 0.5 cycles/pixel
    rise: float = math.nan  # distance from 10 to 90 % of the step
    # share of the energy of the line spread up to ``highest`` that lies above 0.5 cycles/pixel
    aliasing: float = math.nan

    @property
    def mtf50_limited(self) -> float:
        """MTF50, capped at Nyquist."""
        return NYQUIST if self.not_reached else min(self.mtf50, NYQUIST)


@dataclass(frozen=True)
class MeasuredEdge:
    """The spline fit from which a response is computed: all data needed to measure again with other noise."""

    fit: Fit
    curve: EdgeSpread
    coefficients: FloatArray  # of the edge's polynomial, see `edge_line`
    vertical: bool
    rows: int
    columns: int


def slanted_edge(
    picture: ArrayLike,
    *,
    order: int = 1,
    knots_per_pixel: float = 4.0,
    half_width: float | None = None,
    tails: bool = True,
    highest: float = 1.0,
    samples: int = 201,
    method: str = "spline",
    sites: ArrayLike | None = None,
) -> EdgeResponse:
    """Measure the response of an imaging system from a picture of an edge.

    Parameters
    ----------
    picture : (y, x) array, any linear unit
        One edge between two uniform areas; the dark area may be on either side. At least 32 x 32.
    order : int
        Degree of the polynomial fitted to the edge, 1 (straight) to 5 (bent by distortion).
    knots_per_pixel : float
        Knots of the spline along the normal, 1 to 16. Fewer are used if the pixels are at few distances from the edge.
    half_width : float or None, pixels
        Only pixels within this distance of the edge are used; None: up to where plateaus and tails describe the picture
        equally well. At least 4.
    tails : bool
        Whether light beyond ``half_width`` is extrapolated from the outer halves of the areas, as 1/distance^2.
    highest : float, cycles/pixel
        Last frequency, above 0 and at most 0.5 ``knots_per_pixel``.
    samples : int
        Frequencies from 0 to ``highest``, at least 3.
    method : {"spline", "iso"}
        ``"iso"``: quarter-pixel bins as in the standard, with its corrections; each correction is an option of
        `edge_bins.binned`. ``knots_per_pixel`` and ``tails`` are then ignored.
    sites : (y, x) array of bool or None
        The pixels to use, such as all pixels of one colour of a mosaic; None: all. Frequencies stay in cycles per pixel
        of the picture.

    Returns
    -------
    EdgeResponse

    Raises
    ------
    ValueError
        If arguments are out of range; if there is no edge; if the edge is along a row, a column or a diagonal, whose
        pixels are at too few distances from it.

    Notes
    -----
    The steps follow ISO 12233, but each is made exact. (1) The line of the edge starts from the moments of the squared
    gradient and is refined by Gauss-Newton on the picture itself. (2) Pixels are projected along the edge: their
    distances d from the line include the cosine of the slope. (3) Instead of a mean by bin, a cubic spline with uniform
    knots is fitted to all (d, value) by least squares, so that uneven filling of bins and their averaging have no
    effect: the error of the fit in the response is of the order (f/knots_per_pixel)^8. (4) The spline is differentiated
    analytically and its Fourier transform is a closed form, so that no derivative filter needs correction.

    The result is the transfer function of everything before the sampling, including the pixel aperture, even above 0.5
    cycles/pixel: sampling along a slant is fine enough to avoid aliasing. Light that a lens spreads farther than
    ``half_width`` w would be missed (a fraction s/(pi^2 w) for an MTF of slope -s at zero); ``tails`` restores it.
    Non-uniform lighting of the areas looks like such light; use ``tails=False`` in that case. Far from the edge the
    picture adds only noise and is replaced by plateaus and tails where these describe it equally well.

    Error, noise-free, 200 x 400 pixels, 2 to 40 degrees, Gaussians and diffraction with a pixel: MTF50 within 0.05 %,
    response within 1e-3 below 0.5 cycles/pixel; ``python benchmarks/slanted_edge.py`` prints it. With noise of 1 % of
    the step: 0.8 % rms of the MTF50. Noise may reach a tenth of the step. ``method="iso"`` on the same pictures: -4 to
    5 % of MTF50 (``python benchmarks/resolution.py``).
    """
    image, mask = checked(picture, sites)
    check(order, knots_per_pixel, half_width, highest, samples, method)
    if method == "iso":
        if mask is not None:
            raise ValueError("sites is given with method 'iso', which needs complete rows; use method 'spline'")
        vertical, _ = first_line(image)
        turned = image if vertical else image.T
        coefficients, bins = edge_bins.binned(turned, order, half_width=half_width)
        if not abs(bins.high - bins.low) > FAINTEST * bins.noise:
            raise ValueError(lost("its step is lost in noise"))
        return _said(bins, bins.noise, coefficients, vertical, turned.shape, highest, samples)
    found = measured(image, mask, order=order, knots_per_pixel=knots_per_pixel, half_width=half_width, tails=tails)
    return said(found, highest, samples)


def measured(
    image: FloatArray, sites: Sites | None, *, order: int, knots_per_pixel: float, half_width: float | None, tails: bool
) -> MeasuredEdge:
    """Return the line and the edge spread function of a picture by the spline method; `slanted_edge` checks the
    arguments.
    """
    vertical, line = first_line(image, sites)
    u_image = image if vertical else image.T
    mask = sites if sites is None or vertical else sites.T
    rows, columns = u_image.shape
    v = np.linspace(-1.0, 1.0, rows)
    across = np.arange(columns) - 0.5 * (columns - 1)
    coefficients: FloatArray = np.zeros(order + 1)
    coefficients[:2] = line
    knot, damping = 1 / knots_per_pixel, 1.0
    last: FloatArray = np.zeros(order + 1)
    for _ in range(ROUNDS):
        distance = distances(coefficients, v, across, rows)
        near = fit(distance, u_image, knot, min(half_width or NEAR, NEAR), mask)
        step, doubt = movement(coefficients, v, rows, near.row, near.distance, near.rest, near.steep)
        damping *= 0.5 if step @ last < 0 else 1.0  # pixels that enter and leave with the line can make it oscillate
        step, last = damping * step, step
        coefficients = coefficients + step
        if np.all(np.abs(step) < np.maximum(STILL, 0.25 * doubt)):  # in rotation and bend: the spline follows a shift
            break
    else:
        raise ValueError(lost("the fit of its line did not converge"))
    final = fit(distances(coefficients, v, across, rows), u_image, knot, half_width, mask)
    return MeasuredEdge(final, whole(final, half_width, tails), coefficients, vertical, rows, columns)


def said(found: MeasuredEdge, highest: float, samples: int) -> EdgeResponse:
    """Return the metrics of a measured edge."""
    return _said(
        found.curve, found.fit.noise, found.coefficients, found.vertical, (found.rows, found.columns), highest, samples
    )


def _said(
    curve: EdgeSpread | edge_bins.Binned,
    noise: float,
    coefficients: FloatArray,
    vertical: bool,
    shape: tuple[int, ...],
    highest: float,
    samples: int,
) -> EdgeResponse:
    frequency = np.linspace(0.0, highest, samples)
    sfr = curve.response(frequency)
    mtf50 = _falls_to(curve, 0.5, frequency, sfr)
    slope = coefficients[1] * 2 / max(shape[0] - 1, 1)
    low, high = sorted((float(curve.low), float(curve.high)))
    return EdgeResponse(
        frequency,
        sfr,
        mtf50,
        above_nyquist=bool(mtf50 > NYQUIST),
        not_reached=math.isnan(mtf50),
        angle=math.degrees(math.atan(slope)),
        vertical=vertical,
        place=float(coefficients[0] + curve.crossing(0.5) * math.hypot(1.0, slope) + 0.5 * (shape[1] - 1)),
        contrast=float((high - low) / (high + low)) if high + low > 0 else math.nan,
        knot=curve.knot,
        residual=noise / (high - low),
        half_width=curve.width,
        mtf10=_falls_to(curve, 0.1, frequency, sfr),
        mtf_nyquist=float(curve.response(np.array([NYQUIST]))[0]),
        rise=curve.crossing(0.9) - curve.crossing(0.1),
        aliasing=folded(frequency, sfr),
    )


def folded(frequency: FloatArray, sfr: FloatArray) -> float:
    """Return the fraction of the line spread energy (Parseval: the integral of sfr^2) above 0.5 cycles/pixel; 0 if
    ``frequency`` ends below.
    """
    power = sfr**2
    below = np.minimum(frequency, NYQUIST)
    part = np.trapezoid(np.interp(below, frequency, power), below)
    total = np.trapezoid(power, frequency)
    return float(max(0.0, 1 - part / total))


def _falls_to(curve: EdgeSpread | edge_bins.Binned, share: float, frequency: FloatArray, sfr: FloatArray) -> float:
    """Return the lowest frequency at which the response has fallen to a level: bracketed on samples, then solved by
    Brent's method; NaN if it does not fall.
    """
    below = np.flatnonzero(sfr < share)
    if below.size == 0:
        return math.nan
    low, high = float(frequency[below[0] - 1]), float(frequency[below[0]])

    def above(at: float) -> float:
        return float(curve.response(np.array([at]))[0]) - share

    return low if above(low) <= 0 else float(scipy.optimize.brentq(above, low, high, xtol=EXACT))


def checked(picture: ArrayLike, sites: ArrayLike | None) -> tuple[FloatArray, Sites | None]:
    """Return picture and mask as arrays, or raise ValueError."""
    image = np.asarray(picture, np.float64)
    require.shape(
        image.ndim == 2 and min(image.shape, default=0) >= SMALLEST,
        "picture",
        image,
        f"(y, x) of at least {SMALLEST} x {SMALLEST}",
    )
    if sites is None:
        require.that(np.isfinite(image).all(), "picture contains NaN or infinite values")
        return image, None
    mask = np.asarray(sites)
    require.that(
        mask.shape == image.shape and mask.dtype == np.bool_,
        f"sites has shape {mask.shape} and type {mask.dtype}; it must be bool with the picture's shape {image.shape}",
    )
    require.that(np.isfinite(image[mask]).all(), "picture contains NaN or infinite values")
    return image, mask


def check(
    order: int, knots_per_pixel: float, half_width: float | None, highest: float, samples: int, method: str = "spline"
) -> None:
    """Raise ValueError for arguments out of range."""
    require.only(1 <= order <= 5, "order", order, "1 to 5")
    require.only(1 <= knots_per_pixel <= 16, "knots_per_pixel", knots_per_pixel, "1 to 16")
    require.only(half_width is None or half_width >= 4, "half_width", half_width, "at least 4")
    require.only(
        0 < highest <= 0.5 * knots_per_pixel,
        "highest",
        highest,
        f"above 0 and at most half of knots_per_pixel, {0.5 * knots_per_pixel:g}",
    )
    require.only(samples >= 3, "samples", samples, "at least 3")
    require.only(method in METHODS, "method", repr(method), f"one of {', '.join(METHODS)}")
