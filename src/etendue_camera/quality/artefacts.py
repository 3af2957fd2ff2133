"""Demosaicing artefacts: zipper edges and false colour.

In:  L*a*b* (3, y, x) of a picture and its reference on the same pixels (`difference.lab`), or L* alone (y, x).
Out: share of pixels; mean chroma error in areas with detail.
Sources: Lu and Tan 2003 (zipper effect); the false-colour measure is defined here.
"""

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue import require

NOTICEABLE = 2.3  # just noticeable CIE 1976 colour difference; Lu and Tan take it from Mahy et al. 1994
NEIGHBOURS = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]


def zipper(picture: ArrayLike, reference: ArrayLike, threshold: float = NOTICEABLE, falls: bool = True) -> float:
    """Return the fraction of pixels whose difference to their most similar neighbour changed noticeably.

    Parameters
    ----------
    picture, reference : (3, y, x) array, L*a*b*; or (y, x), L*
        Not RGB: the threshold is in CIELAB units.
    threshold : float, at least 0
        Minimum change, in CIE 1976 colour difference.
    falls : bool
        Whether differences that became smaller count too, as in the source. Blur causes these; without them only
        the saw-tooth pattern counts.

    Returns
    -------
    float, dimensionless
        0 for equal pictures, at most 1; 0 for a single pixel, which has no neighbour.

    Raises
    ------
    ValueError
        If shapes differ or do not fit, or the threshold is negative.

    Notes
    -----
    Source: Lu and Tan 2003, IEEE Trans. Image Processing 12(10), section IV: for each pixel, the most similar of its
    eight neighbours in the reference is chosen, and the colour difference to it is compared between the two pictures.
    At the border only neighbours inside the picture count. Among equally similar neighbours the
    smallest change counts, so that mirroring or rotating both pictures changes nothing.
    """
    picture, reference = _planes(picture, reference)
    require.only(threshold >= 0, "threshold", repr(threshold), "a number of at least 0")
    rows, columns = reference.shape[1:]
    nearest = np.full((rows, columns), np.inf)
    change = np.zeros((rows, columns))
    for dy, dx in NEIGHBOURS:
        here = np.s_[max(0, -dy) : rows - max(0, dy), max(0, -dx) : columns - max(0, dx)]
        there = np.s_[max(0, dy) : rows + min(0, dy), max(0, dx) : columns + min(0, dx)]
        distance = _distance(reference, here, there)
        rise = _distance(picture, here, there) - distance
        near, old = nearest[here], change[here]
        better = (distance < near) | ((distance == near) & (np.abs(rise) < np.abs(old)))
        nearest[here], change[here] = np.where(better, distance, near), np.where(better, rise, old)
    return float(np.count_nonzero((np.abs(change) if falls else change) > threshold) / change.size)


def false_colour(picture: ArrayLike, reference: ArrayLike) -> float:
    """Return the mean chroma error, weighted by the local detail of the reference.

    Parameters
    ----------
    picture, reference : (3, y, x) array, L*a*b*; or (y, x), L*
        A picture of L* alone has no chroma, hence no false colour.

    Returns
    -------
    float, CIELAB units
        Sum of w hypot(da*, db*) over the sum of w, where w is the range of the reference's L* over the surrounding
        3 x 3 pixels. 0 for equal pictures; the plain mean if the reference is uniform.

    Raises
    ------
    ValueError
        If shapes differ or do not fit.

    Notes
    -----
    False colour appears where fine lightness detail aliases into the sparse samples of red and blue. The weight is
    a local range instead of a gradient, because the central difference of the finest lines is 0. A wrong white
    balance counts as well, so compare pictures with the same balance.
    """
    picture, reference = _planes(picture, reference)
    if len(reference) < 3:
        return 0.0
    error = np.hypot(*(picture[1:] - reference[1:]))
    detail = scipy.ndimage.maximum_filter(reference[0], 3, mode="nearest") - scipy.ndimage.minimum_filter(
        reference[0], 3, mode="nearest"
    )
    total = float(detail.sum())
    return float((error * detail).sum() / total) if total > 0 else float(error.mean())


def _distance(planes: NDArray[np.float64], here: tuple[slice, ...], there: tuple[slice, ...]) -> NDArray[np.float64]:
    """Return the CIE 1976 colour difference between pixels and their neighbours."""
    steps = [plane[here] - plane[there] for plane in planes]
    return np.sqrt(sum(step * step for step in steps))


def _planes(picture: ArrayLike, reference: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    picture, reference = np.asarray(picture, np.float64), np.asarray(reference, np.float64)
    require.equal_shapes("picture", picture, "reference", reference)
    require.that(
        picture.size != 0 and (picture.ndim == 2 or (picture.ndim == 3 and len(picture) == 3)),
        f"picture has shape {picture.shape}; it must be (3, y, x), L*a*b*, or (y, x), L*",
    )
    return (picture, reference) if picture.ndim == 3 else (picture[None], reference[None])
