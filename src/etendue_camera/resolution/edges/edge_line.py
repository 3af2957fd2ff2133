"""The line of an edge in a picture: a polynomial, found from the gradient and refined on the picture itself.

In:  a linear picture (y, x), or some of its sites.
Out: whether the edge is nearer to a column than to a row, its polynomial, the distance of every pixel from it.
Sources: moments of the squared gradient; Gauss-Newton.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue_camera.arrays import FloatArray

Sites = NDArray[np.bool_]
# distances within which the line is located again: fractions of the picture width, and a minimum in pixels
CLOSER, NEAREST = ((0.25, 0.12, 0.06, 0.04, 0.04), 8.0)
STRONG = 0.2  # fraction of the strongest squared gradient above which a pixel belongs to the edge


def lost(why: str) -> str:
    """Return the message for pictures in which no edge can be measured."""
    return (
        f"picture shows no edge that can be measured: {why}; one edge between two uniform areas is required, 2 to 43 "
        f"degrees "
        "from rows and columns"
    )


def smooth(image: FloatArray, sites: Sites | None = None) -> tuple[FloatArray, Sites | None]:
    """Return the mean over 3 x 3 pixels, with borders repeated, and a mask of the pixels at which the gradient of this
    mean is known (None: everywhere).

    If ``sites`` are given, the mean is taken over these only, twice in succession.
    """
    if sites is None:
        return _mean(image), None
    held = _mean(_mean(sites.astype(float)))
    value = _mean(_mean(np.where(sites, image, 0.0))) / np.where(held > 0, held, 1.0)
    known = scipy.ndimage.minimum_filter(held > 0, 3)
    if not known.any():
        raise ValueError("sites selects too few pixels; it must be (y, x) with at least one True in every few pixels")
    return np.asarray(value, np.float64), known


def gradient(image: FloatArray, sites: Sites | None = None) -> tuple[FloatArray, FloatArray]:
    """Return the gradient along y and x of the smoothed picture, 0 where it is unknown."""
    value, known = smooth(image, sites)
    gy, gx = (np.asarray(part, np.float64) for part in np.gradient(value))
    return (gy, gx) if known is None else (np.where(known, gy, 0.0), np.where(known, gx, 0.0))


def _mean(image: FloatArray) -> FloatArray:
    for axis in (0, 1):
        padded = np.concatenate([image.take([0], axis), image, image.take([-1], axis)], axis)
        size = image.shape[axis]
        image = sum(padded.take(range(i, i + size), axis) for i in range(3)) / 3  # type: ignore[assignment]
    return image


def first_line(image: FloatArray, sites: Sites | None = None) -> tuple[bool, FloatArray]:
    """Return whether the edge is nearer to a column than to a row, and its line from the squared gradient: position at
    v = 0 and change to v = 1, pixels, where v runs from -1 (first row) to 1 (last row).
    """
    gy, gx = gradient(image, sites)
    weight = gx**2 + gy**2
    # Keep about as many strong pixels as the edge has rows.
    most = np.partition(weight.ravel(), -max(weight.shape))[-max(weight.shape)]
    if not most > 0:
        raise ValueError(lost("it is uniform"))
    weight = np.where(weight > STRONG * most, weight, 0.0)
    vertical = bool((weight * gx**2).sum() >= (weight * gy**2).sum())
    if not vertical:
        weight = weight.T
    rows, columns = weight.shape
    v = np.linspace(-1.0, 1.0, rows)
    u = np.arange(columns) - 0.5 * (columns - 1)
    line = _moments(weight, v, u)
    for share in CLOSER:  # strong noise far from the edge biases the moments to the middle
        near = np.abs(u - line[0] - line[1] * v[:, None]) < max(share * columns, NEAREST)
        line = _moments(np.where(near, weight, 0.0), v, u)
    return vertical, line


def _moments(weight: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
    """Return the position at v = 0, and the change to v = 1, of the line through weighted pixels."""
    total = weight.sum()
    if not total > 0:
        raise ValueError(lost("its rows have no step"))
    mean_v, mean_u = (weight.sum(1) @ v) / total, (weight.sum(0) @ u) / total
    spread = weight.sum(1) @ (v - mean_v) ** 2
    if not spread > 0:
        raise ValueError(lost("it is in one row"))
    slope = float((v - mean_v) @ weight @ (u - mean_u) / spread)
    return np.array([mean_u - slope * mean_v, slope])


def distances(coefficients: FloatArray, v: FloatArray, across: FloatArray, rows: int) -> FloatArray:
    """Return the signed distance of every pixel from the edge, along its normal, pixels."""
    polynomial = np.polynomial.polynomial
    slope = polynomial.polyval(v, polynomial.polyder(coefficients)) * 2 / max(rows - 1, 1)
    return np.asarray(
        (across[None, :] - polynomial.polyval(v, coefficients)[:, None]) / np.sqrt(1 + slope**2)[:, None], np.float64
    )


def movement(
    coefficients: FloatArray,
    v: FloatArray,
    rows: int,
    row: NDArray[np.intp],
    distance: FloatArray,
    rest: FloatArray,
    steep: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the Gauss-Newton step of the polynomial that moves the fitted edge onto the picture, and its standard
    error.

    ``row``, ``distance``, ``rest`` (picture minus fit) and ``steep`` (derivative of the fit) are given for the pixels
    used.
    """
    polynomial = np.polynomial.polynomial
    slope = (polynomial.polyval(v, polynomial.polyder(coefficients)) * 2 / max(rows - 1, 1))[row]
    own = v[row]
    normal = np.sqrt(1 + slope**2)
    k = np.arange(len(coefficients))
    change = -(own[:, None] ** k) / normal[:, None]
    turned = k * own[:, None] ** np.maximum(k - 1, 0) * 2 / max(rows - 1, 1)
    change = change - (distance * slope / normal**2)[:, None] * turned
    design = change * steep[:, None]
    step = np.linalg.lstsq(design, rest, rcond=None)[0]
    doubt = np.sqrt(np.mean(rest**2) * np.abs(np.diag(np.linalg.pinv(design.T @ design))))
    step[0] = 0.0
    return step, doubt
