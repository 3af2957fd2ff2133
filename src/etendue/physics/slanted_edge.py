"""Spatial frequency response from the picture of one slanted edge.

In:  a linear picture (y, x) with one nearly straight edge at any angle but those of the pixel raster.
Out: frequencies along the edge's normal (cycles/pixel), response, MTF50 with flags, angle and place of the edge.
Sources: ISO 12233:2023 (e-SFR); its bins of a quarter pixel are replaced by a least-squares spline, see `slanted_edge`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, solveh_banded
from scipy.special import sici

FloatArray = NDArray[np.float64]
DEGREE = 3
ROUNDS = 30
STILL = 1e-5  # pixels of movement at the ends of the edge below which its line is found
ENOUGH = 4  # pixels in every interval between knots
COARSER, WIDEST_KNOT = (1, 1.25, 1.5, 1.75, 2), 0.5  # knots where the pixels lie at few distances
SMALLEST = 32
FAINTEST = 2.0  # step of an edge over the noise of a pixel
NEAR = 16.0  # pixels from the edge that say where it is
NYQUIST = 0.5


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
    knot: float  # spacing of the spline's knots
    half_width: float  # how far from the edge the picture itself was used, behind which only plateau and tail were
    residual: float  # rms of the picture about the fitted edge, of the step: noise, texture, curvature

    @property
    def mtf50_limited(self) -> float:
        """MTF50, but at most the Nyquist frequency."""
        return NYQUIST if self.not_reached else min(self.mtf50, NYQUIST)


def slanted_edge(
    picture: ArrayLike,
    *,
    order: int = 1,
    knots_per_pixel: float = 4.0,
    half_width: float | None = None,
    tails: bool = True,
    highest: float = 1.0,
    samples: int = 201,
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
    response within 1e-3 below 0.5 cycles/pixel; ``python benchmarks/slanted_edge.py`` prints it. With noise of 1 % of the
    step, 0.8 % rms of the MTF50; its noise may be a tenth of the step.
    """
    image = np.asarray(picture, np.float64)
    _check(image, order, knots_per_pixel, half_width, highest, samples)
    vertical, line = _first_line(image)
    u_image = image if vertical else image.T
    rows, columns = u_image.shape
    v = np.linspace(-1.0, 1.0, rows)
    across = np.arange(columns) - 0.5 * (columns - 1)
    coefficients = np.zeros(order + 1)
    coefficients[:2] = line
    knot = 1 / knots_per_pixel
    for _ in range(ROUNDS):
        distance = _distances(coefficients, v, across, rows)
        fit = _fit(distance, u_image, knot, min(half_width or NEAR, NEAR))
        step, doubt = _movement(fit, v, coefficients, rows)
        coefficients = coefficients + step
        if np.all(np.abs(step) < np.maximum(STILL, 0.25 * doubt)):  # of its turn and bend: a shift is the spline's to follow
            break
    else:
        raise ValueError(_lost("its line could not be found"))
    curve = _whole(_fit(_distances(coefficients, v, across, rows), u_image, knot, half_width), half_width, tails)
    frequency = np.linspace(0.0, highest, samples)
    sfr = curve.response(frequency)
    mtf50 = _half(curve, frequency, sfr)
    slope = coefficients[1] * 2 / max(rows - 1, 1)
    low, high = sorted((curve.low, curve.high))
    return EdgeResponse(
        frequency, sfr, mtf50,
        above_nyquist=bool(mtf50 > NYQUIST),
        not_reached=math.isnan(mtf50),
        angle=math.degrees(math.atan(slope)),
        vertical=vertical,
        place=float(coefficients[0] + curve.middle() * math.hypot(1.0, slope) + 0.5 * (columns - 1)),
        contrast=float((high - low) / (high + low)) if high + low > 0 else math.nan,
        knot=curve.knot,
        residual=curve.noise / (high - low),
        half_width=curve.width,
    )  # fmt: skip


