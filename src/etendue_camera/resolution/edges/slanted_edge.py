"""Spatial frequency response from the picture of one slanted edge.

In:  a linear picture (y, x) with one nearly straight edge at any angle but those of the pixel raster.
Out: frequencies along the edge's normal (cycles/pixel), response, MTF50 with flags, angle and place of the edge.
Sources: ISO 12233:2023 (e-SFR); its bins of a quarter pixel are replaced by a least-squares spline, see `slanted_edge`,
and stand beside it as ``method="iso"``.
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
STILL = 1e-5  # pixels of movement at the ends of the edge below which its line is found
SMALLEST = 32
NEAR = 16.0  # pixels from the edge that say where it is
NYQUIST = 0.5
EXACT = 1e-12  # cycles/pixel, of a crossing


@dataclass(frozen=True)
class EdgeResponse:
    """What one edge says. Frequencies in cycles/pixel along the normal of the edge, lengths in pixels."""

    frequency: FloatArray
    sfr: FloatArray  # 1 at zero frequency, not negative
    mtf50: float  # NaN where it is not reached
    above_nyquist: bool  # half contrast lies above 0.5 cycles/pixel: what is finer has folded back
    not_reached: bool  # the response stays above one half up to the highest frequency
    angle: float  # degrees between the edge and the nearer axis of the raster, -45 to 45
    vertical: bool  # that axis is y: the edge is nearer to a column than to a row
    place: float  # along the other axis, where the edge crosses the middle of the picture, pixels from the first
    contrast: float  # (bright - dark) / (bright + dark)
    knot: float  # spacing of the spline's knots, or of the bins
    half_width: float  # how far from the edge the picture itself was used, behind which only plateau and tail were
    residual: float  # rms of the picture about the fitted edge, of the step: noise, texture, curvature
    mtf10: float = math.nan  # NaN where it is not reached
    mtf_nyquist: float = math.nan  # the response at 0.5 cycles/pixel
    rise: float = math.nan  # distance from 10 to 90 % of the step
    aliasing: float = (
        math.nan
    )  # share of the energy of the line spread up to ``highest`` that lies above 0.5 cycles/pixel

    @property
    def mtf50_limited(self) -> float:
        """MTF50, but at most the Nyquist frequency."""
        return NYQUIST if self.not_reached else min(self.mtf50, NYQUIST)


@dataclass(frozen=True)
class MeasuredEdge:
    """What stands behind a response by the spline: enough to measure again with other noise."""

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
    """Measure the response of whatever made a picture of an edge.

    Parameters
    ----------
    picture : (y, x) array, any linear unit
        One edge between two even fields, dark on any side. At least 32 x 32.
    order : int
        Degree of the polynomial that the edge follows, 1 (straight) to 5 (bent by distortion).
    knots_per_pixel : float
        Of the spline, along the normal, 1 to 16. Fewer are taken where the angle puts all pixels at few distances.
    half_width : float or None, pixels
        Only pixels so near to the edge are used; None: as far as they say more than plateaus do. At least 4.
    tails : bool
        Whether light beyond ``half_width`` is extrapolated from the outer halves of the fields, as 1/distance^2.
    highest : float, cycles/pixel
        Last frequency, above 0 and at most 0.5 ``knots_per_pixel``.
    samples : int
        Frequencies from 0 to ``highest``, at least 3.
    method : {"spline", "iso"}
        ``"iso"``: bins of a quarter pixel as in the standard, with its corrections; `edge_bins.binned` has each of them
        as an option. ``knots_per_pixel`` and ``tails`` say nothing then.
    sites : (y, x) array of bool or None
        The pixels to use, such as those of one colour of a mosaic; None: all. Frequencies stay in cycles per pixel of
        the picture.

    Returns
    -------
    EdgeResponse

    Raises
    ------
    ValueError
        Arguments out of range; no edge to be seen; an edge along a row, a column or a diagonal, whose pixels lie at
        too few distances from it.

    Notes
    -----
    The steps are those of ISO 12233, each made exact. (1) The line of the edge starts from the moments of the squared
    gradient and is refined by Gauss-Newton on the picture itself. (2) Pixels are projected along the edge: their
    distances d from the line hold the cosine of the slope. (3) Instead of a mean by bin, a cubic spline with uniform
    knots is fitted to all (d, value) by least squares, so that uneven filling of bins and their averaging leave no
    trace: the error of the fit in the response is of the order (f/knots_per_pixel)^8. (4) The derivative is that of
    the spline and its Fourier transform is a closed form, so that no derivative filter needs correction.

    What is measured is the transfer function of everything in front of the sampling, pixel aperture included, also
    beyond 0.5 cycles/pixel: sampling along a slant is fine enough not to fold. Light that a lens spreads farther than
    ``half_width`` w would be missed, s/(pi^2 w) of it for an MTF of slope -s at zero; ``tails`` puts it back. Uneven
    lighting of the fields is mistaken for such light: then say ``tails=False``. Far from the edge the picture brings
    nothing but its noise: it gives way to plateaus and tails where these describe it as well.

    Error, noise-free, 200 x 400 pixels, 2 to 40 degrees, Gaussians and diffraction with a pixel: MTF50 within 0.05 %,
    response within 1e-3 below 0.5 cycles/pixel; ``python benchmarks/slanted_edge.py`` prints it. With noise of 1 % of
    the step, 0.8 % rms of the MTF50; its noise may be a tenth of the step. ``method="iso"`` on the same pictures: -4 to
    5 % of MTF50 (``python benchmarks/resolution.py``).
    """
    image, mask = checked(picture, sites)
    check(order, knots_per_pixel, half_width, highest, samples, method)
    if method == "iso":
        if mask is not None:
            raise ValueError("sites is given with method 'iso', whose rows must be whole; allowed is method 'spline'")
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
    """The line and the edge spread function of a picture by the spline; arguments as `slanted_edge` has checked
    them.
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
        damping *= 0.5 if step @ last < 0 else 1.0  # pixels that come and go with the line can make it swing
        step, last = damping * step, step
        coefficients = coefficients + step
        if np.all(
            np.abs(step) < np.maximum(STILL, 0.25 * doubt)
        ):  # of its turn and bend: a shift is the spline's to follow
            break
    else:
        raise ValueError(lost("its line could not be found"))
    final = fit(distances(coefficients, v, across, rows), u_image, knot, half_width, mask)
    return MeasuredEdge(final, whole(final, half_width, tails), coefficients, vertical, rows, columns)


