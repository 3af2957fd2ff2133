"""Visible noise: the noise of a uniform patch as seen from a distance.

In:  XYZ of a patch (3, y, x), XYZ of white, samples per degree of visual angle.
Out: one value, in units of CIELUV lightness, and the three standard deviations it combines.
Sources: Kleinmann and Wueller 2007 and ISO 15739:2013 for the formula and the weights; the blur of the eye is taken
from S-CIELAB.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue_camera.colour.difference import lab
from etendue_camera.quality import scielab

WEIGHTS = (1.0, 0.852, 0.323)  # of the standard deviations of L*, u*, v*


class VisibleNoise(NamedTuple):
    """The visible noise, and the standard deviations of L*, u*, v* that it combines."""

    value: float
    lightness: float
    u: float
    v: float


def visible_noise(xyz: ArrayLike, white_xyz: ArrayLike, samples_per_degree: float) -> VisibleNoise:
    """Return the weighted sum of the standard deviations of L*, u*, v* after the eye has blurred the patch.

    Parameters
    ----------
    xyz : (3, y, x) array
        A patch that is uniform except for noise, linear. Remove slow shading first; it counts as noise.
    white_xyz : (3,) array
        XYZ of the viewer's white, in the same scale; above 0.
    samples_per_degree : float, above 0, 1/degree
        Pixels per degree of visual angle (`scielab.samples_per_degree`).

    Returns
    -------
    VisibleNoise
        0 for a uniform patch; proportional to small noise; smaller for finer noise and for larger distances.

    Raises
    ------
    ValueError
        If shapes do not fit, the white or samples are not above 0, or the mean luminance is not above black.

    Notes
    -----
    Source: Kleinmann and Wueller 2007, "Investigation of two methods to quantify noise in digital images based on the
    perception of the human eye" (weights 1, 0.852, 0.323; also in ISO 15739:2013). Departures: the blur is taken from
    S-CIELAB (1 at zero frequency); the standard instead has band-pass curves of up to 3, which weight noise of 2-8
    cycles/degree up to threefold. Values therefore differ from the values of a test laboratory, but rank cameras in the
    same order. Border: mirrored.
    """
    planes = np.asarray(xyz, np.float64)
    luv = cieluv(scielab.seen(planes, samples_per_degree), white_xyz)
    if not planes[1].mean() > 0:
        raise ValueError(f"xyz has the mean luminance {planes[1].mean()!r}; allowed: a patch brighter than black")
    spreads = [float(plane.std()) for plane in luv]
    return VisibleNoise(float(np.dot(WEIGHTS, spreads)), *spreads)


def cieluv(xyz: ArrayLike, white_xyz: ArrayLike) -> NDArray:
    """Return CIE 1976 L*u*v*.

    Parameters
    ----------
    xyz : (3, ...) array
        Linear.
    white_xyz : (3,) array
        Above 0, same scale.

    Returns
    -------
    (3, ...) array, dtype of xyz (integers become float64)
        L*, u*, v*. Where X + 15 Y + 3 Z is not above 0, the chromaticity is undefined and u* = v* = 0.

    Raises
    ------
    ValueError
        If shapes do not fit or the white is not above 0.

    Notes
    -----
    Source: CIE 15:2018 eqs. 8.29-8.33. L* is computed by `difference.lab`.
    """
    lightness = lab(xyz, white_xyz)[0]
    planes = np.asarray(xyz, lightness.dtype)
    white = np.asarray(white_xyz, np.float64)
    denominator = planes[0] + 15 * planes[1] + 3 * planes[2]
    lit = denominator > 0
    below = np.where(lit, denominator, 1)
    scale = white[0] + 15 * white[1] + 3 * white[2]
    u = np.where(lit, 4 * planes[0] / below - planes.dtype.type(4 * white[0] / scale), 0)
    v = np.where(lit, 9 * planes[1] / below - planes.dtype.type(9 * white[1] / scale), 0)
    return np.stack([lightness, 13 * lightness * u, 13 * lightness * v])
