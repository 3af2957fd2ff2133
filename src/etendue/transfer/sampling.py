"""Sampled planes: padding, transforms, transfer functions applied once, and evaluation between samples.

In:  planes sampled at ``start + step * i`` um; transfer functions at spatial frequencies in cycles/um.
Out: filtered planes on the same grid, or evaluated at any separable set of positions.
Sources: the discrete Fourier transform; trigonometric interpolation (a band-limited plane is defined everywhere).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue.types.arrays import FloatArray

KEPT_WAVES = 1 << 20  # bytes of the largest matrix of waves that is cached for the next plane
TOGETHER = 1 << 17  # samples transformed in one call
STRIP = 2  # times as many samples of a large plane are made at once
LARGE = 1 << 20  # samples of a plane that is transformed in strips and in place
FEW = 64  # up to this many outputs per row of a transform, two matrix products are cheaper than an inverse transform

ComplexArray = NDArray[np.complexfloating]


def padded_size(size: int) -> int:
    """Return the number of samples of a padded axis: an eighth of the frame is added per side (16 to 128), then rounded
    up to a fast length.
    """
    return fast_length(size + 2 * max(16, min(-(-size // 8), 128)))


@lru_cache(1024)
def fast_length(size: int) -> int:
    """Return the smallest number without prime factors above 5 that is at least ``size``: the lengths of fast real
    transforms. The result equals ``scipy.fft.next_fast_len(size, real=True)``, but planning does not have to import
    scipy.
    """
    best, fives = 1 << max(size - 1, 0).bit_length(), 1
    while fives < best:
        threes = fives
        while threes < best:
            twos = threes << max(-(-size // threes) - 1, 0).bit_length()
            best = min(best, twos)
            threes *= 3
        fives *= 5
    return best


def _gap(plane: FloatArray, total: int, axis: int) -> FloatArray:
    """Return the padding between the end of an axis and its periodic start: the mirrored end, cross-faded into the
    mirrored start.
    """
    size = plane.shape[axis]
    gap = total - size
    shape = [1] * plane.ndim
    shape[axis] = -1
    weight = _fading(gap).reshape(shape).astype(plane.dtype)
    if gap <= size:  # slices take a tenth of the time of ``take`` along x
        ends = np.moveaxis(plane, axis, 0)
        after, before = (np.moveaxis(end[::-1], 0, axis) for end in (ends[size - gap :], ends[:gap]))
    else:
        t = np.arange(gap)
        after_end = np.abs((size - 1 - t) % (2 * size))
        after_end = np.where(after_end >= size, 2 * size - 1 - after_end, after_end)
        before_start = (gap - 1 - t) % (2 * size)
        before_start = np.where(before_start >= size, 2 * size - 1 - before_start, before_start)
        after, before = np.take(plane, after_end, axis), np.take(plane, before_start, axis)
    return (1 - weight) * after + weight * before


def _fading(gap: int) -> FloatArray:
    """Return the weight of the mirrored start in each sample of the padding, from 0 to 1; the mirrored end has the
    rest.
    """
    return 0.5 - 0.5 * np.cos(np.pi * (np.arange(gap) + 0.5) / max(gap, 1))


def pad(planes: FloatArray) -> FloatArray:
    """Extend planes beyond their border by their mirror image, periodic without a seam.

    Parameters
    ----------
    planes : (..., ny, nx) array

    Returns
    -------
    (..., Ny, Nx) array
        The frame is at [0:ny, 0:nx]. Beyond it the mirrored ends are cross-faded, so the periodic plane has no
        step: within its reach a blur meets a mirror image, never the opposite border.

    Notes
    -----
    A mirror is the best guess for a photograph (error at the border 8e-5 of full scale at f/2.8 on a 256-sample edge
    image; zero padding 4.5e-2). Charts render a real margin, which makes it exact.
    """
    ny, nx = planes.shape[-2:]
    whole = np.empty((*planes.shape[:-2], padded_size(ny), padded_size(nx)), dtype=planes.dtype)
    whole[..., :ny, :nx] = planes
    whole[..., ny:, :nx] = _gap(planes, whole.shape[-2], planes.ndim - 2)
    whole[..., nx:] = _gap(whole[..., :nx], whole.shape[-1], planes.ndim - 1)
    return whole


def transform(planes: FloatArray, columns: int | None = None) -> ComplexArray:
    """Return the half transform of padded planes, (..., Ny, Nx//2 + 1), in the complex type of the input's
    precision; or only its first ``columns``.
    """
    ny, nx = (padded_size(size) for size in planes.shape[-2:])
    columns = columns or nx // 2 + 1
    if planes.ndim == 2:
        plane = None
        if planes.size > LARGE:
            plane = transform_of_rows(planes.__getitem__, planes.shape[0], planes.shape[1], planes.dtype, columns)
        return scipy.fft.rfft2(pad(planes), workers=1)[:, :columns] if plane is None else plane
    found = np.empty((*planes.shape[:-2], ny, columns), dtype=np.result_type(planes.dtype, np.complex64))
    for some in groups(planes.shape):
        found[some] = scipy.fft.rfft2(pad(planes[some]), workers=1)[..., :columns]
    return found


def transform_of_rows(
    rows_of: Callable[[slice], FloatArray], ny: int, nx: int, dtype: np.dtype[np.generic], columns: int
) -> ComplexArray | None:
    """Return the transform of a large plane, see ``transforms_of_rows``; None for a plane of few rows."""
    found = transforms_of_rows(lambda rows: rows_of(rows)[None], 1, ny, nx, dtype, columns)
    return None if found is None else found[0]


def transforms_of_rows(
    rows_of: Callable[[slice], FloatArray], count: int, ny: int, nx: int, dtype: np.dtype[np.generic], columns: int
) -> list[ComplexArray] | None:
    """Return the transforms of large planes, with the same bits as ``rfft2``: some rows of all planes at a time are
    made, padded and transformed, then the columns are transformed in place. No other array of a plane's size is held.
    Return None for planes of few rows.

    ``rows_of`` returns (count, rows, nx) for successive slices of rows.
    """
    total_y, total_x = padded_size(ny), padded_size(nx)
    gap = total_y - ny
    if ny < 2 * gap:
        return None
    halves = [np.empty((total_y, columns), dtype=np.result_type(dtype, np.complex64)) for _ in range(count)]
    weight = _fading(gap)[:, None].astype(dtype)
    # the mirrored first rows are kept, until the last rows are made, in the memory of their transform
    kept = [half[ny:].view(dtype)[:, :nx] if 2 * columns >= nx else np.empty((gap, nx), dtype) for half in halves]
    each = max(1, TOGETHER // total_x)
    padded = np.empty((each, total_x), dtype)

    def put(half: ComplexArray, rows: FloatArray, first: int) -> None:
        for start in range(0, len(rows), each):
            own = rows[start : start + each]
            some = padded[: len(own)]
            some[:, :nx] = own
            some[:, nx:] = _gap(own, total_x, 1)
            half[first + start : first + start + len(own)] = scipy.fft.rfft(some, workers=1)[:, :columns]

    step = max(1, STRIP * each // count)
    for first in range(0, ny, step):
        last = min(first + step, ny)
        rows = rows_of(slice(first, last))
        for half, own, start in zip(halves, rows, kept, strict=True):
            put(half, own, first)
            if first < gap:
                begun = own[: gap - first][::-1]
                start[gap - first - len(begun) : gap - first] = begun
            if last > ny - gap:
                ended = own[max(ny - gap - first, 0) :][::-1]
                between = slice(ny - last, ny - last + len(ended))
                put(half, (1 - weight[between]) * ended + weight[between] * start[between], ny + between.start)
    for number, half in enumerate(halves):
        halves[number] = scipy.fft.fft(half, axis=0, overwrite_x=True, workers=1)
    return halves


def groups(shape: tuple[int, ...]) -> Iterator[slice]:
    """Yield slices of the first axis, each with at most ``TOGETHER`` samples or a single plane. Intermediate arrays
    then stay in the processor's cache, and no memory is fetched for them. Bits do not depend on the groups.
    """
    step = max(1, TOGETHER // math.prod(shape[1:]))
    yield from (slice(first, first + step) for first in range(0, shape[0], step))


def kept_terms(size: int, share: float) -> int:
    """Return the largest frequency index of a padded axis that lies within ``share`` of the Nyquist frequency."""
    return min(int(share * (padded_size(size) // 2)), padded_size(size) // 2)


def low_terms(half_transform: ComplexArray, shape: tuple[int, int]) -> ComplexArray:
    """Return the terms of a half transform from 0 to Ky and -Ky to -1 along y and from 0 to Kx along x,
    (..., 2 Ky + 1, Kx + 1); or the whole half transform.
    """
    rows, columns = shape
    if half_transform.shape[-2:] == shape:
        return half_transform
    low = half_transform[..., :columns]
    return np.concatenate([low[..., : rows // 2 + 1, :], low[..., low.shape[-2] - rows // 2 :, :]], axis=-2)


def frequencies(size: int, step: float, half: bool, share: float = 1.0) -> FloatArray:
    """Return the spatial frequencies of a padded axis, cycles/um: all of them, or the half kept by a real transform; or
    the frequencies of ``low_terms`` within a share of the Nyquist frequency.
    """
    total = padded_size(size)
    if share < 1:
        terms = np.arange(kept_terms(size, share) + 1)
        return (terms if half else np.concatenate([terms, -terms[:0:-1]])) / (total * step)
    return scipy.fft.rfftfreq(total, step) if half else scipy.fft.fftfreq(total, step)


def planes_of(half_transform: ComplexArray, ny: int, nx: int, *, own: bool = False) -> FloatArray:
    """Return the frame [0:ny, 0:nx] of the planes with this half transform. ``own``: the caller does not need the
    transform any more."""
    return _picked(half_transform, ny, nx, slice(ny), slice(nx), own)


def _picked(half: ComplexArray, ny: int, nx: int, rows: slice, columns: slice, own: bool) -> FloatArray:
    """Return some rows and columns of the frame of planes."""
    size = padded_size(ny), padded_size(nx)
    rows, columns = (slice(*one.indices(n)) for one, n in ((rows, ny), (columns, nx)))
    if half.ndim == 2:
        return inverse(half, size, rows, columns, own=own)
    found = np.empty((*half.shape[:-2], len(range(ny)[rows]), len(range(nx)[columns])), dtype=half.real.dtype)
    for some in groups(half.shape):
        found[some] = scipy.fft.irfft2(half[some], s=size, workers=1)[..., rows, columns]
    return found


def inverse(half: ComplexArray, size: tuple[int, int], rows: slice, columns: slice, *, own: bool = False) -> FloatArray:
    """Return some rows and columns of the plane of a half transform, with the same bits as ``irfft2``; a large plane is
    computed in strips. ``own``: the caller does not need the transform any more, so it may be overwritten.
    """
    if size[0] * size[1] <= LARGE:
        return np.ascontiguousarray(scipy.fft.irfft2(half, s=size, workers=1)[rows, columns])
    half = scipy.fft.ifft(half, axis=0, norm="forward", overwrite_x=own, workers=1)[rows]
    plane = np.empty((len(half), len(range(size[1])[columns])), dtype=half.real.dtype)
    each = max(1, TOGETHER // size[1])
    for start in range(0, len(half), each):
        some = scipy.fft.irfft(half[start : start + each], size[1], norm="forward", workers=1)[:, columns]
        np.multiply(some, plane.dtype.type(1 / (size[0] * size[1])), out=plane[start : start + each])
    return plane


def whole_steps(
    in_start: float, in_step: float, out_start: float, out_step: float, out_size: int, in_size: int
) -> slice | None:
    """Return the slice of input samples at the output positions; None if one lies between samples or outside."""
    ratio, offset = out_step / in_step, (out_start - in_start) / in_step
    step, first = round(ratio), round(offset)
    last = first + step * (out_size - 1)
    if step < 1 or abs(ratio - step) * out_size > 1e-6 or abs(offset - first) > 1e-6 or first < 0 or last >= in_size:
        return None
    return slice(first, last + 1, step)


def _waves(positions: FloatArray, total: int, half: bool, terms: int) -> ComplexArray:
    """Return exp(2 pi i k u / N) as a (position u, frequency index k) array; the Nyquist term is a cosine (real
    interpolation).

    ``terms``: number of terms of the transform along this axis; if it is not the full number, they are those of
    ``low_terms``.
    """
    if terms < (total // 2 + 1 if half else total):
        k = np.arange(terms) if half else np.concatenate([np.arange(terms // 2 + 1), -np.arange(terms // 2, 0, -1)])
        waves = np.exp(2j * np.pi * ((positions[:, None] * k[None, :]) / total))
        return waves * np.where(k == 0, 1.0, 2.0) if half else waves
    k = np.arange(total // 2 + 1) if half else np.rint(scipy.fft.fftfreq(total) * total)
    phase = 2 * np.pi * ((positions[:, None] * k[None, :]) / total)
    waves = np.exp(1j * phase)
    if total % 2 == 0:
        nyquist = total // 2
        waves[:, nyquist] = np.cos(np.pi * positions)
    if half:
        weights = np.full(k.size, 2.0)
        weights[0] = 1.0
        if total % 2 == 0:
            weights[-1] = 1.0
        waves *= weights
    return waves


def _waves_at(
    start: float, step: float, size: int, total: int, half: bool, terms: int, kind: np.dtype[np.complexfloating]
) -> ComplexArray:
    found = _waves(start + step * np.arange(size), total, half, terms).astype(kind)
    found.flags.writeable = False
    return found


_kept_waves = lru_cache(32)(_waves_at)  # in a sweep, many planes are read at the same places


def evaluate(
    half_transform: ComplexArray, ny: int, nx: int, y: tuple[float, float, int], x: tuple[float, float, int]
) -> FloatArray:
    """Evaluate planes at positions between samples, exactly for the band-limited plane.

    Parameters
    ----------
    half_transform : (..., Ny, Nx//2 + 1) complex array
        Half transform of planes whose frame has ``ny`` x ``nx`` samples; or its ``low_terms``.
    y, x : (start, step, size)
        Output positions in samples of the input grid (0 is its first sample).

    Returns
    -------
    (..., size_y, size_x) array

    Notes
    -----
    Two matrix products per plane (a matrix Fourier transform). Frequencies beyond the output's Nyquist frequency fold
    back, as in any sampling. Error against direct summation: below 2e-14 of the largest value in double, 2e-6 in single
    precision.
    """
    total_y, total_x = padded_size(ny), padded_size(nx)
    kind = half_transform.dtype
    rows, columns = (
        (_kept_waves if place[2] * terms * kind.itemsize <= KEPT_WAVES else _waves_at)(*place, total, half, terms, kind)
        for place, total, half, terms in (
            (y, total_y, False, half_transform.shape[-2]),
            (x, total_x, True, half_transform.shape[-1]),
        )
    )
    return np.ascontiguousarray(((rows @ half_transform) @ columns.T).real / (total_y * total_x)).astype(
        half_transform.real.dtype, copy=False
    )


def sample(
    half_transform: ComplexArray,
    ny: int,
    nx: int,
    y: tuple[float, float, int],
    x: tuple[float, float, int],
    *,
    own: bool = False,
) -> FloatArray:
    """Return the values of ``evaluate``. If all positions are samples, samples are picked, which is cheaper. ``own``:
    the caller does not need the transform any more, so it may be overwritten.
    """
    rows = whole_steps(0.0, 1.0, y[0], y[1], y[2], ny)
    columns = whole_steps(0.0, 1.0, x[0], x[1], x[2], nx)
    if rows is None or columns is None:
        return evaluate(half_transform, ny, nx, y, x)
    if half_transform.shape[-1] <= padded_size(nx) // 2:
        if y[2] * x[2] < FEW * padded_size(ny):
            return evaluate(half_transform, ny, nx, y, x)
        half_transform = _whole(half_transform, padded_size(ny), padded_size(nx))
    return _picked(half_transform, ny, nx, rows, columns, own)


def _whole(low: ComplexArray, total_y: int, total_x: int) -> ComplexArray:
    """Return a full half transform from its low terms, with zeros elsewhere."""
    found = np.zeros((*low.shape[:-2], total_y, total_x // 2 + 1), dtype=low.dtype)
    middle, columns = low.shape[-2] // 2, low.shape[-1]
    found[..., : middle + 1, :columns] = low[..., : middle + 1, :]
    found[..., total_y - middle :, :columns] = low[..., middle + 1 :, :]
    return found


def sum_over_bands(weights: FloatArray, half_transform: ComplexArray) -> ComplexArray:
    """Return weighted sums of band transforms: (channel, band) x (band, Ny, Nh) -> (channel, Ny, Nh)."""
    bands, ny, nh = half_transform.shape
    flat = half_transform.reshape(bands, ny * nh)
    return (
        (weights.astype(half_transform.real.dtype) @ flat.view(half_transform.real.dtype))
        .view(half_transform.dtype)
        .reshape(-1, ny, nh)
    )


def on_unique_rows(evaluate_rows, fy: FloatArray) -> FloatArray:  # type: ignore[no-untyped-def]
    """Evaluate a function that is even in fy once per |fy|, and copy the result to both signs.

    ``evaluate_rows(rows)`` takes (n, 1) frequencies and returns (..., n, nx).
    """
    rows, where = np.unique(np.abs(fy[:, 0]), return_inverse=True)
    if rows.size == fy.shape[0]:
        return evaluate_rows(fy)
    return np.take(evaluate_rows(rows[:, None]), where, axis=-2)
