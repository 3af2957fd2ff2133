"""Spectra from RGB: reflectances that have given linear sRGB colours under D65.

In:  bin edges of a wavelength axis, nm.
Out: a basis (bins, 3), and the matrix of its colours.
Source: Mallett & Yuksel (2019), corrected to the bins.
"""

import math
from functools import lru_cache

import numpy as np

from etendue_camera.spectra import shipped
from etendue_camera.spectra.authority import BASIS
from etendue_camera.spectra.bins import Edges, FloatArray, bin_means, checked_edges, frozen
from etendue_camera.spectra.library import colour_matching, span
from etendue_camera.spectra.names import EYE

# ------------------------------------------------------------------------------------- RGB to reflectance


def whole_axis(edges: tuple[float, ...]) -> tuple[float, ...]:
    """Extend bin edges over the visible range with bins as wide as those at the ends. A scene rendered over a part of
    the spectrum then has the same basis spectra and matrices as over the whole.
    """
    first, last = edges[1] - edges[0], edges[-1] - edges[-2]
    below = min(math.ceil(max(0.0, edges[0] - EYE[0]) / first - 1e-9), math.ceil(edges[0] / first - 1e-9) - 1)
    above = math.ceil(max(0.0, EYE[1] - edges[-1]) / last - 1e-9)
    return (
        *(edges[0] - first * i for i in range(below, 0, -1)),
        *edges,
        *(edges[-1] + last * i for i in range(1, above + 1)),
    )


def srgb_to_xyz(edges: Edges) -> FloatArray:
    """Return the matrix from linear sRGB to XYZ (Y of white = 1) for the primaries of sRGB and D65 in these bins.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm
        Extended over 360-830 nm with the widths of the end bins.

    Returns
    -------
    (3, 3) array

    Notes
    -----
    The four digits of IEC 61966-2-1 describe a white of (0.9505, 1, 1.0890); sums over bins give a slightly different
    white. This matrix keeps the chromaticities of the primaries and maps (1, 1, 1) to the white of the bins: the
    largest difference from the standard's matrix is 2.2e-4 (1 nm bins), 3.6e-4 (5 nm) or 7.9e-4 (10 nm).

    """
    return _srgb_to_xyz(whole_axis(checked_edges(edges)))


@lru_cache(maxsize=32)
def _srgb_to_xyz(edges: tuple[float, ...]) -> FloatArray:
    white = _d65_weights(edges).sum(axis=0)
    x, y = shipped.space("sRGB")["primaries"].T
    primaries = np.stack([x / y, np.ones(3), (1.0 - x - y) / y])
    return frozen(primaries * np.linalg.solve(primaries, white))


def _d65_weights(edges: tuple[float, ...]) -> FloatArray:
    """Return (n, 3) weights with ``reflectance @ weights`` = XYZ under D65; the end values of D65 are extended. Light
    outside the visible range has weight 0, so photographs can also be used on an axis to 1100 nm.
    """
    nodes, values = shipped.curve("illuminant", "D65")
    power = bin_means(nodes, values, edges, "hold") * np.diff(edges)
    weights = power[:, None] * colour_matching(edges)
    return weights / weights[:, 1].sum()


def upsampling_basis(edges: Edges) -> FloatArray:
    """Return reflectance spectra of linear sRGB: ``reflectance = basis @ rgb``.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm
        A part of the spectrum, in bins so narrow that at least three are in the visible range.

    Returns
    -------
    (n, 3) array, dimensionless
        The values in a bin do not depend on which other bins of the same grid are rendered. Columns sum to 1 in every
        bin, so that grey photographs get flat spectra.

    Raises
    ------
    ValueError
        If bins are too wide to separate the three primaries.

    Notes
    -----
    Source: the basis of Mallett & Yuksel (2019, https://doi.org/10.2312/sr.20191216), interpolated to 1 nm (Sprague),
    averaged over the bins, with its end values outside 380-780 nm. Two corrections: each row is divided by its sum
    (which is 1 within 1e-5), and a 3 x 3 matrix makes the round trip exact for the full spectrum in these bins
    (`whole_axis`), that is sum(basis x D65 x observer) = ``srgb_to_xyz(edges)``. Together they change the basis by at
    most 1.2e-3 (5 nm bins), 4.6e-3 (10 nm) and 2.2e-2 (20 nm).
    Error: round trip below 1e-15, sum of columns within 2e-15 of 1. Values within [0.0029, 0.978] for 10 nm
    bins over 380-780 nm, so that RGB inside [0, 1] gives reflectances inside [0, 1]; bins of 20 nm reach
    -0.0064.
    """
    return _upsampling_basis(checked_edges(edges))


@lru_cache(maxsize=32)
def _upsampling_basis(edges: tuple[float, ...]) -> FloatArray:
    axis = whole_axis(edges)
    nodes, values = shipped.curve("basis", BASIS)
    raw = bin_means(nodes, values, axis, "hold")
    raw = raw / raw.sum(axis=1, keepdims=True)
    response = _d65_weights(axis).T @ raw
    if np.linalg.cond(response) > 1e3:
        raise ValueError(f"edges must separate the three sRGB primaries, but bins are too wide in {span(edges)}")
    first = axis.index(edges[0])
    return frozen((raw @ np.linalg.solve(response, _srgb_to_xyz(axis)))[first : first + len(edges) - 1])