def _check(image: FloatArray, order: int, knots_per_pixel: float, half_width: float | None, highest: float, samples: int) -> None:
    if image.ndim != 2 or min(image.shape, default=0) < SMALLEST:
        raise ValueError(f"picture has shape {image.shape}; allowed is (y, x) of at least {SMALLEST} x {SMALLEST}")
    if not np.isfinite(image).all():
        raise ValueError("picture holds values that are no numbers")
    if not 1 <= order <= 5:
        raise ValueError(f"order is {order}; allowed is 1 to 5")
    if not 1 <= knots_per_pixel <= 16:
        raise ValueError(f"knots_per_pixel is {knots_per_pixel}; allowed is 1 to 16")
    if half_width is not None and not half_width >= 4:
        raise ValueError(f"half_width is {half_width}; allowed is at least 4")
    if not 0 < highest <= 0.5 * knots_per_pixel:
        raise ValueError(f"highest is {highest}; allowed is above 0 and at most half of knots_per_pixel, {0.5 * knots_per_pixel:g}")
    if samples < 3:
        raise ValueError(f"samples is {samples}; allowed is at least 3")


def _lost(why: str) -> str:
    return (
        f"picture shows no edge that can be measured: {why}; allowed is one edge between two even fields, 2 to 43 degrees away "
        "from rows and columns"
    )


# -- the line ---------------------------------------------------------------------------------------------------


def _first_line(image: FloatArray) -> tuple[bool, FloatArray]:
    """Whether the edge is nearer to a column, and its place at v = 0 and change to v = 1, from the squared gradient."""
    gy, gx = np.gradient(_smooth(image))
    weight = gx**2 + gy**2
    most = np.partition(weight.ravel(), -max(weight.shape))[-max(weight.shape)]  # as many strong pixels as the edge is long
    if not most > 0:
        raise ValueError(_lost("it is even all over"))
    weight = np.where(weight > 0.2 * most, weight, 0.0)
    vertical = bool((weight * gx**2).sum() >= (weight * gy**2).sum())
    if not vertical:
        weight = weight.T
    rows, columns = weight.shape
    v = np.linspace(-1.0, 1.0, rows)
    u = np.arange(columns) - 0.5 * (columns - 1)
    total = weight.sum()
    mean_v, mean_u = (weight.sum(1) @ v) / total, (weight.sum(0) @ u) / total
    spread = weight.sum(1) @ (v - mean_v) ** 2
    if not spread > 0:
        raise ValueError(_lost("it stands in one row"))
    slope = float((v - mean_v) @ weight @ (u - mean_u) / spread)
    return vertical, np.array([mean_u - slope * mean_v, slope])


def _smooth(image: FloatArray) -> FloatArray:
    """A mean over 3 x 3 pixels, borders repeated."""
    for axis in (0, 1):
        padded = np.concatenate([image.take([0], axis), image, image.take([-1], axis)], axis)
        size = image.shape[axis]
        image = sum(padded.take(range(i, i + size), axis) for i in range(3)) / 3  # type: ignore[assignment]
    return image


def _distances(coefficients: FloatArray, v: FloatArray, across: FloatArray, rows: int) -> FloatArray:
    """Signed distance of every pixel from the edge, along its normal, pixels."""
    polynomial = np.polynomial.polynomial
    slope = polynomial.polyval(v, polynomial.polyder(coefficients)) * 2 / max(rows - 1, 1)
    return (across[None, :] - polynomial.polyval(v, coefficients)[:, None]) / np.sqrt(1 + slope**2)[:, None]


