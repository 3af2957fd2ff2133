"""The content of light that is a mixture of a few planes: quantities needed for all bands are computed once per plane.

In:  planes (k, y, x) and their weights (band, k); the light of a band is the sum of weight times plane.
Out: for each band, the numbers that ``contents`` computes from single planes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.transfer import rings, sampling
from etendue.types.arrays import Array, FloatArray

TOGETHER = 1 << 14  # values of a band that are mixed at a time: all bands of them fit a core's cache


def looked_at(
    planes: FloatArray, weights: FloatArray, steps: tuple[float, float], edges: FloatArray, widths: FloatArray
) -> list[Any] | None:
    """Return (low, mean, high, power, amplitude, peaks) of every band, as if computed from its own plane; None if a
    value is not finite.
    """
    full = float(np.abs(planes).max()) or 1.0
    if not (math.isfinite(full) and np.isfinite(weights).all()):
        return None
    own = np.asarray(planes / full, dtype=np.float32)
    factors = np.asarray(weights * full, dtype=np.float64)
    scale = np.abs(factors).sum(axis=1)
    scale[scale == 0] = 1.0
    mixed = np.asarray(factors / scale[:, None], dtype=np.float32)
    halves = [sampling.transform(plane) for plane in own]
    blurred = [rings.blurred(half, own.shape[1:], steps, widths) for half in halves]
    low, high = _ends(mixed, own)
    peaks = np.stack([high, *(_peaks(mixed, np.stack(one)) for one in zip(*blurred, strict=True))])
    peaks = np.where(high > 0, np.minimum.accumulate(peaks), 0.0)
    mean = mixed @ own.mean(axis=(1, 2), dtype=np.float64)
    power, amplitude = _ring_sums(mixed, halves, own.shape[1:], steps, edges)
    return [
        (float(low[b] * s), float(mean[b] * s), float(high[b] * s), power[b] * s**2, amplitude[b] * s, peaks[:, b] * s)
        for b, s in enumerate(scale)
    ]


def _ends(mixed: FloatArray, planes: FloatArray) -> tuple[Array, Array]:
    """Return the smallest and the largest value of every band."""
    found = [(light.min(axis=1), light.max(axis=1)) for light in _mixed(mixed, planes)]
    return np.min([low for low, _ in found], axis=0), np.max([high for _, high in found], axis=0)


def _peaks(mixed: FloatArray, planes: FloatArray) -> Array:
    """Return the largest value of every band of blurred planes, reduced by the error of their transforms."""
    low, high = _ends(mixed, planes)
    return high - rings.ROUNDING * np.maximum(np.abs(low), np.abs(high))


def _mixed(mixed: FloatArray, planes: Array) -> Iterator[Array]:
    """Yield some values of all bands at a time."""
    flat = planes.reshape(len(planes), -1)
    for start in range(0, flat.shape[1], TOGETHER):
        yield mixed @ flat[:, start : start + TOGETHER]


def _ring_sums(
    mixed: FloatArray, halves: list[Array], shape: tuple[int, ...], steps: tuple[float, float], edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``rings.ring_sums`` of all bands, (band, ring)."""
    order, starts, twice = _by_ring(shape[0], shape[1], *steps, tuple(map(float, edges)))
    total = math.prod(map(sampling.padded_size, shape))
    every = np.empty((2, len(halves), order.size), dtype=np.float32)
    for number, half in enumerate(halves):
        half[0, 0] = 0
        ordered = half.ravel()[order]
        every[0, number], every[1, number] = ordered.real, ordered.imag
    every *= np.float32(1.0 / total)
    power, amplitude = np.zeros((2, len(mixed), edges.size - 1))
    for ring, (start, stop) in enumerate(pairwise(starts)):
        for first in range(start, stop, TOGETHER):
            part = slice(first, min(first + TOGETHER, stop))
            squared = (mixed @ every[0, :, part]) ** 2 + (mixed @ every[1, :, part]) ** 2
            power[:, ring] += squared @ twice[part]
            amplitude[:, ring] += np.sqrt(squared) @ twice[part]
    return power * (total / math.prod(shape)), amplitude


@lru_cache(4)
def _by_ring(
    size_y: int, size_x: int, step_y: float, step_x: float, edges: tuple[float, ...]
) -> tuple[NDArray[np.int32], tuple[int, ...], FloatArray]:
    """Return the values of a half transform ordered by ring, the start of each ring, and the number of times that each
    value counts.
    """
    rows = sampling.frequencies(size_y, step_y, half=False)
    columns = sampling.frequencies(size_x, step_x, half=True)
    ring = rings.rings_of(np.hypot(rows[:, None], columns), np.array(edges)).ravel()
    order = np.argsort(ring, kind="stable").astype(np.int32)
    starts = np.searchsorted(ring[order], np.arange(len(edges)))
    twice = np.broadcast_to(rings.counted(columns.size, sampling.padded_size(size_x)), (rows.size, columns.size))
    return order, tuple(map(int, starts)), twice.astype(np.float32).ravel()[order]
