"""Bounds on a change of light relative to its largest value, at the output of a stage and after any later blur.

In:  factors 1 - H by band and ring, the ``Content`` of the light, the fraction |H| that remains of each ring.
Out: a bound on the change in the content's norm, relative to the largest value.

A blur lowers peaks: after a wide blur, a point is hardly brighter than the mean. Therefore a change is divided by a
lower bound of the largest value after the stage. The same ratio is computed after later Gaussian blurs of many widths,
and the largest ratio is returned.

There are two lower bounds of the largest value, and the larger one is used:

- from the power of the remaining detail: E[x^2] <= max(x) E[x] for x >= 0.
- from the largest values of the scene after Gaussian blurs of octave widths, which were computed once. A wide blur is a
  narrow blur followed by another blur, and a mean with positive weights never exceeds the largest value. Therefore the
  largest value after a wide blur is a lower bound of the largest value after every narrower blur. After a blur, a
  transfer function H changes a point by at most the sum of amplitude x |1 - H| x transmission of the blur. This sum is
  small for blurs wider than H itself; therefore the largest value after one of these wide blurs gives the bound after H
  and a narrower blur.

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

DIM = 1e-3  # fraction of the brightest band; a dimmer band is compared with this fraction instead of with itself
SPOTS = 3.0  # relative excess of the rms over a few pixels above that over the frame, for light in one spot


class Change(NamedTuple):
    """An upper bound of a change. ``whole``: the change relative to the largest value of all bands. ``apart``: the
    largest relative change of a single band, relative to the largest value of that band, for a later stage that uses
    only one band.
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
    """Return the area of the padded plane divided by that of the frame. The power in a ``Content`` is an upper bound
    that may be too large by this factor.
    """
    sizes = [grid.line(dim).size for dim in ("y", "x")]
    return math.prod(sampling.padded_size(size) / size for size in sizes)


def shares(widths: FloatArray, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest and the smallest value of the transfer function of each Gaussian blur in each ring, (width,
    ring).
    """
    share = np.exp(-2 * (math.pi * widths[:, None] * edges) ** 2)
    return share[:, :-1], share[:, 1:]


def behind(content: Content, changed: Array) -> FloatArray:
    """Return lower bounds of the largest values after a transfer function and the blurs of ``content.widths``, (band,
    width). ``changed`` is |1 - H|, (band or 1, ring). The result has no rows if the largest values before the transfer
    function are not known.
    """
    if not content.widths:
        return np.empty((0, 0))
    own = arrays_of(content)
    most = (np.asarray(changed) * own.amplitude) @ shares(own.widths, own.edges)[0].T
    least = np.maximum(own.peaks - most, 0.0)
    return np.asarray(np.maximum.accumulate(least[:, ::-1], axis=1)[:, ::-1])


def largest_at_least(content: Content, left: FloatArray, padded: float) -> FloatArray:
    """Return a lower bound of the largest value of each band, (..., band), relative to ``content.full``, after a blur
    that leaves the fraction ``left`` (..., band or 1, ring) of the detail of the band.

    Let d be the mean minus the smallest value, and v the variance. The largest value is then at least d + v / d above
    the smallest.
    """
    own = arrays_of(content)
    low = np.minimum(own.low, own.mean)
    variance = (left**2 * own.power).sum(axis=-1) / padded
    above = np.maximum(own.mean - low, 1e-12)
    return np.asarray(np.maximum(low, 0.0) + above + variance / above)


def largest_behind(content: Content, changed: Array, left: Array, widths: FloatArray, padded: float) -> FloatArray:
    """Return a lower bound of the largest value of each band after a transfer function and a later Gaussian blur,
    (width, band), relative to ``content.full``.

    Parameters
    ----------
    content : Content
        Content of the light before the transfer function.
    changed, left : (band or 1, ring) arrays
        The largest |1 - H| and the smallest |H| in every ring.
    widths : (width,) array, um
        Rms widths of the later blurs.
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
    """Return a lower bound of the effective number of samples over which the light of a frame of ``size`` samples is
    spread: size x (mean square)^2 / (mean fourth power), with a bound on the fourth power from the largest value.
    """
    bands = zip(content.mean, content.power, content.high, strict=True)
    square = max(((m * m + sum(row)) / (h * h) for m, row, h in bands if h > 0), default=1.0)
    return max(1.0, size * min(square, 1.0))


def relative(factors: Array, left: Array, content: Content, grid: Grid) -> Change:
    """Return an upper bound of the light in a content multiplied by ``factors``, relative to the largest value of the
    light that remains.

    Parameters
    ----------
    factors, left : (band or 1, ring) arrays
        The largest |1 - H| and the smallest |H| in every ring.
    content : Content
    grid : Grid
        Grid of the light.

    Returns
    -------
    Change
        For the norm 'max', the change of the sample that changes most. For the norm 'rms', the rms change over the
        samples of the frame and over the pixels that sample it later. If light lies in few spots, the rms over the
        pixels may exceed the rms over the frame; the excess is fitted, and never exceeds the bound of the largest
        change.
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
    """Return the largest ratio of ``change`` to ``largest`` over all widths, for the largest value of all bands and for
    each band's own.
    """
    return Change(float((change.max(axis=1) / largest.max(axis=1)).max()), float((change / largest).max()))


def largest_of_sums(weights: FloatArray, left: Array, content: Content, grid: Grid) -> FloatArray:
    """Return a lower bound of the largest value of each weighted sum over the bands, (sum,), relative to
    ``content.full``.

    Parameters
    ----------
    weights : (sum, band) array
    left : (band or 1, ring) array
        The smallest |H| in every ring.
    content, grid
        As for ``relative``.
    """
    full = weights @ largest_at_least(content, np.asarray(left), padding(grid))
    return np.asarray(np.maximum(full, DIM * full.max()))


def relative_sums(lost: Array, full: FloatArray, content: Content, grid: Grid) -> float:
    """Return an upper bound of the light that is missing from weighted sums over the bands, relative to the largest
    value of each sum; of several sums, the largest bound.

    Parameters
    ----------
    lost : (sum, band, ring) array
        The largest fraction lost, times the weight of the band. All bands are assumed to add in phase.
    full : (sum,) array
        From ``largest_of_sums``.
    content, grid
        As for ``relative``, which also defines the norm of the result.
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