def said(found: MeasuredEdge, highest: float, samples: int) -> EdgeResponse:
    """The figures of a measured edge."""
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
    """Share of the line spread's energy (Parseval: the integral of sfr^2) above 0.5 cycles/pixel; 0 where none is
    sampled.
    """
    power = sfr**2
    below = np.minimum(frequency, NYQUIST)
    part = np.trapezoid(np.interp(below, frequency, power), below)
    total = np.trapezoid(power, frequency)
    return float(max(0.0, 1 - part / total))


def _falls_to(curve: EdgeSpread | edge_bins.Binned, share: float, frequency: FloatArray, sfr: FloatArray) -> float:
    """Lowest frequency at which the response has fallen to a share: bracketed on the samples, then by Brent."""
    below = np.flatnonzero(sfr < share)
    if below.size == 0:
        return math.nan
    low, high = float(frequency[below[0] - 1]), float(frequency[below[0]])

    def above(at: float) -> float:
        return float(curve.response(np.array([at]))[0]) - share

    return low if above(low) <= 0 else float(scipy.optimize.brentq(above, low, high, xtol=EXACT))


def checked(picture: ArrayLike, sites: ArrayLike | None) -> tuple[FloatArray, Sites | None]:
    """The picture and its mask as arrays, or ValueError."""
    image = np.asarray(picture, np.float64)
    require.shape(
        image.ndim == 2 and min(image.shape, default=0) >= SMALLEST,
        "picture",
        image,
        f"(y, x) of at least {SMALLEST} x {SMALLEST}",
    )
    if sites is None:
        require.that(np.isfinite(image).all(), "picture holds values that are no numbers")
        return image, None
    mask = np.asarray(sites)
    require.that(
        mask.shape == image.shape and mask.dtype == np.bool_,
        f"sites has shape {mask.shape} and type {mask.dtype}; allowed is bool of the picture's shape {image.shape}",
    )
    require.that(np.isfinite(image[mask]).all(), "picture holds values that are no numbers")
    return image, mask


def check(
    order: int, knots_per_pixel: float, half_width: float | None, highest: float, samples: int, method: str = "spline"
) -> None:
    """ValueError for arguments out of range."""
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
