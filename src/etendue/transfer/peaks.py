"""A change of light relative to its largest value, wherever it is looked at: at the stage itself or behind later blurs.

In:  factors 1 - H by band and ring, the ``Content`` of the light, the share of each ring that is left.
Out: a bound on the change in the content's norm, relative to the largest value.

A blur lowers peaks: behind a wide blur, a point is hardly brighter than the mean. Therefore a change is compared with
the least that the largest value can be, and with it behind later Gaussian blurs of any width: the worst counts.

Two lower bounds of the largest value are known, and the larger counts:

- from the detail that is left: E[x^2] <= max(x) E[x] for x >= 0.
- from the scene, of which the largest values behind blurs of octave widths were looked up. A wider blur is a narrower
  one and another after it, and no mean with weights above 0 exceeds the largest value: so the value behind a wide blur
  is a lower bound for every narrower one. A transfer function H changes no point of the plane behind a blur by more
  than the sum of the amplitudes times |1 - H| and the share that the blur leaves. The sum is small behind a blur that
  is wider than that of H; so the largest value behind H and a narrow blur is bounded by one of the wider ones.

Sources: Parseval's theorem; the triangle inequality; Gaussian widths add in squares.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from etendue.contract.arrays.facts import Content
from etendue.contract.arrays.grid import Grid
from etendue.transfer import sampling
from etendue.types.arrays import Array, FloatArray

DIM = 1e-3  # of the brightest band: dimmer bands are compared with this share of it
SPOTS = 3.0  # excess of the rms over a few pixels above that over the frame, for light in one spot


class Change(NamedTuple):
    """A bound on a change: relative to the largest value of all bands, and that of the worst band relative to its own,
    for a later stage that may use only one band.
    """

    whole: float
    apart: float


class ContentArrays(NamedTuple):
    """The numbers of a ``Content`` as arrays."""

    edges: FloatArray
    power: FloatArray
    amplitude: FloatArray
    low: FloatArray
    mean: FloatArray
    widths: FloatArray
    peaks: FloatArray


@lru_cache(64)
def arrays_of(content: Content) -> ContentArrays:
    """Return a content as arrays, for sums over bands and rings."""
    values = (content.edges, content.power, content.amplitude, content.low, content.mean, content.widths, content.peaks)
    edges, power, amplitude, low, mean, widths, peaks = map(np.array, values)
    return ContentArrays(edges, power, amplitude, low, mean, widths, peaks)


def padding(grid: Grid) -> float:
    """Return the area of the padded plane over that of the frame: by it, the power in a content is too large."""
    sizes = [grid.line(dim).size for dim in ("y", "x")]
    return math.prod(sampling.padded_size(size) / size for size in sizes)


def shares(widths: FloatArray, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (width, ring): the largest and smallest share of a ring that Gaussian blurs leave."""
    share = np.exp(-2 * (math.pi * widths[:, None] * edges) ** 2)
    return share[:, :-1], share[:, 1:]


def behind(content: Content, changed: Array) -> FloatArray:
    """Return (band, width): what the largest values behind the blurs of ``content.widths`` at least are after a
    transfer function with |1 - H| of (band or 1, ring); no row if they are not known before it.
    """
    if not content.widths:
        return np.empty((0, 0))
    own = arrays_of(content)
    most = (np.asarray(changed) * own.amplitude) @ shares(own.widths, own.edges)[0].T
    least = np.maximum(own.peaks - most, 0.0)
    return np.asarray(np.maximum.accumulate(least[:, ::-1], axis=1)[:, ::-1])


def largest_at_least(content: Content, left: FloatArray, padded: float) -> FloatArray:
    """Return (..., band): what the largest value of a band at least is where ``left`` (..., band or 1, ring) of its
    detail is left, relative to ``content.full``.

    Above its smallest value, light has a mean d and a variance v, and its largest value is at least d + v / d.
    """
    own = arrays_of(content)
    low = np.minimum(own.low, own.mean)
    variance = (left**2 * own.power).sum(axis=-1) / padded
    above = np.maximum(own.mean - low, 1e-12)
    return np.asarray(np.maximum(low, 0.0) + above + variance / above)


