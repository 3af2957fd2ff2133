"""Spectra for RGB: reflectances whose colours under D65 are those of linear sRGB.

In:  bin edges of a wavelength axis, nm.
Out: a basis (bins, 3), and the matrix its colours are those of.
Source: Mallett & Yuksel (2019), corrected to the bins.
"""

from functools import lru_cache

import numpy as np

from etendue.spectra.bins import Edges, FloatArray, bin_means, checked_edges, frozen
from etendue.spectra.library import colour_matching, colour_science, rows_of, smooth_rows, span

# ------------------------------------------------------------------------------------- RGB to reflectance


def srgb_to_xyz(edges: Edges) -> FloatArray:
    """Matrix from linear sRGB to XYZ (Y of white = 1) for the primaries of sRGB and the D65 of these bins.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm

    Returns
    -------
    (3, 3) array

    Notes
    -----
    The four digits of IEC 61966-2-1 describe a white of (0.9505, 1, 1.0890); sums over bins give a slightly
    different one. This matrix keeps the chromaticities of the primaries and sends (1, 1, 1) to the white the
    bins have: the largest difference from the standard's is 4.6e-4 (1 nm bins), 6.0e-4 (5 nm) or 1.03e-3
    (10 nm) over 380-780 nm.
    """
    return _srgb_to_xyz(checked_edges(edges))


@lru_cache(maxsize=32)
def _srgb_to_xyz(edges: tuple[float, ...]) -> FloatArray:
    white = _d65_weights(edges).sum(axis=0)
    x, y = np.asarray(colour_science().RGB_COLOURSPACES["sRGB"].primaries, dtype=np.float64).reshape(3, 2).T
    primaries = np.stack([x / y, np.ones(3), (1.0 - x - y) / y])
    return frozen(primaries * np.linalg.solve(primaries, white))


def _d65_weights(edges: tuple[float, ...]) -> FloatArray:
    """(n, 3) weights with ``reflectance @ weights`` = XYZ under D65.

    colour-science tabulates D65 up to 780 nm. Bins beyond count as dark here (the eye's response there is
    1e-5), so that an axis to 1100 nm can still show photographs.
    """
    nodes, values = rows_of(colour_science().SDS_ILLUMINANTS["D65"])
    power = bin_means(nodes, values, edges, "zero") * np.diff(edges)
    weights = power[:, None] * colour_matching(edges)
    total = weights[:, 1].sum()
    if total == 0:
        raise ValueError(f"edges must reach into the visible, got {span(edges)}")
    return weights / total


def upsampling_basis(edges: Edges) -> FloatArray:
    """Reflectance spectra of linear sRGB: ``reflectance = basis @ rgb``.

    Parameters
    ----------
    edges : (n + 1,) ascending, nm; at least three bins in the visible

    Returns
    -------
    (n, 3) array, dimensionless
        Columns add up to 1 in every bin, so that grey photographs get flat spectra.

    Raises
    ------
    ValueError
        Bins too few or too far from the visible to tell three primaries apart.

    Notes
    -----
    Source: the basis of Mallett & Yuksel (2019, https://doi.org/10.2312/sr.20191216), Sprague to 1 nm, means
    over the bins, held outside 380-780 nm. Two corrections: each row is divided by its sum (which is 1 within
    1e-5), and a 3 x 3 matrix makes the round trip exact in these bins, that is sum(basis x D65 x observer) =
    ``srgb_to_xyz(edges)``. Together they move the basis by at most 1.2e-3 (5 nm bins), 4.6e-3 (10 nm) and
    2.2e-2 (20 nm).
    Error: round trip below 1e-15, sum of columns within 2e-15 of 1. Values within [0.0029, 0.978] for 10 nm
    bins over 380-780 nm, so that RGB inside [0, 1] gives reflectances inside [0, 1]; bins of 20 nm reach
    -0.0064.
    """
    return _upsampling_basis(checked_edges(edges))


@lru_cache(maxsize=32)
def _upsampling_basis(edges: tuple[float, ...]) -> FloatArray:
    table = colour_science().recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    raw = bin_means(*smooth_rows(table), edges, "hold")
    raw = raw / raw.sum(axis=1, keepdims=True)
    response = _d65_weights(edges).T @ raw
    if np.linalg.cond(response) > 1e3:
        raise ValueError(f"edges must tell the three sRGB primaries apart, got {span(edges)}")
    return frozen(raw @ np.linalg.solve(response, srgb_to_xyz(edges)))
