"""The content of light by radial frequency, in rings. It bounds the change that a blur can cause in a scene.

In:  planes of light; factors 1 - H of a transfer function at the ends of the rings.
Out: mean squares and amplitudes by ring; largest values behind blurs; bounds for light times the factors.
Sources: Parseval's theorem; the triangle inequality for the largest value.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from etendue.transfer import sampling
from etendue.types.arrays import FloatArray

ComplexArray = NDArray[np.complexfloating]

PER_OCTAVE = 6
BLOCK = 1 << 19  # values of a transform processed at a time
CUT = 1.0  # cycles per width; a Gaussian blur transmits less than 3e-9 of higher frequencies
# Error of transforms in single precision and of frequencies that are cut off, relative to the largest value.
ROUNDING = 2e-6


def ring_edges(size_y: int, size_x: int, step_y: float, step_x: float) -> FloatArray:
    """Return the ends of rings of radial frequency, cycles/um: from 0, six per octave, to the corner of the transform.

    Parameters
    ----------
    size_y, size_x : int
        Samples of the frame.
    step_y, step_x : float
        Distance between samples, um.

    Returns
    -------
    (n + 1,) array, ascending
    """
    corner = 0.5 * math.hypot(1 / step_y, 1 / step_x)
    lowest = 1 / max(sampling.padded_size(size_y) * step_y, sampling.padded_size(size_x) * step_x)
    count = max(1, math.ceil(PER_OCTAVE * math.log2(corner / lowest)))
    return np.concatenate([[0.0], corner * 2.0 ** (-np.arange(count, -1, -1) / PER_OCTAVE)])


def ring_sums(plane: FloatArray, step_y: float, step_x: float, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean square and the sum of amplitudes of a plane, without its mean, in rings of radial frequency.

    Parameters
    ----------
    plane : (y, x) array
    step_y, step_x : float
        um
    edges : (n + 1,) array
        From ``ring_edges``.

    Returns
    -------
    power, amplitude : (n,) arrays
        Values of the padded plane; ``power`` is multiplied by the area of the padded plane divided by that of the
        frame. Both are upper bounds: the mean square of the plane minus its mean is at most the sum of ``power``, and
        no value differs from the mean by more than the sum of ``amplitude``.
    """
    ny, nx = plane.shape
    half = sampling.transform(np.ascontiguousarray(plane))
    half[0, 0] = 0
    total_y, total_x = sampling.padded_size(ny), sampling.padded_size(nx)
    twice = counted(half.shape[1], total_x)
    rows = sampling.frequencies(ny, step_y, half=False)
    columns = sampling.frequencies(nx, step_x, half=True)
    power, amplitude = np.zeros(edges.size - 1), np.zeros(edges.size - 1)
    each = max(1, BLOCK // half.shape[1])
    for start in range(0, half.shape[0], each):
        part = np.abs(half[start : start + each]) * (1.0 / (total_y * total_x))
        ring = rings_of(np.hypot(rows[start : start + each, None], columns), edges).ravel()
        amplitude += np.bincount(ring, (part * twice).ravel(), edges.size - 1)
        power += np.bincount(ring, (part * part * twice).ravel(), edges.size - 1)
    return power * (total_y * total_x / (ny * nx)), amplitude


def counted(columns: int, total: int) -> FloatArray:
    """Return how many columns of the full transform each column of a half transform stands for: one at frequency 0 and,
    for an even number of samples, at the highest frequency; otherwise two.
    """
    twice = np.full(columns, 2.0)
    twice[0] = 1.0
    if total % 2 == 0:
        twice[-1] = 1.0
    return twice


def blur_widths(size_y: int, size_x: int, step_y: float, step_x: float) -> FloatArray:
    """Return rms widths of Gaussian blurs, um, (n,): 0, one sample, and further widths in octaves up to an eighth of
    the frame.
    """
    step, side = max(step_y, step_x), min(size_y * step_y, size_x * step_x)
    count = max(1, math.floor(math.log2(max(side / (8 * step), 1.0))) + 1)
    return np.concatenate([[0.0], step * 2.0 ** np.arange(count)])


def largest_behind(plane: FloatArray, step_y: float, step_x: float, widths: FloatArray) -> FloatArray:
    """Return a lower bound of the largest value of a plane after each of the Gaussian blurs with rms widths ``widths``
    (um), (width,).

    Notes
    -----
    A blur transmits almost nothing above the frequency ``CUT`` / width. The inverse transform therefore uses only as
    many samples as these frequencies need, and all widths together cost about two transforms. The largest sample within
    the frame is a lower bound, because the largest value may lie between samples.
    """
    half = sampling.transform(np.ascontiguousarray(plane))
    found = [float(plane.max())]
    for own in blurred(half, plane.shape, (step_y, step_x), widths):
        found.append(float(own.max()) - ROUNDING * float(np.abs(own).max()))
    return np.minimum.accumulate(np.array(found))


def blurred(
    half: ComplexArray, shape: tuple[int, ...], steps: tuple[float, float], widths: FloatArray
) -> Iterator[FloatArray]:
    """Yield the plane with this half transform after each blur except the first, whose width is 0. A plane has only as
    many samples as its remaining frequencies need.
    """
    ny, nx = shape
    total_y, total_x = sampling.padded_size(ny), sampling.padded_size(nx)
    for width in map(float, widths[1:]):
        rows, columns = (
            min(math.ceil(CUT * total * step / width), total // 2)
            for total, step in ((total_y, steps[0]), (total_x, steps[1]))
        )
        across = np.arange(columns + 1)
        up, down = np.arange(rows + 1), np.arange(-rows + (2 * rows == total_y), 0)
        fx = across / (total_x * steps[1])
        few_y, few_x = (
            min(sampling.fast_length(2 * rows + 1), total_y),
            min(sampling.fast_length(2 * columns + 1), total_x),
        )
        low = np.zeros((few_y, few_x // 2 + 1), dtype=half.dtype)
        for some in (up, down):
            own = slice(0, rows + 1) if some is up else slice(-down.size, None)
            if some.size:
                weights = [
                    np.exp(-2 * (math.pi * width * f) ** 2).astype(half.real.dtype)
                    for f in (some / (total_y * steps[0]), fx)
                ]
                part = low[own, : columns + 1]
                np.multiply(half[own, : columns + 1], weights[0][:, None], out=part)
                part *= weights[1]
        within = slice((ny - 1) * few_y // total_y + 1), slice((nx - 1) * few_x // total_x + 1)
        small = sampling.inverse(low, (few_y, few_x), *within, own=True)
        del low, part
        small *= few_y * few_x / (total_y * total_x)
        yield small


def rings_of(radial: FloatArray, edges: FloatArray) -> NDArray[np.intp]:
    """Return the ring that contains each radial frequency."""
    count = edges.size - 2
    place = np.ceil(np.log2(np.maximum(radial, 1e-300) / edges[-1]) * PER_OCTAVE + (count - 1e-9))
    return np.clip(place, 0, count).astype(np.intp)


def frequencies_in(edges: FloatArray) -> FloatArray:
    """Return the ends of n rings and the middle of each, (2 n + 1,)."""
    found = np.empty(2 * edges.size - 1)
    found[::2] = edges
    found[1::2] = 0.5 * (edges[:-1] + edges[1:])
    return found


def largest_in_rings(values: FloatArray) -> FloatArray:
    """Return for every ring the largest of its values at both ends and in the middle: (..., 2 n + 1) to (..., n)."""
    return np.maximum(np.maximum(values[..., :-2:2], values[..., 2::2]), values[..., 1::2])


def moved(distance: float, edges: FloatArray) -> FloatArray:
    """Return, for each ring, the largest |1 - exp(2 pi i f d)|: a bound for light that is displaced by at most
    ``distance`` (um).
    """
    return np.asarray(2 * np.sin(np.pi * np.minimum(edges[1:] * abs(distance), 0.5)))
