"""A change of light relative to its largest value, wherever it is looked at: at the stage itself or behind later blurs.

In:  factors 1 - H by band and ring, the ``Content`` of the light, the share of each ring that is left.
Out: a bound on the change in the content's norm, relative to the largest value.

A blur lowers peaks: behind a wide blur, a point is hardly brighter than the mean. Therefore a change is compared with
the least that the largest value can be, and with it behind later Gaussian blurs of any width: the worst counts. Bands
are compared each with itself, because a later stage may weigh them in any way.
Sources: Parseval's theorem; the triangle inequality; E[x^2] <= max(x) E[x] for x >= 0.
"""

from __future__ import annotations

import math

import numpy as np

from etendue.contract.arrays.facts import Content
from etendue.contract.arrays.grid import Grid
from etendue.transfer import sampling
from etendue.types.arrays import Array, FloatArray

DIM = 1e-3  # of the brightest band: dimmer bands are compared with this share of it
SPOTS = 3.0  # excess of the rms over a few pixels above that over the frame, for light in one spot


def padding(grid: Grid) -> float:
    """Return the area of the padded plane over that of the frame: by it, the power in a content is too large."""
    sizes = [grid.line(dim).size for dim in ("y", "x")]
    return math.prod(sampling.padded_size(size) / size for size in sizes)


def later_blurs(edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (width, ring): the largest and smallest share of a ring that a Gaussian blur leaves, for none and for
    widths from the finest ring to the coarsest, an octave apart.
    """
    finest, coarsest = edges[-1], edges[1]
    count = max(1, math.ceil(math.log2(finest / coarsest)))
    sigma = np.concatenate([[0.0], 2.0 ** np.arange(count + 1) / (2 * math.pi * finest)])
    share = np.exp(-2 * (math.pi * sigma[:, None] * edges) ** 2)
    return share[:, :-1], share[:, 1:]


def largest_at_least(content: Content, left: FloatArray, padded: float) -> FloatArray:
    """Return (..., band): what the largest value of a band at least is where ``left`` (..., band or 1, ring) of its
    detail is left, relative to ``content.full``.

    Above its smallest value, light has a mean d and a variance v, and its largest value is at least d + v / d.
    """
    low, mean = np.minimum(np.array(content.low), np.array(content.mean)), np.array(content.mean)
    variance = (left**2 * np.array(content.power)).sum(axis=-1) / padded
    above = np.maximum(mean - low, 1e-12)
    return np.asarray(np.maximum(low, 0.0) + above + variance / above)


def sites(content: Content, size: float) -> float:
    """Return in how many samples of a frame the light lies, of ``size``: its squared mean square over its fourth power,
    at least, from the largest value.
    """
    bands = zip(content.mean, content.power, content.high, strict=True)
    square = max(((m * m + sum(row)) / (h * h) for m, row, h in bands if h > 0), default=1.0)
    return max(1.0, size * min(square, 1.0))


def relative(factors: Array, left: Array, content: Content, grid: Grid) -> float:
    """Return a bound on light times ``factors``, relative to the largest value of what is left.

    Parameters
    ----------
    factors, left : (band or 1, ring) arrays
        The largest |1 - H| and the smallest |H| in every ring.
    content : Content
    grid : Grid
        Of the light.

    Returns
    -------
    float
        For 'max' of the largest pixel. For 'rms' over the frame, and over its pixels: the fewer the spots in which
        light lies, the more their rms may exceed that of the frame (fitted), up to the largest pixel.
    """
    edges, factors, padded = np.array(content.edges), np.asarray(factors), padding(grid)
    upper, lower = later_blurs(edges)
    peaks = largest_at_least(content, np.asarray(left) * lower[:, None], padded)
    peaks = np.maximum(peaks, DIM * peaks.max(axis=1, keepdims=True))
    most = (factors * np.array(content.amplitude) @ upper.T).T
    worst = float((most / peaks).max())
    if content.norm == "max":
        return worst
    square = ((factors**2 * np.array(content.power)) @ (upper**2).T).T
    size = grid.line("y").size * grid.line("x").size
    return min(worst, (1 + SPOTS / math.sqrt(sites(content, size))) * float((np.sqrt(square) / peaks).max()))


def relative_sums(lost: Array, weights: FloatArray, left: Array, content: Content, grid: Grid) -> float:
    """Return a bound on what is lost from weighted sums over the bands, relative to the largest value of a sum.

    Parameters
    ----------
    lost : (sum, band, ring) array
        The largest part, weights included. Bands are added in phase.
    weights : (sum, band) array
    left : (band or 1, ring) array
        The smallest share of every ring in the sums.
    content, grid
        As for ``relative``; so is the result, for the worst sum.
    """
    full = weights @ largest_at_least(content, np.asarray(left), padding(grid))
    full = np.maximum(full, DIM * full.max())
    if not full.max() > 0:
        return 0.0
    most = np.einsum("cbr,br->c", lost, np.array(content.amplitude))
    worst = float((most / full).max())
    if content.norm == "max":
        return worst
    rms = np.sqrt((np.einsum("cbr,br->cr", lost, np.sqrt(np.array(content.power))) ** 2).sum(axis=1))
    size = grid.line("y").size * grid.line("x").size
    return min(worst, (1 + SPOTS / math.sqrt(sites(content, size))) * float((rms / full).max()))
