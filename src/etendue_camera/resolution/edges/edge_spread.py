"""The edge spread function: a least-squares spline through the pixels by distance, plateaus and tails far from the
edge.

In:  distance of every pixel from the edge (pixels), its value (any linear unit).
Out: a curve that is linear in the values, its Fourier transform in closed form, and its change with noise of the
values.
Sources: least squares with uniform cubic B-splines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue_camera.arrays import FloatArray
from etendue_camera.resolution.edges.edge_line import Sites, lost

DEGREE = 3
ENOUGH = 4  # minimum pixels in every interval between knots
COARSER, WIDEST_KNOT = (1, 1.25, 1.5, 1.75, 2), 0.5  # wider knots where pixels are at few distances
HALVINGS = 40
TOGETHER = 4.0  # pixels over which noise may be correlated
FAINTEST = 2.0  # minimum step of an edge over the noise of a pixel


@dataclass(frozen=True)
class Fit:
    """A cubic spline with uniform knots, fitted to the pixel values over their distance from the edge."""

    coefficients: FloatArray
    knot: float
    distance: FloatArray  # of the pixels used
    row: NDArray[np.intp]
    rest: FloatArray  # value minus spline
    value: FloatArray
    steep: FloatArray  # derivative of the spline at the pixels
    first: NDArray[np.intp]  # index of the first of the four coefficients that act at each pixel
    basis: FloatArray  # (4, pixels): their weights
    factor: FloatArray  # of the normal equations
    pixel: NDArray[np.intp]  # indices of the pixels in the flattened picture

    @property
    def noise(self) -> float:
        """Rms residual of a pixel about the spline, corrected for the degrees of freedom of the spline."""
        return float(np.sqrt((self.rest**2).sum() / max(self.rest.size - len(self.coefficients), 1)))

    def by_row(self, rows: int) -> FloatArray:
        """Return the contribution of each row's residuals to the right-hand side of the normal equations: (rows,
        coefficients).
        """
        size = len(self.coefficients)
        total = np.zeros(rows * size)
        for a in range(DEGREE + 1):
            total += np.bincount(self.row * size + self.first + a, self.basis[a] * self.rest, rows * size)
        return total.reshape(rows, size)


def fit(
    distance: FloatArray, values: FloatArray, knot: float, half_width: float | None, sites: Sites | None = None
) -> Fit:
    """Fit by least squares over the widest range about the edge where every interval between knots has enough pixels.

    ``distance`` and ``values`` are (rows, columns); only ``sites`` are used if given. Raises ValueError if the pixels
    are at too few distances.
    """
    limit = min(half_width or math.inf, float(-distance.min()), float(distance.max()))
    near = np.abs(distance) < limit
    row, column = np.nonzero(near if sites is None else near & sites)
    flat, found = distance[row, column], values[row, column]
    for spacing in (knot * f for f in COARSER if knot * f <= WIDEST_KNOT or f == 1):
        half = _filled(flat, limit, spacing)
        if half * spacing >= min(4.0, 0.9 * limit):
            break
    else:
        raise ValueError(lost("its pixels are at too few distances from it"))
    inside = np.abs(flat) < half * spacing
    flat, found, row, column = flat[inside], found[inside], row[inside], column[inside]
    place = flat / spacing + half
    first = np.minimum(place.astype(np.intp), 2 * half - 1)
    t = place - first
    size = 2 * half + DEGREE
    basis = cubic(t)
    band, right = np.zeros((DEGREE + 1, size)), np.zeros(size)
    for a in range(DEGREE + 1):
        right += np.bincount(first + a, basis[a] * found, size)
        for b in range(a, DEGREE + 1):
            band[b - a] += np.bincount(first + a, basis[a] * basis[b], size)
    try:
        factor = scipy.linalg.cholesky_banded(band, lower=True)
    except scipy.linalg.LinAlgError:
        raise ValueError(lost("its pixels are at too few distances from it")) from None
    c = scipy.linalg.cho_solve_banded((factor, True), right)
    slopes = np.stack([-((1 - t) ** 2), -4 * t + 3 * t**2, 1 + 2 * t - 3 * t**2, t**2]) / (2 * spacing)
    weights = c[first + np.arange(DEGREE + 1)[:, None]]
    rest = found - (weights * basis).sum(0)
    pixel = row * values.shape[1] + column
    return Fit(c, spacing, flat, row, rest, found, (weights * slopes).sum(0), first, basis, factor, pixel)


def _filled(distance: FloatArray, limit: float, spacing: float) -> int:
    """Return the number of intervals on either side of 0 up to which every interval has `ENOUGH` pixels."""
    most = int(limit / spacing)
    inside = distance[np.abs(distance) < most * spacing]
    counts = np.bincount(np.minimum((inside / spacing + most).astype(np.intp), 2 * most - 1), minlength=2 * most)
    poor = np.flatnonzero(counts < ENOUGH) - most
    return int(min(most, np.where(poor < 0, -poor - 1, poor).min(initial=most)))


@dataclass(frozen=True)
class EdgeSpread:
    """A complete edge spread function: a cubic spline about distance 0, and plateaus with tails beyond it.

    It may hold n functions: ``coefficients`` is then (n, coefficients), and the plateaus and the spread are (n,).
    """

    coefficients: FloatArray
    knot: float
    low: FloatArray  # the plateaus, at negative and at positive distance
    high: FloatArray
    spread: FloatArray  # k of plateau -+ k/|d|
    width: float

    @property
    def places(self) -> FloatArray:
        return centred(self.coefficients.shape[-1]) * self.knot

    def response(self, frequency: FloatArray) -> FloatArray:
        """Return |Fourier transform of the derivative|, 1 at zero: (..., frequency).

        For the spline, the transform is that of the coefficient differences times that of a quadratic B-spline; beyond
        its ends the derivative is ``spread``/d^2.
        """
        ends = float(self.places[-1]) + 0.5 * self.knot
        tail = self.spread / ends  # the remainder beyond the ends
        whole = [(self.low + tail)[..., None], self.coefficients, (self.high - tail)[..., None]]
        steps = np.diff(np.concatenate(whole, axis=-1))
        places = np.linspace(-ends, ends, steps.shape[-1])
        phase = 2 * np.pi * frequency
        beyond = 2 * (np.cos(phase * ends) / ends - phase * (0.5 * np.pi - scipy.special.sici(phase * ends)[0]))
        wave = phase * places[:, None]
        shape = np.sinc(frequency * self.knot) ** DEGREE
        real = steps @ (np.cos(wave) * shape) + self.spread[..., None] * beyond
        imaginary = steps @ (np.sin(wave) * shape)
        return np.asarray(np.hypot(real, imaginary) / np.abs(self.high - self.low)[..., None], np.float64)

    def at(self, distance: FloatArray) -> FloatArray:
        """Return the values of the function at distances from the edge, pixels."""
        count = len(self.coefficients)
        place = distance / self.knot + 0.5 * (count - 1) - 1
        first = np.clip(np.floor(place).astype(np.intp), 0, count - DEGREE - 1)
        inside = (place >= 0) & (place <= count - DEGREE)
        basis = cubic(np.where(inside, place - first, 0.0))
        spline = sum(basis[a] * self.coefficients[first + a] for a in range(DEGREE + 1))
        far = np.where(distance < 0, self.low, self.high) - self.spread / np.where(
            np.abs(distance) < self.knot, self.knot, distance
        )
        return np.asarray(np.where(inside, spline, far), np.float64)

    def crossing(self, share: float) -> float:
        """Return the distance, pixels, at which the spline passes a fraction of its step; of several crossings, the
        nearest to the middle.
        """
        c = self.coefficients
        values = ((c[:-2] + 4 * c[1:-1] + c[2:]) / 6 - self.low) / (self.high - self.low)
        middle = max(int(np.argmax(values >= 0.5)), 1)
        if share >= 0.5:
            at = middle + int(np.argmax(values[middle:] >= share))
        else:
            at = middle - int(np.argmax(values[middle - 1 :: -1] < share))
        if not values[at - 1] <= share <= values[at]:
            return math.nan
        own, wanted = c[at - 1 : at + 3], self.low + share * (self.high - self.low)
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            t = 0.5 * (low + high)
            passed = (float(own @ cubic(t)) - wanted) * (self.high - self.low) >= 0
            low, high = (low, t) if passed else (t, high)
        return float((at - 1 + low - 0.5 * (len(values) - 1)) * self.knot)


def cubic(t: FloatArray | float) -> FloatArray:
    """Return the weights (4, ...) of the four coefficients that act at a fraction ``t`` of a knot interval."""
    t = np.asarray(t)
    return np.stack([(1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3]) / 6


def centred(count: int) -> FloatArray:
    return np.arange(count) - 0.5 * (count - 1)


def whole(found: Fit, half_width: float | None, tails: bool) -> EdgeSpread:
    """Combine the spline near the edge, plateaus with tails far from it, and a smooth transition between them.

    Where the tails describe the picture completely, the spline only adds noise. Several distances are tried, and the
    transition ends at the smallest one beyond which the tails describe the pixels as well as the spline does. If noise
    is correlated, it ends at the smallest distance d for which the spline deviates from the tails between d/2 and d by
    no more than it does beyond d.
    """
    reach = float(np.abs(found.distance).max())
    width = reach
    candidates = [reach] if half_width else [w for w in (16.0 * 2 ** (0.5 * i) for i in range(40)) if w < reach]
    for width in [*candidates, reach]:
        outer, design = _far(found, width, tails)
        model = np.linalg.lstsq(design, found.value[outer], rcond=None)[0]
        rest = found.value[outer] - design @ model
        if np.mean(rest**2) < found.noise**2 * (1 + 3 * math.sqrt(2 / rest.size)) or _strays(
            found, model, width, reach
        ):
            break
    curve = joined(found.coefficients, found.knot, model, width)
    if not abs(curve.high - curve.low) > FAINTEST * found.noise:
        raise ValueError(lost("its step is lost in noise"))
    return curve


def _strays(found: Fit, model: FloatArray, width: float, reach: float) -> bool:
    """Return whether the spline deviates from plateaus and tails no more between ``width``/2 and ``width`` than it does
    beyond ``width``.
    """
    if width > 0.5 * reach:
        return False
    places = np.abs(centred(len(found.coefficients)) * found.knot)
    power = (found.coefficients - _plateau(places * np.sign(centred(len(places))), model, found.knot)) ** 2
    near, far = (places > 0.5 * width) & (places <= width), (places > width) & (places < reach - TOGETHER)
    free = [max(2 * length / TOGETHER, 1.0) for length in (0.5 * width, reach - TOGETHER - width)]
    return bool(power[near].mean() < power[far].mean() * (1 + 3 * math.sqrt(2 / free[0] + 2 / free[1])))


def _far(found: Fit, width: float, tails: bool) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return the pixels that determine the plateaus, and the design matrix of plateaus and tails on them."""
    outer = np.abs(found.distance) > 0.5 * width
    distance = found.distance[outer]
    columns = [distance < 0, distance > 0, *([-1 / distance] if tails else [])]
    return outer, np.stack(columns, axis=1).astype(float)


