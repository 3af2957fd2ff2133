"""Cubic splines through curves of contrast.

In:  values at ascending places.
Out: the curve between them, and its integral.
Sources: the cubic spline with a continuous second derivative and the not-a-knot end condition, which makes the third
derivative continuous at the second place and at the last but one (de Boor, A Practical Guide to Splines, chapter IV).

``scipy.interpolate`` has the same curve. Its import takes 0.3 s, longer than the stage ``resolution`` takes for one
camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue import require
from etendue_camera.arrays import Array, FloatArray


@dataclass(frozen=True)
class Spline:
    """A cubic spline: ``terms`` (4, n - 1) are coefficients of the distance from the place before, constant first."""

    places: FloatArray
    terms: FloatArray

    def __call__(self, x: Array) -> FloatArray:
        """Return the values at places; beyond the ends, the first and the last polynomial are extrapolated."""
        x = np.asarray(x, dtype=float)
        step = np.clip(np.searchsorted(self.places, x, side="right") - 1, 0, self.places.size - 2)
        d, (a, b, c, e) = x - self.places[step], self.terms[:, step]
        return np.asarray(a + d * (b + d * (c + d * e)))

    def integral(self, low: float, high: float) -> float:
        """Return the integral from ``low`` to ``high``, both between the first and the last place, low <= high."""
        ends = np.clip(self.places, low, high)
        return float((self._area(ends[1:]) - self._area(ends[:-1])).sum())

    def _area(self, x: FloatArray) -> FloatArray:
        d, (a, b, c, e) = x - self.places[:-1], self.terms
        return np.asarray(d * (a + d * (b / 2 + d * (c / 3 + d * e / 4))))


def through(places: FloatArray, values: FloatArray) -> tuple[Spline, ...]:
    """Return the splines through curves at common places.

    Parameters
    ----------
    places : (n,) array, rising, n >= 3
    values : (n, curves) array

    Returns
    -------
    tuple of Spline

    Raises
    ------
    ValueError
        If there are fewer than 3 places.

    Notes
    -----
    Through 3 places the spline is a parabola. Error against ``scipy.interpolate.CubicSpline``: below 1e-13 of the
    largest value, at up to 4096 places of ``search_nodes``.
    """
    require.that(len(places) >= 3, f"a spline needs at least 3 places, not {len(places)}")
    h = np.diff(places)
    slope = np.diff(values, axis=0) / h[:, None]
    if len(places) > 3:
        rise = _rise(places, h, slope)
    else:
        half = (slope[1] - slope[0]) / (h[0] + h[1])
        rise = np.stack([slope[0] - h[0] * half, slope[0] + h[0] * half, slope[1] + h[1] * half])
    bend = (rise[:-1] + rise[1:] - 2 * slope) / h[:, None]
    terms = np.stack([values[:-1], rise[:-1], (slope - rise[:-1]) / h[:, None] - bend, bend / h[:, None]])
    return tuple(Spline(places, np.ascontiguousarray(terms[:, :, i])) for i in range(values.shape[1]))


def _rise(places: FloatArray, h: FloatArray, slope: FloatArray) -> FloatArray:
    """Return the first derivatives at all places, (n, curves). The equations of both ends are substituted into the
    neighbouring equations, which keeps the matrix diagonally dominant.
    """
    first, last = places[2] - places[0], places[-1] - places[-3]
    before = ((h[0] + 2 * first) * h[1] * slope[0] + h[0] ** 2 * slope[1]) / first
    after = (h[-1] ** 2 * slope[-2] + (2 * last + h[-1]) * h[-2] * slope[-1]) / last
    right = 3 * (h[1:, None] * slope[:-1] + h[:-1, None] * slope[1:])
    diagonal, lower, upper = 2 * (h[:-1] + h[1:]), h[1:].copy(), h[:-1].copy()
    diagonal[0], diagonal[-1], lower[0], upper[-1] = first, last, 0.0, 0.0
    right[0] -= before
    right[-1] -= after
    inner = _tridiagonal(lower, diagonal, upper, right)
    ends = (before - first * inner[0]) / h[1], (after - last * inner[-1]) / h[-2]
    return np.concatenate([ends[0][None], inner, ends[1][None]])


def _tridiagonal(lower: FloatArray, diagonal: FloatArray, upper: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a diagonally dominant tridiagonal system for (n, curves) right-hand sides by cyclic reduction. Each round
    doubles the distance between coupled places and squares the relative size of the coupling; the rounds end when it is
    below rounding.
    """
    apart, n = 1, len(diagonal)
    while apart < n and max((np.abs(lower) / diagonal).max(), (np.abs(upper) / diagonal).max()) > 1e-17:
        back, on = lower[apart:] / diagonal[:-apart], upper[:-apart] / diagonal[apart:]
        wider, sums = diagonal.copy(), right.copy()
        wider[apart:] -= back * upper[:-apart]
        wider[:-apart] -= on * lower[apart:]
        sums[apart:] -= back[:, None] * right[:-apart]
        sums[:-apart] -= on[:, None] * right[apart:]
        farther, beyond = np.zeros(n), np.zeros(n)
        farther[apart:] = -back * lower[:-apart]
        beyond[:-apart] = -on * upper[apart:]
        lower, upper, diagonal, right, apart = farther, beyond, wider, sums, 2 * apart
    return np.asarray(right / diagonal[:, None])
