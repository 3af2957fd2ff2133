"""Colours of chart patches in a picture, located by the chart's four corners, and their colour differences to a
reference.

In:  a picture (channel, y, x), the corners of a grid of patches (pixels); measured and reference L*a*b*.
Out: mean of every patch and its covariance; colour differences with intervals.
Sources: the plane homography through four points (Hartley and Zisserman 2004, section 4.1); CIEDE2000.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from etendue_camera.arrays import FloatArray
from etendue_camera.colour.difference import delta_e_2000

GAP = 0.1  # between patches, as a fraction of their pitch
MIDDLE = 0.5  # side of the averaged area, as a fraction of the patch
SMALLEST = 5  # minimum side of the averaged area, pixels
DRAWS = 400


def homography(corners: ArrayLike) -> FloatArray:
    """Return the (3, 3) matrix from the unit square to four corners (4, 2), x and y, in the order (0, 0), (1, 0),
    (1, 1), (0, 1).

    Raises
    ------
    ValueError
        If three corners are collinear.
    """
    points = np.asarray(corners, np.float64)
    square = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    rows, right = [], []
    for (u, v), (x, y) in zip(square, points, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -u * x, -v * x], [0, 0, 0, u, v, 1, -u * y, -v * y]]
        right += [x, y]
    try:
        found = np.linalg.solve(np.array(rows), np.array(right))
    except np.linalg.LinAlgError:
        raise ValueError("three of the corners are on a line") from None
    return np.append(found, 1.0).reshape(3, 3)


def turning(corners: ArrayLike) -> tuple[int, int]:
    """Return the numbers of corners that turn clockwise and anticlockwise on screen (y down); (4, 0) means
    that they are in order.
    """
    points = np.asarray(corners, np.float64)
    ahead = np.roll(points, -1, axis=0) - points
    behind = points - np.roll(points, 1, axis=0)
    cross = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]
    return int((cross > 0).sum()), int((cross < 0).sum())


@dataclass(frozen=True)
class Patches:
    """Means of patches, row by row."""

    mean: FloatArray  # (patch, channel)
    covariance: FloatArray  # (patch, channel, channel) of the mean
    clipped: FloatArray  # (patch,) fraction of pixels with a clipped channel
    side: float  # of the smallest averaged area, pixels


def chart_patches(
    picture: ArrayLike, corners: ArrayLike, rows: int, columns: int, clipped: ArrayLike, gap: float = GAP
) -> Patches:
    """Return the mean over the central part of every patch of a grid, with its covariance.

    Parameters
    ----------
    picture : (channel, y, x) array, linear
    corners : (4, 2) array, pixels, x and y from the centre of the first pixel
        The chart's outer corners, in this order: first patch, last of its row, last patch, first of the last row.
    rows, columns : int
    clipped : (y, x) array of bool
        Pixels with unreliable values, such as clipped ones.
    gap : float
        Gap between patches, as a fraction of their pitch.

    Raises
    ------
    ValueError
        If three corners are collinear, or the central part of a patch is less than 5 pixels wide or high.

    Notes
    -----
    A pixel belongs to a patch if its centre lies in the central half of the patch. The covariance of the mean is the
    covariance of the means of 4 x 4 parts, divided by their number; it is valid even if neighbouring pixels are
    correlated.
    """
    planes, mask = np.asarray(picture, np.float64), np.asarray(clipped, bool)
    turn = homography(corners)
    back = np.linalg.inv(turn)
    wide, high = columns - gap, rows - gap
    mean, covariance, share, side = [], [], [], math.inf
    for row in range(rows):
        for column in range(columns):
            middle = np.array([(column + 0.5 * (1 - gap)) / wide, (row + 0.5 * (1 - gap)) / high])
            half = 0.5 * MIDDLE * (1 - gap) * np.array([1 / wide, 1 / high])
            places = middle + half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
            x, y = _through(turn, places[:, 0], places[:, 1])
            side = min(side, *(math.hypot(x[i] - x[i - 1], y[i] - y[i - 1]) for i in range(4)))
            if not side >= SMALLEST:
                raise ValueError(
                    f"its patches are {side / MIDDLE:.1f} pixels wide; allowed: at least {SMALLEST / MIDDLE:.0f}"
                )
            top, left = max(math.ceil(y.min()), 0), max(math.ceil(x.min()), 0)
            cut = np.s_[top : math.floor(y.max()) + 1, left : math.floor(x.max()) + 1]
            part = planes[:, *cut]
            gy, gx = np.mgrid[top : top + part.shape[1], left : left + part.shape[2]].astype(float)
            u, v = _through(back, gx, gy)
            a, b = (u - middle[0]) / half[0], (v - middle[1]) / half[1]
            inside = (np.abs(a) < 1) & (np.abs(b) < 1)
            values = part[:, inside]
            block = (np.floor(2 * (a[inside] + 1)) * 4 + np.floor(2 * (b[inside] + 1))).astype(int)
            counts = np.bincount(block, minlength=16)
            means = (
                np.stack([np.bincount(block, own, 16) for own in values], 1)[counts > 0] / counts[counts > 0][:, None]
            )
            mean.append(values.mean(1))
            covariance.append(np.cov(means.T).reshape(len(planes), -1) / len(means))
            share.append(float(mask[cut][inside].mean()))
    return Patches(np.array(mean), np.array(covariance), np.array(share), side)


def _through(matrix: FloatArray, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Map points by a homography."""
    w = matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2]
    return (matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2]) / w, (
        matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2]
    ) / w


@dataclass(frozen=True)
class ColourErrors:
    """Colour differences and their uncertainty due to noise."""

    delta_e: FloatArray  # (patch,) CIEDE2000
    reach: FloatArray  # (patch,) how far noise can move a measured colour, CIEDE2000
    lab: FloatArray  # (3, patch) measured
    mean_reach: float  # the same for the mean of delta_e; max_reach: for the largest
    max_reach: float

    @property
    def mean(self) -> float:
        return float(self.delta_e.mean())


def colour_errors(
    patches: Patches,
    lab_of: Callable[[FloatArray], FloatArray],
    reference: ArrayLike,
    confidence: float = 0.95,
    rng: int = 0,
    draws: int = DRAWS,
) -> ColourErrors:
    """Return the CIEDE2000 difference of every patch, and its possible change by noise.

    Parameters
    ----------
    patches : Patches
    lab_of : callable
        Linear channels (channel, ...) to L*a*b* (3, ...).
    reference : (3, patch) array, L*a*b*
    confidence : float
    rng : int
        Seed of the random draws.
    draws : int

    Returns
    -------
    ColourErrors
        With this confidence, the true difference of a patch is within ``reach`` of the measured difference: a fraction
        ``confidence`` of the colours drawn around the measured colour is closer to it than ``reach``. The interval is
        wider than necessary, but valid even where the difference is 0. The same holds for the mean and the largest
        difference over the patches.
    """
    goal = np.asarray(reference, np.float64)
    found = lab_of(patches.mean.T)
    generator = np.random.default_rng(rng)
    root = np.stack([_root(own) for own in patches.covariance])
    drawn = patches.mean + np.einsum("pij,npj->npi", root, generator.standard_normal((draws, *patches.mean.shape)))
    moved = delta_e_2000(lab_of(np.moveaxis(drawn, -1, 0)), found[:, None, :])
    reach, mean, largest = (np.quantile(own, confidence, axis=0) for own in (moved, moved.mean(1), moved.max(1)))
    return ColourErrors(delta_e_2000(found, goal), reach, found, float(mean), float(largest))


def _root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))
