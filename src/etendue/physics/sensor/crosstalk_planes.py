"""Crosstalk of full planes: what a pixel of each channel would collect at every place, its neighbours being those of the mask.

In:  planes (channel, y, x) of photocurrent; the pixel kernels of the channels (`crosstalk.kernels`); the mask.
Out: planes (channel, y, x): blurred and mixed as the mosaic is, without being a mosaic.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue.physics.sensor.cfa import Mask, channel_index, continued

FloatArray = NDArray[np.float64]


def plane_kernels(kernel: FloatArray, mask: Mask) -> FloatArray:
    """Kernels between channels: what arrives in a pixel of one of them from the pixels of another.

    Parameters
    ----------
    kernel : (channel, 2 r + 1, 2 r + 1) array
        Of `crosstalk.kernels`: where the charge made under a filter arrives.
    mask : Mask

    Returns
    -------
    (channel that collects, channel of the filter, 2 r + 1, 2 r + 1) array
        ``kernel`` times the share of the collecting channel's pixels that have such a neighbour at that distance.

    Notes
    -----
    Sums over the last two dims are `crosstalk.mixing`.
    """
    count, size, _ = kernel.shape
    r = (size - 1) // 2
    height, width = mask.period
    index = channel_index(mask, height, width)
    share = np.zeros((count, count, size, size))
    for (row, column), collects in np.ndenumerate(index):
        y, x = (row - np.arange(-r, r + 1)) % height, (column - np.arange(-r, r + 1)) % width  # whence charge moves by (i, j)
        share[collects] += index[np.ix_(y, x)] == np.arange(count)[:, None, None]
    return share * kernel / np.bincount(index.ravel(), minlength=count)[:, None, None, None]


def diffuse_planes(planes: NDArray, kernel: FloatArray, mask: Mask) -> NDArray:
    """Full planes after charge has wandered behind the filters of a mosaic.

    Parameters
    ----------
    planes : (channel, y, x) array, any unit
        In the order of ``mask.channels``.
    kernel : (channel, 2 r + 1, 2 r + 1) array
        Of `crosstalk.kernels`.
    mask : Mask

    Returns
    -------
    (channel, y, x) array, unit and dtype of planes

    Notes
    -----
    For light that is uniform around a pixel, and wherever all pixels of its channel have the same neighbours, this is
    what `crosstalk.diffuse` makes of the mosaic there. Beyond the border planes are continued as the mosaic is.
    Convolution by Fourier transform: error 3e-16 (6e-7 in single precision) of the largest value.
    """
    count, rows, columns = planes.shape
    between = plane_kernels(kernel, mask)
    r = (kernel.shape[1] - 1) // 2
    height, width = mask.period
    around = planes[:, continued(rows, height, r)][:, :, continued(columns, width, r)]
    shape = tuple(scipy.fft.next_fast_len(n, real=True) for n in around.shape[1:])  # what wraps round stays in the margin
    spectra = [scipy.fft.rfft2(plane, shape, workers=1) for plane in around]
    found = np.empty_like(planes)
    for collects in range(count):
        total: NDArray = np.zeros((1, 1), np.complex64)
        for source, spectrum in enumerate(spectra):
            total = total + spectrum * scipy.fft.rfft2(between[collects, source], shape, workers=1).astype(spectrum.dtype)
        found[collects] = scipy.fft.irfft2(total, shape, workers=1)[2 * r : 2 * r + rows, 2 * r : 2 * r + columns]
    return found
