"""Pixels anywhere on blurred cells: an extended matrix Fourier transform; recognise the window of a pixel.

In:  half transforms of cell means, transfer functions at any frequency (cycles/um), positions and widths of windows.
Out: (channel, y, x) values of the windows, summed over bands.
Sources: as ``cells``. The light is adjacent boxes: its transform is the transform of its means, repeated without end,
times sinc.
"""

from __future__ import annotations

import numpy as np
import scipy

from etendue.transfer.cells import (
    BLOCK,
    PeriodicAxis,
    Reach,
    Transfer,
    factors_of,
    far_line,
    overlaps,
    planes_of,
)
from etendue.types.arrays import Array, FloatArray


def evaluated(
    otfs: list[Transfer],
    reaches: list[Reach],
    weights: FloatArray,
    transforms: Array,
    y: PeriodicAxis,
    x: PeriodicAxis,
    centres: tuple[FloatArray, FloatArray],
    widths: tuple[float, float],
) -> FloatArray:
    """Return the means of blurred light over windows at any positions, summed over bands. The light is given by cells;
    the method is an extended matrix Fourier transform.

    Parameters
    ----------
    otfs, reaches : transfer function and reach of every band
    weights : (channel, band) array
    transforms : (band, y.size, x.size // 2 + 1) complex array
        Half transforms of cell means.
    y, x : PeriodicAxis
    centres : (n,), (m,) arrays, cells
        Centres of the windows along y and x; 0 is the centre of cell 0.
    widths : two floats, um

    Returns
    -------
    (channel, n, m) array

    Notes
    -----
    Every frequency up to the end of a band's transfer function is evaluated, for any cell size; the contribution of
    light that is not blurred at all (``rest``) is computed from exact areas. Error: as for ``folded``.
    """
    kind = transforms.real.dtype
    channels = len(weights)
    total = np.zeros((channels, centres[0].size, centres[1].size), dtype=kind)
    rests = weights * np.array([0.0 if reach.by_axis else reach.rest for reach in reaches])
    for band, (otf, reach) in enumerate(zip(otfs, reaches, strict=True)):
        if reach.by_axis:
            plane = planes_of(transforms[band], y, x)
            down, across = _factors(otf, y, x, centres, widths)
            total += weights[:, band, None, None].astype(kind) * (down.astype(kind) @ plane @ across.T.astype(kind))
    if rests.any():
        summed = np.tensordot(rests.astype(kind), transforms, axes=1)
        planes = planes_of(summed, y, x)
        shares = [overlaps(c, w / a.step, a.size).astype(kind) for c, w, a in zip(centres, widths, (y, x), strict=True)]
        total += shares[0] @ planes @ shares[1].T
    widest = max(0.0 if reach.by_axis else reach.radius for reach in reaches)
    if not widest:
        return total
    waves_x = _waves(np.arange(int(np.ceil(widest * x.size * x.step)) + 1), x, centres[1], widths[1])
    waves_x[1:] *= 2.0  # negative frequencies are the conjugates
    waves_x = waves_x.astype(transforms.dtype)
    last = int(np.ceil(widest * y.size * y.step))
    start = 0
    while start <= last:
        rows = max(1, BLOCK // (2 * channels * len(waves_x)))
        k = np.arange(start, min(start + rows, last + 1))
        sums = np.zeros((2, channels, k.size, len(waves_x)), dtype=transforms.dtype)
        for band, (otf, reach) in enumerate(zip(otfs, reaches, strict=True)):
            _add_band(sums, otf, reach, weights[:, band], transforms[band], (y, x), k)
        waves_y = _waves(k, y, centres[0], widths[0]).astype(transforms.dtype)
        ahead, behind = sums @ waves_x
        behind[:, k == 0] = 0
        total += (waves_y.T @ ahead + np.conj(waves_y).T @ behind).real
        start += rows
    return total


def _add_band(
    sums: Array,
    otf: Transfer,
    reach: Reach,
    weights: FloatArray,
    transform: Array,
    axes: tuple[PeriodicAxis, PeriodicAxis],
    k: Array,
) -> None:
    """Add the blurred transform of one band, at rows k and -k of the extended lattice, to the sums of all channels."""
    y, x = axes
    length = y.size * y.step
    inside = k[k <= np.ceil(reach.radius * length)]
    if not reach.radius or not inside.size or reach.by_axis:
        return
    left = reach.radius**2 - (inside[0] / length) ** 2
    high = np.sqrt(max(left, 0.0)) if reach.rest == 0 else reach.radius
    columns = np.arange(min(int(np.ceil(high * x.size * x.step)) + 1, sums.shape[-1]))
    fy, fx = (inside / length)[:, None], (columns / (x.size * x.step))[None, :]
    shape = (inside.size, columns.size)
    for sign, target in ((1, sums[0]), (-1, sums[1])):
        if sign == 1 or not reach.even:
            value = np.broadcast_to(otf(sign * fy, fx), shape) - reach.rest
            value = np.real(value) if reach.even else value
        extended = value * _periodic(transform, sign * inside, columns, y.size, x.size)
        for channel, weight in enumerate(weights):
            if weight:
                target[channel, : inside.size, : columns.size] += weight * extended


def _factors(
    otf: Transfer, y: PeriodicAxis, x: PeriodicAxis, centres: tuple[FloatArray, FloatArray], widths: tuple[float, float]
) -> tuple[Array, Array]:
    """Return the matrices that map cells to windows along y and x, for a separable transfer function."""
    found = []
    for factor, axis, at, width in zip(factors_of(otf), (y, x), centres, widths, strict=True):
        values, rest = far_line(factor, axis)
        waves = (values - rest)[:, None] * _waves(np.arange(values.size), axis, at, width)
        waves[1:] *= 2.0
        summed = waves.reshape(-1, axis.size, at.size).sum(axis=0)  # folded onto the frequencies of the axis
        found.append(scipy.fft.fft(summed, axis=0).real.T + rest * overlaps(at, width / axis.step, axis.size))
    return found[0], found[1]


def _periodic(transform: Array, rows: Array, columns: Array, ny: int, nx: int) -> Array:
    """Return the transform of cells at any frequency index: the half transform is continued periodically, and its
    missing half is the conjugate.
    """
    k = columns % nx
    mirrored = k > nx // 2
    found = transform[np.ix_(rows % ny, np.where(mirrored, nx - k, k))]
    if mirrored.any():
        other = transform[np.ix_(-rows % ny, (nx - k)[mirrored])]
        found[:, mirrored] = np.conj(other)
    return found


def _waves(k: Array, axis: PeriodicAxis, centres: FloatArray, width: float) -> Array:
    """Return the (frequency, position) matrix of waves at the positions, times the sincs of cell and window, divided by
    the axis size.
    """
    factors = np.sinc(k / axis.size) * np.sinc(k * (width / (axis.size * axis.step))) / axis.size
    turns = (k[:, None] * centres[None, :]) / axis.size
    return factors[:, None] * np.exp(2j * np.pi * (turns - np.rint(turns)))


# -- recognising a window --------------------------------------------------------------------------------


def box_of(otf: Transfer, pitch: float) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return width and position (um) along y and x of the window with the transfer function ``otf``; None if ``otf`` is
    not the transfer function of a window.

    Parameters
    ----------
    otf : transfer function of the window
    pitch : float, um
        At least the width of the window.

    Returns
    -------
    ((width, place), (width, place)) along y and x
        ``place`` is the position of the window's centre: the value at x is the light averaged about x + place.

    Notes
    -----
    The width is solved at one low frequency, where sin(t)/t has one solution, and checked at 49 other frequencies to
    1e-12.
    """
    f = 0.3 / (np.pi * pitch)
    zero = np.zeros((1, 1))
    found = []
    for value in (complex(np.ravel(otf(zero + f, zero))[0]), complex(np.ravel(otf(zero, zero + f))[0])):
        size, t = abs(value), np.sqrt(max(6.0 * (1.0 - abs(value)), 0.0))
        for _ in range(8):  # Newton on sin(t)/t, which is smooth here
            if t < 1e-8:
                break
            t -= (np.sin(t) / t - size) / ((t * np.cos(t) - np.sin(t)) / t**2)
        found.append((float(t / (np.pi * f)), float(np.angle(value) / (2 * np.pi * f))))
    trial = np.linspace(-2.9, 3.1, 7) / pitch
    (wy, sy), (wx, sx) = found
    row = np.sinc(trial * wy) * np.exp(2j * np.pi * trial * sy)
    column = np.sinc(trial * wx) * np.exp(2j * np.pi * trial * sx)
    wrong = np.abs(np.broadcast_to(otf(trial[:, None], trial[None, :]), (7, 7)) - row[:, None] * column).max()
    return None if wrong > 1e-12 else ((wy, sy), (wx, sx))
