"""The content of light that is a mixture of a few planes: quantities needed for all bands are computed once per plane.

In:  planes (k, y, x) and their weights (band, k); the light of a band is the sum of weight times plane.
Out: for each band, the numbers that ``contents`` computes from single planes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from etendue.transfer import rings, sampling
from etendue.types.arrays import Array, FloatArray

TOGETHER = 1 << 14  # values of a band that are mixed at a time: all bands of them fit a core's cache


def looked_at(
    planes: Sequence[Array], weights: FloatArray, steps: tuple[float, float], edges: FloatArray, widths: FloatArray
) -> list[Any] | None:
    """Return (low, mean, high, power, amplitude, peaks) of every band, equal to those computed from the plane of the
    band; None if a value is not finite.
    """
    full = float(np.max([(plane.max(), -plane.min()) for plane in planes])) or 1.0
    if not (math.isfinite(full) and np.isfinite(weights).all()):
        return None
    shape = planes[0].shape
    own = np.empty((len(planes), *shape), dtype=np.float32)
    for number in range(len(own)):
        np.divide(planes[number], full, out=own[number], dtype=np.float64, casting="same_kind")
    factors = np.asarray(weights * full, dtype=np.float64)
    scale = np.abs(factors).sum(axis=1)
    scale[scale == 0] = 1.0
    mixed = np.asarray(factors / scale[:, None], dtype=np.float32)
    low, high = _ends(mixed, list(own))
    mean = mixed @ own.mean(axis=(1, 2), dtype=np.float64)
    halves = [sampling.transform(plane) for plane in own]
    del own
    blurred = [rings.blurred(half, shape, steps, widths) for half in halves]
    peaks = np.stack([high, *(_peaks(mixed, one) for one in zip(*blurred, strict=True))])
    peaks = np.where(high > 0, np.minimum.accumulate(peaks), 0.0)
    power, amplitude = _ring_sums(mixed, halves, shape, steps, edges)
    return [
        (float(low[b] * s), float(mean[b] * s), float(high[b] * s), power[b] * s**2, amplitude[b] * s, peaks[:, b] * s)
        for b, s in enumerate(scale)
    ]


def _ends(mixed: FloatArray, planes: Sequence[Array]) -> tuple[Array, Array]:
    """Return the smallest and the largest value of every band."""
    found = [(light.min(axis=1), light.max(axis=1)) for light in _mixed(mixed, planes)]
    return np.min([low for low, _ in found], axis=0), np.max([high for _, high in found], axis=0)


def _peaks(mixed: FloatArray, planes: Sequence[Array]) -> Array:
    """Return the largest value of every band, minus the rounding error of the transforms; ``planes`` are blurred."""
    low, high = _ends(mixed, planes)
    return high - rings.ROUNDING * np.maximum(np.abs(low), np.abs(high))


def _mixed(mixed: FloatArray, planes: Sequence[Array]) -> Iterator[Array]:
    """Yield (band, n) arrays: the light of all bands in the next n samples."""
    flat = [np.ascontiguousarray(plane).reshape(-1) for plane in planes]
    for start in range(0, flat[0].size, TOGETHER):
        yield mixed @ np.stack([plane[start : start + TOGETHER] for plane in flat])


def _ring_sums(
    mixed: FloatArray, halves: list[Array], shape: tuple[int, ...], steps: tuple[float, float], edges: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``rings.ring_sums`` of all bands, (band, ring)."""
    by_ring = _kept_by_ring if math.prod(shape) <= sampling.LARGE else _by_ring
    order, starts, twice = by_ring(shape[0], shape[1], *steps, tuple(map(float, edges)))
    total = math.prod(map(sampling.padded_size, shape))
    flat = [half.reshape(-1) for half in halves]
    for half in flat:
        half[0] = 0
    scale = np.float32(1.0 / total)
    power, amplitude = np.zeros((2, len(mixed), edges.size - 1))
    for ring, (start, stop) in enumerate(pairwise(starts)):
        for first in range(start, stop, TOGETHER):
            part = slice(first, min(first + TOGETHER, stop))
            some = np.stack([half.take(order[part]) for half in flat])
            squared = (mixed @ (some.real * scale)) ** 2 + (mixed @ (some.imag * scale)) ** 2
            power[:, ring] += squared @ twice[part]
            amplitude[:, ring] += np.sqrt(squared) @ twice[part]
    return power * (total / math.prod(shape)), amplitude


def _by_ring(
    size_y: int, size_x: int, step_y: float, step_x: float, edges: tuple[float, ...]
) -> tuple[NDArray[np.int32], tuple[int, ...], FloatArray]:
    """Return the indices that sort a half transform by ring, the start of each ring in this order, and how many values
    of the full transform each sorted value stands for.
    """
    rows = sampling.frequencies(size_y, step_y, half=False)
    columns = sampling.frequencies(size_x, step_x, half=True)
    ring = np.empty((rows.size, columns.size), np.min_scalar_type(len(edges)))  # small integers are sorted fastest
    for row, own in zip(rows, ring, strict=True):
        own[:] = rings.rings_of(np.hypot(row, columns), np.array(edges))
    order = np.argsort(ring, axis=None, kind="stable").astype(np.int32)
    starts = np.concatenate([[0], np.cumsum(np.bincount(ring.ravel(), minlength=len(edges) - 1))])
    twice = rings.counted(columns.size, sampling.padded_size(size_x)).astype(np.float32)
    return order, tuple(map(int, starts)), twice[order % columns.size]


_kept_by_ring = lru_cache(4)(_by_ring)