def joined(coefficients: FloatArray, knot: float, model: FloatArray, width: float) -> EdgeSpread:
    """Blend the spline (..., coefficients) into the plateaus and, if ``model`` (..., 2 or 3) has 3 values, the tail."""
    places = centred(coefficients.shape[-1]) * knot
    kept = np.abs(places) <= width
    places = places[kept]
    low, high = model[..., 0], model[..., 1]
    spread = model[..., 2] if model.shape[-1] > 2 else np.zeros_like(low)
    share = 0.5 + 0.5 * np.cos(np.pi * np.clip(2 * np.abs(places) / width - 1, 0, 1))
    far = _plateau(places, model, knot)
    return EdgeSpread(share * coefficients[..., kept] + (1 - share) * far, knot, low, high, spread, float(width))


def _plateau(places: FloatArray, model: FloatArray, knot: float) -> FloatArray:
    """Return the values of plateaus and tail at distances ``places``: (..., places)."""
    far = np.where(places < 0, model[..., 0, None], model[..., 1, None])
    if model.shape[-1] > 2:
        far = far - model[..., 2, None] / np.where(np.abs(places) < knot, knot, places)
    return np.asarray(far, np.float64)


def influence(found: Fit, curve: EdgeSpread, rows: int, tails: bool) -> EdgeSpread:
    """Return the contribution of each row's residuals to a curve: (rows, ...).

    The curve is linear in the pixel values as long as line and transition are fixed. Residuals are scaled up for the
    degrees of freedom of the fit, and the normal equations of the fit are reused.
    """
    freedom = math.sqrt(found.rest.size / max(found.rest.size - len(found.coefficients), 1))
    change = scipy.linalg.cho_solve_banded((found.factor, True), found.by_row(rows).T).T * freedom
    outer, design = _far(found, curve.width, tails)
    own = design * found.rest[outer, None]
    moved = np.stack([np.bincount(found.row[outer], column, rows) for column in own.T], axis=1)
    return joined(
        np.asarray(change, np.float64), found.knot, moved @ np.linalg.inv(design.T @ design) * freedom, curve.width
    )