def _movement(fit: _Fit, v: FloatArray, coefficients: FloatArray, rows: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Newton step of the polynomial, what moves the fitted edge onto the picture, and its standard error."""
    polynomial = np.polynomial.polynomial
    slope = (polynomial.polyval(v, polynomial.polyder(coefficients)) * 2 / max(rows - 1, 1))[fit.row]
    own = v[fit.row]
    normal = np.sqrt(1 + slope**2)
    k = np.arange(len(coefficients))
    change = -(own[:, None] ** k) / normal[:, None]
    turned = k * own[:, None] ** np.maximum(k - 1, 0) * 2 / max(rows - 1, 1)
    change = change - (fit.distance * slope / normal**2)[:, None] * turned
    design = change * fit.steep[:, None]
    step = np.linalg.lstsq(design, fit.rest, rcond=None)[0]
    doubt = np.sqrt(np.mean(fit.rest**2) * np.abs(np.diag(np.linalg.pinv(design.T @ design))))
    step[0] = 0.0
    return step, doubt


# -- the edge spread function ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Fit:
    """A cubic spline on uniform knots about distance 0, through the values by distance."""

    coefficients: FloatArray
    knot: float
    distance: FloatArray  # of the pixels used
    row: NDArray[np.intp]
    value: FloatArray
    rest: FloatArray  # value less spline
    steep: FloatArray  # derivative of the spline at the pixels


@dataclass(frozen=True)
class _Curve:
    """The whole edge spread function: coefficients of a cubic spline about distance 0, plateaus with tails beyond."""

    coefficients: FloatArray
    knot: float
    low: float  # the plateaus, at negative and at positive distance
    high: float
    spread: float  # k of plateau -+ k/|d|
    width: float
    noise: float  # rms of a pixel about the curve

    @property
    def places(self) -> FloatArray:
        return np.asarray((np.arange(len(self.coefficients)) - 0.5 * (len(self.coefficients) - 1)) * self.knot, np.float64)

    def response(self, frequency: FloatArray) -> FloatArray:
        """|Fourier transform of the derivative|, 1 at zero.

        That of the spline is the transform of its coefficients' differences times that of a quadratic B-spline; behind
        its ends the derivative is ``spread``/d^2.
        """
        steps = np.diff(self.coefficients, prepend=self.low + self._tail, append=self.high - self._tail)
        ends = self.places[-1] + 0.5 * self.knot
        places = np.linspace(-ends, ends, len(steps))
        phase = 2 * np.pi * frequency
        beyond = 2 * self.spread * (np.cos(phase * ends) / ends - phase * (0.5 * np.pi - sici(phase * ends)[0]))
        within = np.exp(-1j * phase[:, None] * places) @ steps * np.sinc(frequency * self.knot) ** DEGREE
        return np.asarray(np.abs(within + beyond) / abs(self.high - self.low), np.float64)

    @property
    def _tail(self) -> float:
        """What is still to come behind the ends."""
        return self.spread / (self.places[-1] + 0.5 * self.knot)

    def middle(self) -> float:
        """Distance at which the spline has half its step, from its values at the knots."""
        values = (self.coefficients[:-2] + 4 * self.coefficients[1:-1] + self.coefficients[2:]) / 6
        share = (values - self.low) / (self.high - self.low)
        at = max(int(np.argmax(share >= 0.5)), 1)
        return (at - 1 + (0.5 - share[at - 1]) / (share[at] - share[at - 1]) - 0.5 * (len(values) - 1)) * self.knot


def _whole(fit: _Fit, half_width: float | None, tails: bool) -> _Curve:
    """Spline near the edge, plateaus with tails far from it, and a smooth passage between them.

    Where the picture says no more than the tails do, it only brings its noise along: the passage ends at the smallest
    of some distances behind which the tails describe the pixels no worse than the spline does.
    """
    reach = float(np.abs(fit.distance).max())
    noise = float(np.sqrt((fit.rest**2).sum() / max(fit.rest.size - len(fit.coefficients), 1)))
    width = reach
    candidates = [reach] if half_width else [w for w in (16.0 * 2 ** (0.5 * i) for i in range(40)) if w < reach]
    for width in [*candidates, reach]:
        outer = np.abs(fit.distance) > 0.5 * width
        model, rest = _plateaus(fit.distance[outer], fit.value[outer], tails)
        if np.mean(rest**2) < noise**2 * (1 + 3 * math.sqrt(2 / rest.size)):
            break
    low, high, spread = model
    if not abs(high - low) > FAINTEST * noise:
        raise ValueError(_lost("its step is lost in noise"))
    places = (np.arange(len(fit.coefficients)) - 0.5 * (len(fit.coefficients) - 1)) * fit.knot
    kept = np.abs(places) <= width
    places = places[kept]
    share = 0.5 + 0.5 * np.cos(np.pi * np.clip(2 * np.abs(places) / width - 1, 0, 1))
    far = np.where(places < 0, low, high) - spread / np.where(np.abs(places) < fit.knot, fit.knot, places)
    return _Curve(share * fit.coefficients[kept] + (1 - share) * far, fit.knot, low, high, spread, float(width), noise)


def _plateaus(distance: FloatArray, value: FloatArray, tails: bool) -> tuple[tuple[float, float, float], FloatArray]:
    """Plateaus at negative and positive distance and k of -k/d (light that a lens throws far), and what they leave."""
    columns = [distance < 0, distance > 0, *([-1 / distance] if tails else [])]
    design = np.stack(columns, axis=1).astype(float)
    found = np.linalg.lstsq(design, value, rcond=None)[0]
    return (float(found[0]), float(found[1]), float(found[2]) if tails else 0.0), value - design @ found


def _fit(distance: FloatArray, values: FloatArray, knot: float, half_width: float | None) -> _Fit:
    """Least squares over the widest stretch about the edge in which every interval between knots holds pixels enough."""
    limit = min(half_width or math.inf, float(-distance.min()), float(distance.max()))
    row, column = np.nonzero(np.abs(distance) < limit)
    flat, found = distance[row, column], values[row, column]
    for spacing in (knot * f for f in COARSER if knot * f <= WIDEST_KNOT or f == 1):
        half = _filled(flat, limit, spacing)
        if half * spacing >= min(4.0, 0.9 * limit):
            break
    else:
        raise ValueError(_lost("its pixels lie at too few distances from it"))
    inside = np.abs(flat) < half * spacing
    flat, found, row = flat[inside], found[inside], row[inside]
    place = flat / spacing + half
    first = np.minimum(place.astype(np.intp), 2 * half - 1)
    t = place - first
    size = 2 * half + DEGREE
    basis = np.stack([(1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3]) / 6
    band, right = np.zeros((DEGREE + 1, size)), np.zeros(size)
    for a in range(DEGREE + 1):
        right += np.bincount(first + a, basis[a] * found, size)
        for b in range(a, DEGREE + 1):
            band[b - a] += np.bincount(first + a, basis[a] * basis[b], size)
    try:
        c = solveh_banded(band, right, lower=True)
    except LinAlgError:
        raise ValueError(_lost("its pixels lie at too few distances from it")) from None
    slopes = np.stack([-((1 - t) ** 2), -4 * t + 3 * t**2, 1 + 2 * t - 3 * t**2, t**2]) / (2 * spacing)
    weights = c[first + np.arange(DEGREE + 1)[:, None]]
    return _Fit(c, spacing, flat, row, found, found - (weights * basis).sum(0), (weights * slopes).sum(0))


def _filled(distance: FloatArray, limit: float, spacing: float) -> int:
    """Intervals on either side of 0 up to which all hold `ENOUGH` pixels."""
    most = int(limit / spacing)
    inside = distance[np.abs(distance) < most * spacing]
    counts = np.bincount(np.minimum((inside / spacing + most).astype(np.intp), 2 * most - 1), minlength=2 * most)
    poor = np.flatnonzero(counts < ENOUGH) - most
    return int(min(most, np.where(poor < 0, -poor - 1, poor).min(initial=most)))


def _half(curve: _Curve, frequency: FloatArray, sfr: FloatArray) -> float:
    """Lowest frequency of half contrast: bracketed on the samples, then halved to 1e-12."""
    below = np.flatnonzero(sfr < 0.5)
    if below.size == 0:
        return math.nan
    low, high = float(frequency[below[0] - 1]), float(frequency[below[0]])
    for _ in range(40):
        middle = 0.5 * (low + high)
        if curve.response(np.array([middle]))[0] >= 0.5:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)
