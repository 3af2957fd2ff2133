"""Visible noise: the noise of a flat patch as seen by an eye at a distance.

In:  XYZ of a patch (3, y, x), XYZ of white, samples per degree of visual angle.
Out: one figure, in units of CIELUV lightness; the three spreads it is made of.
Sources: Kleinmann and Wueller 2007 and ISO 15739:2013 for the form and the weights; the eye is that of S-CIELAB.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from etendue_camera.colour.difference import lab
from etendue_camera.quality import scielab

WEIGHTS = (1.0, 0.852, 0.323)  # of the spreads of L*, u*, v*


class VisibleNoise(NamedTuple):
    """What is seen of the noise, and the standard deviations of L*, u*, v* behind it."""

    value: float
    lightness: float
    u: float
    v: float


def visible_noise(xyz: ArrayLike, white_xyz: ArrayLike, samples_per_degree: float) -> VisibleNoise:
    """Weighted sum of the standard deviations of L*, u*, v* after the eye has blurred the patch.

    Parameters
    ----------
    xyz : (3, y, x) array
        A patch that would be uniform without noise, linear. Take slow shading out first; it counts as noise.
    white_xyz : (3,) array
        Of the viewer's white, in the same scale; above 0.
    samples_per_degree : float, above 0, 1/degree
        Pixels per degree of visual angle (`scielab.samples_per_degree`).

    Returns
    -------
    VisibleNoise
        0 for a uniform patch; grows in proportion to small noise; the finer the noise or the larger the distance,
        the smaller.

    Raises
    ------
    ValueError
        If shapes do not fit, the white or samples are not above 0, or the patch is darker than black on average.

    Notes
    -----
    Source: Kleinmann and Wueller 2007, "Investigation of two methods to quantify noise in digital images based on the
    perception of the human eye" (weights 1, 0.852, 0.323; also in ISO 15739:2013). Departures: the blur is that of
    S-CIELAB (1 at zero frequency) where the standard takes band-pass curves up to 3, which count noise of 2-8
    cycles/degree up to threefold: figures are not those of a test house, their order is. Border: mirrored.
    """
    planes = np.asarray(xyz, np.float64)
    luv = cieluv(scielab.seen(planes, samples_per_degree), white_xyz)
    if not planes[1].mean() > 0:
        raise ValueError(f"xyz has the mean luminance {planes[1].mean()!r}; allowed: a patch brighter than black")
    spreads = [float(plane.std()) for plane in luv]
    return VisibleNoise(float(np.dot(WEIGHTS, spreads)), *spreads)


def cieluv(xyz: ArrayLike, white_xyz: ArrayLike) -> NDArray:
    """CIE 1976 L*u*v*.

    Parameters
    ----------
    xyz : (3, ...) array
        Linear.
    white_xyz : (3,) array
        Above 0, same scale.

    Returns
    -------
    (3, ...) array, dtype of xyz (integers become float64)
        L*, u*, v*. Where X + 15 Y + 3 Z is not above 0 there is no chromaticity, and u* = v* = 0.

    Raises
    ------
    ValueError
        If shapes do not fit or the white is not above 0.

    Notes
    -----
    Source: CIE 15:2018 eqs. 8.29-8.33. L* is that of `difference.lab`.
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