def refitted(found: Fit, curve: EdgeSpread, values: FloatArray, tails: bool) -> tuple[EdgeSpread, FloatArray]:
    """Return curves, and their residuals, for other values (n, pixels) at the same pixels; line and transition are
    kept.
    """
    size, acting = len(found.coefficients), found.first + np.arange(DEGREE + 1)[:, None]
    right = np.stack([np.bincount(acting.ravel(), (found.basis * own).ravel(), size) for own in values], axis=1)
    coefficients = np.asarray(scipy.linalg.cho_solve_banded((found.factor, True), right), np.float64).T
    outer, design = _far(found, curve.width, tails)
    model = values[:, outer] @ design @ np.linalg.inv(design.T @ design)
    rest = np.stack(
        [value - (own[acting] * found.basis).sum(0) for value, own in zip(values, coefficients, strict=True)]
    )
    return joined(coefficients, found.knot, model, curve.width), rest


def redrawn(curve: EdgeSpread, rows: EdgeSpread, weights: FloatArray) -> EdgeSpread:
    """Return curves for n pictures; their residuals are the residuals of this picture multiplied by ``weights`` (n,
    rows).
    """
    return EdgeSpread(
        curve.coefficients + weights @ rows.coefficients,
        curve.knot,
        curve.low + weights @ rows.low,
        curve.high + weights @ rows.high,
        curve.spread + weights @ rows.spread,
        curve.width,
    )
