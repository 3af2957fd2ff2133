"""Means over grid cells of the elements of charts: steps, half planes, Gaussian spots, and anything else by
quadrature.

In:  positions of cell centres (um), the side of a cell (um), geometry (um).
Out: mean over each cell, in the dtype of the positions.
Sources: the integrals of the normal distribution; the area of a half plane in a square; Gauss-Legendre quadrature.
"""

from __future__ import annotations

from collections.abc import Callable
from math import pi, sqrt

import numpy as np
import scipy

from etendue_camera.arrays import FloatArray

Paint = Callable[[FloatArray, FloatArray], FloatArray]  # y and x that broadcast -> value

TAIL = 10.0  # rms widths beyond which a soft step is 0 or 1 in float64
SUBCELLS = 8  # along each side of a cell that needs a finer quadrature
CLOSER = 1e-5  # difference between two quadratures above which a cell needs a finer one


def step_mean(distance: FloatArray, softness: float, cell: float) -> FloatArray:
    """Return the mean of a soft unit step over intervals.

    Parameters
    ----------
    distance : (...) array, um
        Distance of each interval's centre from the step, positive on its light side.
    softness : float, um, 0 or above
        Rms width of the Gaussian that softens the step.
    cell : float, um, above 0
        Length of the intervals.

    Returns
    -------
    (...) array, 0 to 1

    Notes
    -----
    Exact: the result is a difference of t P(t/s) + s p(t/s), the integral of the normal distribution P with density p.
    Error: 1e-14.
    """
    half = 0.5 * float(cell)
    if softness == 0:
        return np.clip(0.5 + distance / (2 * half), 0, 1)
    t = np.clip(distance, -half - TAIL * softness, half + TAIL * softness)
    return np.clip((_ramp(t + half, softness) - _ramp(t - half, softness)) / (2 * half), 0, 1)


def half_plane_mean(distance: FloatArray, angle: float, softness: float, cell: float) -> FloatArray:
    """Return the mean of a soft half plane over square cells; for a hard one, the fraction of each cell that it covers.

    Parameters
    ----------
    distance : (...) array, um
        Distance of each cell's centre from the border, along its normal, positive on the light side.
    angle : float, rad
        Angle between the normal and the x axis.
    softness, cell : float, um

    Returns
    -------
    (...) array, 0 to 1

    Notes
    -----
    Projected onto the normal, a square is a trapezoid: the convolution of two intervals a >= b. For hard borders the
    trapezoid is integrated piece by piece, exact to 1e-15. For soft borders, if b is below the softness, the exact mean
    over a is integrated over b by Gauss-Legendre quadrature; otherwise second differences of the second integral of the
    normal distribution are taken. Error: 1e-12; 1e-7 if the softness is below 1e-7 of a cell and the tilt from an axis
    is below 1e-7 rad.
    """
    a, b = (0.5 * float(cell) * size for size in sorted((abs(np.cos(angle)), abs(np.sin(angle))), reverse=True))
    if softness == 0:
        size = np.abs(distance)
        with np.errstate(over="ignore"):  # beyond the narrow flank, where the corner term is not used
            corner = np.square(np.maximum(a + b - size, 0)) / (8 * a * b) if b > 0 else np.zeros_like(size)
        upper = np.where(size <= a - b, 0.5 + size / (2 * a), 1 - corner)
        return np.where(distance < 0, 1 - upper, upper)
    t = np.clip(distance, -a - b - TAIL * softness, a + b + TAIL * softness)
    if b <= softness or b < 1e-7 * a:
        total = np.zeros_like(t)
        for node, weight in zip(*np.polynomial.legendre.leggauss(12), strict=True):
            total = total + 0.5 * float(weight) * step_mean(t + b * float(node), softness, 2 * a)
        return np.clip(total, 0, 1)
    ends = (
        _bowl(t + a + b, softness)
        - _bowl(t + a - b, softness)
        - _bowl(t - a + b, softness)
        + _bowl(t - a - b, softness)
    )
    return np.clip(ends / (4 * a * b), 0, 1)


def spot_mean(distance: FloatArray, rms_width: float, cell: float) -> FloatArray:
    """Return the mean over intervals of exp(-t^2/(2 w^2)), whose peak is 1.

    Exact however narrow the spot is: all of its light falls into some cell. Error: 1e-15 of the value.
    """
    half, size = 0.5 * float(cell), np.abs(distance)
    share = scipy.special.ndtr((half - size) / rms_width) - scipy.special.ndtr((-half - size) / rms_width)
    return share * (sqrt(2 * pi) * float(rms_width) / float(cell))


def averaged(paint: Paint, y: FloatArray, x: FloatArray, cell: float) -> FloatArray:
    """Return the mean of any function over cells, by adaptive quadrature.

    Parameters
    ----------
    paint : function of positions
    y, x : (ny,), (nx,) arrays, um
    cell : float, um, above 0

    Returns
    -------
    (ny, nx) array

    Notes
    -----
    5 x 5 Gauss-Legendre nodes per cell; 24 x 24 nodes in cells where the means from 5 x 5 and 3 x 3 nodes differ by
    more than 1e-5. Error: below 1e-6 where the function is smooth over a cell, below 0.01 in a cell with a hard border
    of height 1.
    """
    value = _quadrature(paint, y[:, None], x[None, :], cell, 5)
    rows, columns = np.nonzero(np.abs(value - _quadrature(paint, y[:, None], x[None, :], cell, 3)) > CLOSER)
    if rows.size:
        value[rows, columns] = closely(paint, y[rows], x[columns], cell)
    return value


def closely(paint: Paint, y: FloatArray, x: FloatArray, cell: float) -> FloatArray:
    """Return the means over n cells with centres y and x, (n,), by quadrature with 3 x 3 nodes in 8 x 8 parts."""
    within = (np.arange(SUBCELLS) + 0.5) / SUBCELLS - 0.5
    total = np.zeros(y.shape, dtype=np.result_type(y, x))
    for down in within:
        for across in within:
            total += _quadrature(paint, y + float(down) * cell, x + float(across) * cell, cell / SUBCELLS, 3)
    return total / SUBCELLS**2


def _quadrature(paint: Paint, y: FloatArray, x: FloatArray, cell: float, count: int) -> FloatArray:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    total: FloatArray | None = None
    for down, v in zip(nodes, weights, strict=True):
        for across, u in zip(nodes, weights, strict=True):
            part = (0.25 * float(v) * float(u)) * paint(y + 0.5 * cell * float(down), x + 0.5 * cell * float(across))
            total = part if total is None else total + part
    assert total is not None
    return total


def _density(t: FloatArray) -> FloatArray:
    return np.exp(-0.5 * np.square(np.clip(t, -40.0, 40.0))) / sqrt(2 * pi)  # 0 beyond, without overflow


def _ramp(t: FloatArray, softness: float) -> FloatArray:
    """Return the integral of the soft step."""
    far = _in_softnesses(t, softness)
    return t * scipy.special.ndtr(far) + softness * _density(far)


def _bowl(t: FloatArray, softness: float) -> FloatArray:
    """Return the integral of the ramp."""
    far = _in_softnesses(t, softness)
    return 0.5 * ((np.square(t) + softness**2) * scipy.special.ndtr(far) + softness * t * _density(far))


def _in_softnesses(t: FloatArray, softness: float) -> FloatArray:
    """Return the distance from a step over its softness; it may overflow to infinity."""
    with np.errstate(over="ignore"):
        return t / softness
