"""Colours of chart patches in a picture, from its four corners, and their colour differences to a reference.

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

GAP = 0.1  # between patches, of their pitch
MIDDLE = 0.5  # side of what is averaged, of the patch
SMALLEST = 5  # pixels along a side of what is averaged
DRAWS = 400


def homography(corners: ArrayLike) -> FloatArray:
    """(3, 3) matrix from the unit square to four corners (4, 2) in x and y: (0, 0), (1, 0), (1, 1), (0, 1) in this
    order.

    Raises
    ------
    ValueError
        Three corners lie on a line.
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
    """How many of the four corners turn clockwise as pictures are seen (y down), and how many the other way; (4, 0):
    in order.
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
    clipped: FloatArray  # (patch,) share of pixels of which a channel is at an end of its scale
    side: float  # of the smallest area that was averaged, pixels


def chart_patches(
    picture: ArrayLike, corners: ArrayLike, rows: int, columns: int, clipped: ArrayLike, gap: float = GAP
) -> Patches:
    """Average the middle of every patch of a grid.

    Parameters
    ----------
    picture : (channel, y, x) array, linear
    corners : (4, 2) array, pixels, x and y from the middle of the first pixel
        The outer corners of the first patch, the last of its row, the last of all, the first of the last row.
    rows, columns : int
    clipped : (y, x) array of bool
        Pixels that are not to be believed.
    gap : float
        Between patches, of their pitch.

    Raises
    ------
    ValueError
        Corners that are no four corners of a plane, or patches of less than 5 x 5 pixels in their middle.

    Notes
    -----
    A pixel belongs to a patch where its middle lies in the middle half of the patch. The covariance of the mean is that
    of the means of 4 x 4 parts of it over their number, so that neighbours may hang together.
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
    """Points through a homography."""
    w = matrix[2, 0] * u + matrix[2, 1] * v + matrix[2, 2]
    return (matrix[0, 0] * u + matrix[0, 1] * v + matrix[0, 2]) / w, (
        matrix[1, 0] * u + matrix[1, 1] * v + matrix[1, 2]
    ) / w


@dataclass(frozen=True)
class ColourErrors:
    """Colour differences with what noise leaves uncertain."""

    delta_e: FloatArray  # (patch,) CIEDE2000
    reach: FloatArray  # (patch,) how far noise moves a measured colour, CIEDE2000
    lab: FloatArray  # (3, patch) measured
    mean_reach: float  # the same of the mean over patches, and of the largest
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
    """CIEDE2000 of every patch, and how far its noise could move it.

    Parameters
    ----------
    patches : Patches
    lab_of : callable
        Linear channels (channel, ...) to L*a*b* (3, ...).
    reference : (3, patch) array, L*a*b*
    confidence : float
    rng : int
        Seed of the draws.
    draws : int

    Returns
    -------
    ColourErrors
        The true difference of a patch lies within ``reach`` of the one found: that is the distance below which a share
        ``confidence`` of the draws about the measured colour stay. Wider than need be, and right also where the
        difference is 0. So with the mean and the largest over patches.
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