def largest_behind(content: Content, changed: Array, left: Array, widths: FloatArray, padded: float) -> FloatArray:
    """Return (width, band): what the largest value of a band at least is behind a transfer function and a later
    Gaussian blur, relative to ``content.full``.

    Parameters
    ----------
    content : Content
        In front of the transfer function.
    changed, left : (band or 1, ring) arrays
        The largest |1 - H| and the smallest |H| in every ring.
    widths : (width,) array, um
        Of the later blurs.
    padded : float
        From ``padding``.
    """
    lower = shares(widths, arrays_of(content).edges)[1]
    found, least = largest_at_least(content, np.asarray(left) * lower[:, None], padded), behind(content, changed)
    if least.size:
        wider = np.searchsorted(arrays_of(content).widths, widths * (1 - 1e-9))
        known = np.concatenate([least, np.zeros((len(least), 1))], axis=1)
        found = np.maximum(found, known[:, wider].T)
    return found


def sites(content: Content, size: float) -> float:
    """Return in how many samples of a frame the light lies, of ``size``: its squared mean square over its fourth power,
    at least, from the largest value.
    """
    bands = zip(content.mean, content.power, content.high, strict=True)
    square = max(((m * m + sum(row)) / (h * h) for m, row, h in bands if h > 0), default=1.0)
    return max(1.0, size * min(square, 1.0))


def relative(factors: Array, left: Array, content: Content, grid: Grid) -> Change:
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
    Change
        For 'max' of the largest pixel. For 'rms' over the frame, and over its pixels: the fewer the spots in which
        light lies, the more their rms may exceed that of the frame (fitted), up to the largest pixel.
    """
    edges, factors = arrays_of(content).edges, np.asarray(factors)
    # rms widths of later Gaussian blurs, um: none, and from the finest ring to the coarsest, an octave apart
    count = max(1, math.ceil(math.log2(edges[-1] / edges[1])))
    widths = np.concatenate([[0.0], 2.0 ** np.arange(count + 1) / (2 * math.pi * edges[-1])])
    upper = shares(widths, edges)[0]
    largest = largest_behind(content, factors, left, widths, padding(grid))
    own = np.maximum(largest, DIM * largest.max(axis=1, keepdims=True))
    most = (factors * arrays_of(content).amplitude @ upper.T).T
    found = _both(most, own)
    if content.norm == "max":
        return found
    rms = np.sqrt(((factors**2 * arrays_of(content).power) @ (upper**2).T).T)
    size = grid.line("y").size * grid.line("x").size
    excess = 1 + SPOTS / math.sqrt(sites(content, size))
    return Change(*(min(one, excess * other) for one, other in zip(found, _both(rms, own), strict=True)))


def _both(change: FloatArray, largest: FloatArray) -> Change:
    """Return the worst of (width, band) changes."""
    return Change(float((change.max(axis=1) / largest.max(axis=1)).max()), float((change / largest).max()))


def largest_of_sums(weights: FloatArray, left: Array, content: Content, grid: Grid) -> FloatArray:
    """Return (sum,): what the largest value of weighted sums over the bands at least is, relative to ``content.full``.

    Parameters
    ----------
    weights : (sum, band) array
    left : (band or 1, ring) array
        The smallest share of every ring in the sums.
    content, grid
        As for ``relative``.
    """
    full = weights @ largest_at_least(content, np.asarray(left), padding(grid))
    return np.asarray(np.maximum(full, DIM * full.max()))


def relative_sums(lost: Array, full: FloatArray, content: Content, grid: Grid) -> float:
    """Return a bound on what is lost from weighted sums over the bands, relative to the largest value of a sum.

    Parameters
    ----------
    lost : (sum, band, ring) array
        The largest part, weights included. Bands are added in phase.
    full : (sum,) array
        From ``largest_of_sums``.
    content, grid
        As for ``relative``; so is the result, for the worst sum.
    """
    if not full.max() > 0:
        return 0.0
    own, flat = arrays_of(content), lost.reshape(len(lost), -1)
    worst = float(((flat @ own.amplitude.ravel()) / full).max())
    if content.norm == "max":
        return worst
    rms = np.sqrt(((lost * np.sqrt(own.power)).sum(axis=1) ** 2).sum(axis=1))
    size = grid.line("y").size * grid.line("x").size
    return min(worst, (1 + SPOTS / math.sqrt(sites(content, size))) * float((rms / full).max()))
