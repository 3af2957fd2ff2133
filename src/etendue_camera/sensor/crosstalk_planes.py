"""Crosstalk of full planes: the charge that a pixel of each channel would collect at every position, with the
neighbours that it has in the mask.

In:  planes (channel, y, x) of photocurrent; the pixel kernels of the channels (`crosstalk.kernels`); the mask.
Out: planes (channel, y, x), blurred and mixed as a mosaic would be; the transfer functions between channels.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue_camera.arrays import FloatArray
from etendue_camera.sensor.cfa import Mask, channel_index, continued


def neighbours(mask: Mask, count: int) -> FloatArray:
    """Return the number of neighbours, (collecting channel, filter channel, rows, columns of the cell).

    Each entry is the number of pixels of the first channel that receive charge from the second at this displacement
    down and right, modulo the cell.
    """
    height, width = mask.period
    index = channel_index(mask, height, width)
    found = np.zeros((count, count, height, width))
    for (row, column), collects in np.ndenumerate(index):
        whence = index[np.ix_((row - np.arange(height)) % height, (column - np.arange(width)) % width)]
        found[collects] += whence == np.arange(count)[:, None, None]
    return found


def channel_transfer(
    kept: FloatArray,
    moved: FloatArray,
    along_y: FloatArray,
    along_x: FloatArray,
    mask: Mask,
    fy: FloatArray,
    fx: FloatArray,
) -> NDArray:
    """Return transfer functions between channels: the response of one channel's pixels to detail behind the filters of
    another.

    Parameters
    ----------
    kept, moved, along_y, along_x
        As in `crosstalk.kernels`: (channel,), (channel, n), (n, 2 reach + 1).
    mask : Mask
    fy, fx : (m,), (n,) arrays, cycles/pixel
        Frequencies of the light on the photodiodes; the result is periodic with 1 cycle/pixel.

    Returns
    -------
    (channel that collects, channel of the filter, m, n) array
        The Fourier transform of `plane_kernels` as wide as the tables: `crosstalk.mixing` at 0, complex where the
        kernels are not even.

    Notes
    -----
    The origin of charge repeats with the cell of the mask, so that the fraction of a channel is a sum of waves with
    this period. Each wave shifts the spectrum of the kernel, which is a sum of products along y and x. Error: 1e-13
    against the transform of `plane_kernels`.
    """
    height, width = mask.period
    count = len(kept)
    share = neighbours(mask, count)
    waves: NDArray = np.fft.fft2(share / share.sum(axis=1, keepdims=True)) / (height * width)
    if np.abs(waves.imag).max() < 1e-15:  # the mask is even
        waves = waves.real
    in_y = [_spectra(along_y, fy - p / height) for p in range(height)]
    in_x = [_spectra(along_x, fx - q / width) for q in range(width)]
    total: NDArray = np.zeros((1, 1))
    for p, q in np.ndindex(height, width):
        if np.abs(waves[..., p, q]).max() > 1e-15:
            own = kept[:, None, None] + np.swapaxes(moved[:, :, None] * in_y[p], 1, 2) @ in_x[q]
            total = total + waves[..., p, q, None, None] * own
    # charge beyond the tables is spread over the kernel
    whole = kept + moved @ (along_y.sum(axis=1) * along_x.sum(axis=1))
    return total / whole[:, None, None]


def _spectra(along: FloatArray, frequency: FloatArray) -> NDArray:
    """Return Fourier transforms (n, m) of rows (n, 2 r + 1) about their centres; real if the rows are even."""
    r = (along.shape[1] - 1) // 2
    right, left = along[:, r + 1 :], along[:, :r][:, ::-1]
    phase = 2 * np.pi * np.arange(1, r + 1)[:, None] * frequency
    even = along[:, r, None] + (right + left) @ np.cos(phase)
    return even if (right == left).all() else even - 1j * ((right - left) @ np.sin(phase))


def plane_kernels(kernel: FloatArray, mask: Mask) -> FloatArray:
    """Return kernels between channels: the charge that a pixel of one channel receives from pixels of another.

    Parameters
    ----------
    kernel : (channel, 2 r + 1, 2 r + 1) array
        From `crosstalk.kernels`: where charge generated under a filter arrives.
    mask : Mask

    Returns
    -------
    (channel that collects, channel of the filter, 2 r + 1, 2 r + 1) array
        ``kernel`` times the fraction of the collecting channel's pixels with such a neighbour at that distance.

    Notes
    -----
    Sums over the last two dims are `crosstalk.mixing`.
    """
    count, size, _ = kernel.shape
    away = np.arange(size) - (size - 1) // 2
    height, width = mask.period
    share = neighbours(mask, count)
    pixels = share[:, :, :1, :1].sum(axis=1, keepdims=True)  # of each channel in the cell
    return share[:, :, (away % height)[:, None], away % width] * kernel / pixels


def diffuse_planes(planes: NDArray, kernel: FloatArray, mask: Mask) -> NDArray:
    """Apply charge diffusion below the filters of a mosaic to full planes.

    Parameters
    ----------
    planes : (channel, y, x) array, any unit
        In the order of ``mask.channels``.
    kernel : (channel, 2 r + 1, 2 r + 1) array
        From `crosstalk.kernels`.
    mask : Mask

    Returns
    -------
    (channel, y, x) array, unit and dtype of planes

    Notes
    -----
    For light that is uniform around a pixel, and wherever all pixels of its channel have the same neighbours, this
    equals `crosstalk.diffuse` on the mosaic. Beyond the border planes are continued as the mosaic is.
    Convolution by Fourier transform: error 3e-16 (6e-7 in single precision) of the largest value.
    """
    count, rows, columns = planes.shape
    between = plane_kernels(kernel, mask)
    r = (kernel.shape[1] - 1) // 2
    height, width = mask.period
    around = planes[:, continued(rows, height, r)][:, :, continued(columns, width, r)]
    shape = tuple(scipy.fft.next_fast_len(n, real=True) for n in around.shape[1:])  # wrap-around stays in the margin
    spectra = [scipy.fft.rfft2(plane, shape, workers=1) for plane in around]
    found = np.empty_like(planes)
    for collects in range(count):
        total: NDArray = np.zeros((1, 1), np.complex64)
        for source, spectrum in enumerate(spectra):
            total = total + spectrum * scipy.fft.rfft2(between[collects, source], shape, workers=1).astype(
                spectrum.dtype
            )
        found[collects] = scipy.fft.irfft2(total, shape, workers=1)[2 * r : 2 * r + rows, 2 * r : 2 * r + columns]
    return found
