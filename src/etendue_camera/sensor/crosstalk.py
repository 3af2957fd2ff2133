"""Charge diffusion below the colour filters, from the pixel whose filter generated the charge into its neighbours.

In:  the photodiode (absorption, depths, diffusion length), the light-sensitive window and the pitch (um).
Out: pixel kernels: the fraction of a pixel's charge that each neighbour collects; mosaics after diffusion.
Sources: the diffusion equation behind `photodiode.collection`, solved in time instead of frequency. First-passage
densities of a half-space and of a slab: Carslaw and Jaeger, Conduction of Heat in Solids, sections 2.4 and 3.4.

An electron generated at depth z diffuses for a time tau before it reaches the depletion layer; during this time it
moves sideways with a Gaussian distribution of variance 2 D_n tau per axis. With t = D_n tau the collected charge is a
mixture of Gaussians,

    D(f)/D(0) = kept + sum over t of share(t) exp(-(2 pi f)^2 t),

where kept is the charge of the depletion layer. Each Gaussian is separable and its integrals over square pixels are
error functions, so that kernels are non-negative, symmetric, and sum to 1.
"""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue_camera.arrays import FloatArray
from etendue_camera.sensor import photodiode
from etendue_camera.sensor.cfa import Mask, channel_index, continued

STEP = 0.3  # of ln t; the error of the trapezoidal rule is then exp(-2 pi (pi/2) / 0.3) = 5e-15
SHORTEST = 1e-16  # um2; charge that moves less than 1.4e-8 um stays in place
LONGEST = 1e12  # um2, for diffusion limited by neither depth nor recombination
MODES = 32  # of a slab; the remainder is exp(-41) from t = 0.006 L^2 on


def times(depth: float, length: float) -> FloatArray:
    """Return nodes t, um2, evenly spaced in ln t, up to where recombination and the back have ended all diffusion."""
    decay = 1.0 / length**2 + (0.5 * math.pi / depth) ** 2 if depth > 0 else math.inf
    last = min(45.0 / decay, LONGEST) if decay > 0 else LONGEST
    count = math.ceil(math.log(max(last, 1e-8) / SHORTEST) / STEP)
    return SHORTEST * np.exp(STEP * np.arange(count + 1))


def shares(
    t: FloatArray, absorption: float, depletion: float, depth: float, length: float, back: photodiode.Back = "absorbing"
) -> tuple[float, FloatArray]:
    """Split the collected charge into the part collected at once and parts by diffusion time.

    Parameters
    ----------
    t : (n,) array, um2
        From `times`.
    absorption, depletion, depth, length, back
        As for `photodiode.collection`.

    Returns
    -------
    kept : float
        Charge from the depletion layer, as a fraction of all collected charge.
    moved : (n,) array
        Charge that arrives after each t, as a fraction of all collected charge. ``kept`` and ``moved`` sum to 1.

    Raises
    ------
    ValueError
        As for `photodiode.collection`; also if all charge would come from infinite depth.

    Notes
    -----
    Error: below 4e-14 of `photodiode.collection_mtf` at every frequency (3000 random points of its box).
    """
    whole = photodiode.collection_per_absorption(0.0, absorption, depletion, depth, length, back)
    if whole == math.inf:
        raise ValueError(
            "all charge is generated infinitely deep: make absorption positive, or diffusion_depth or "
            "diffusion_length finite"
        )
    depleted = photodiode.collection_per_absorption(math.inf, absorption, depletion, depth, length, back)
    if depth == 0.0 or depletion == math.inf:
        return 1.0, np.zeros_like(t)
    density = _half_space(t, absorption)
    if depth < math.inf:
        late = t > 6e-3 * depth**2
        density[late] = _slab(t[late], absorption, depth, back)
    moved = np.exp(-absorption * depletion) * density * np.exp(-t / length**2) * t * STEP
    moved[0] = 0.0
    kept = min(depleted / whole, 1.0)
    # up to the first node, all moving charge stays: the sum of sqrt(t/pi) over the nodes that would lie below it;
    # charge beyond the far end belongs to the last node
    early = math.sqrt(t[0] / math.pi) * STEP / -math.expm1(-0.5 * STEP) * math.exp(-absorption * depletion) / whole
    kept = min(kept + early, 1.0)
    moved /= whole
    moved[-1] += max(1.0 - kept - float(moved.sum()), 0.0)
    total = kept + float(moved.sum())
    return kept / total, moved / total


def _half_space(t: FloatArray, absorption: float) -> FloatArray:
    """Return arrivals per t and per absorption a at the top of a half-space: 1/sqrt(pi t) - a erfcx(a sqrt(t))."""
    x = absorption * np.sqrt(t)
    far = 1.0 / np.maximum(2.0 * x * x, 1.0)
    series = far * (1.0 - 3.0 * far * (1.0 - 5.0 * far * (1.0 - 7.0 * far)))
    near = 1.0 - math.sqrt(math.pi) * x * scipy.special.erfcx(x)
    return np.where(x > 50.0, series, near) / np.sqrt(math.pi * t)


def _slab(t: FloatArray, absorption: float, depth: float, back: str) -> FloatArray:
    """Return arrivals per t and per absorption at the top of a slab, a sum over its modes; all terms are positive."""
    n = np.arange(1, MODES + 1)
    if back == "absorbing":
        k = n * math.pi / depth
        made = k * np.where(n % 2 == 1, 1.0 + math.exp(-absorption * depth), -math.expm1(-absorption * depth))
    else:
        k = (n - 0.5) * math.pi / depth
        made = k + np.where(n % 2 == 1, -1.0, 1.0) * absorption * math.exp(-absorption * depth)
    weight = (2.0 / depth) * k * made / (absorption**2 + k**2)
    return np.exp(-np.outer(t, k**2)) @ weight


def pixel_shares(t: FloatArray, light: float, pitch: float, reach: int, offset: float = 0.0) -> FloatArray:
    """Return the fraction of the charge collected by each pixel along one axis.

    Parameters
    ----------
    t : (n,) array, um2
        Half the variance of the lateral movement.
    light : float, um
        Width of the window under which charge is generated uniformly; above 0.
    pitch : float, um
        Width of the collecting pixels.
    reach : int
        Number of neighbours on each side.
    offset : float, um
        Offset of the window from the centre of its pixel.

    Returns
    -------
    (n, 2 reach + 1) array
        Non-negative; rows sum to 1 except for the charge that goes farther.

    Notes
    -----
    The fraction is the probability to end in a pixel, averaged over the window: second differences of an integral of
    the normal distribution, whose linear part is the overlap of window and pixel. Error: below 1e-13.
    """
    sigma = np.sqrt(2.0 * t)[:, None]
    edges = (np.arange(2 * reach + 2) - reach - 0.5) * pitch
    low, high = edges - (offset + 0.5 * light), edges - (offset - 0.5 * light)

    def rest(u: FloatArray) -> FloatArray:  # integral of the tail beyond |u|
        s = np.abs(u) / sigma
        return sigma * (np.exp(-0.5 * s * s) / math.sqrt(2.0 * math.pi) - s * scipy.special.ndtr(-s))

    # value at each pixel edge: integral over the window of the probability to lie below it
    below = (np.maximum(high, 0.0) - np.maximum(low, 0.0)) / light + (rest(high) - rest(low)) / light
    return np.maximum(np.diff(below, axis=1), 0.0)


def kernels(
    kept: FloatArray, moved: FloatArray, along_y: FloatArray, along_x: FloatArray, beyond: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the pixel kernels of the channels, and the charge beyond them.

    Parameters
    ----------
    kept : (channel,) array
    moved : (channel, n) array
        From `shares`, averaged over wavelength with the photons of each channel.
    along_y, along_x : (n, 2 reach + 1) array
        From `pixel_shares`.
    beyond : float
        Fraction of the charge allowed beyond the kernels, which are made as small as that permits.

    Returns
    -------
    kernels : (channel, 2 r + 1, 2 r + 1) array
        Entry (r + i, r + j): fraction of a pixel's charge that arrives i rows below and j columns to the right.
    lost : (channel,) array
        Charge beyond the kernel, redistributed in proportion so that the kernel sums to 1.
    """
    largest = (along_y.shape[1] - 1) // 2
    reach = np.arange(largest + 1)

    def within(along: FloatArray) -> FloatArray:
        total = np.cumsum(np.pad(along, ((0, 0), (1, 0))), axis=1)
        return total[:, largest + 1 + reach] - total[:, largest - reach]

    far = 1.0 - kept[:, None] - moved @ (within(along_y) * within(along_x))  # (channel, reach)
    enough = np.flatnonzero((far <= beyond).all(axis=0))
    r = int(enough[0]) if enough.size else largest
    cut = slice(largest - r, largest + r + 1)
    found = np.einsum("cn,ny,nx->cyx", moved, along_y[:, cut], along_x[:, cut], optimize=True)
    found[:, r, r] += kept
    total = found.sum(axis=(1, 2), keepdims=True)
    return found / total, np.maximum(1.0 - total[:, 0, 0], 0.0)


def mixing(kernel: FloatArray, mask: Mask) -> FloatArray:
    """Return the mixing matrix for uniform light: (channel that collects, channel under whose filter charge was
    generated).

    Entries are means over the pixels of a channel. If they are weighted by the number of pixels of each channel,
    columns sum to 1.
    """
    r = (kernel.shape[1] - 1) // 2
    height, width = mask.period
    index = channel_index(mask, height, width)
    folded = np.zeros((len(kernel), height, width))  # kernels by the position in the period where their charge arrives
    y, x = np.arange(-r, r + 1)[:, None] % height, np.arange(-r, r + 1)[None, :] % width
    for plane, one in zip(folded, kernel, strict=True):
        np.add.at(plane, (y, x), one)
    mixed = np.zeros((len(kernel), len(kernel)))
    for (row, column), source in np.ndenumerate(index):
        landed = np.roll(folded[source], (row, column), axis=(0, 1))
        mixed[:, source] += np.bincount(index.ravel(), landed.ravel(), len(kernel))
    return mixed / np.bincount(index.ravel(), minlength=len(kernel))[:, None]


def diffuse(
    mosaic: FloatArray, kernel: FloatArray, mask: Mask, first_row: int = 0, first_column: int = 0
) -> FloatArray:
    """Apply charge diffusion to a mosaic.

    Parameters
    ----------
    mosaic : (y, x) array, any unit
    kernel : (channel, 2 r + 1, 2 r + 1) array
        From `kernels`, in the order of ``mask.channels``.
    mask : Mask
    first_row, first_column : int
        First pixel of the mosaic on the sensor.

    Returns
    -------
    (y, x) array, unit and dtype of mosaic

    Notes
    -----
    Beyond the border the mosaic is continued by whole periods of the mask (`cfa.continued`): uniform light is unchanged
    up to the border. Farther inside than the kernel reaches, charge is conserved to rounding: 1e-15 of the total in
    double precision. Convolution by Fourier transform: error 3e-16 (6e-7 in single precision) of the largest value.
    """
    rows, columns = mosaic.shape
    r = (kernel.shape[1] - 1) // 2
    if r == 0 and (kernel == 1).all():  # all charge stays in place
        return np.array(mosaic)
    height, width = mask.period
    extended = mosaic[np.ix_(continued(rows, height, r), continued(columns, width, r))]
    index = channel_index(mask, extended.shape[0], extended.shape[1], first_row - r, first_column - r)
    shape = tuple(scipy.fft.next_fast_len(n, real=True) for n in extended.shape)  # wrap-around stays in the margin
    total: NDArray = np.zeros((1, 1), np.complex64)
    for channel, one in enumerate(kernel):
        source = np.where(index == channel, extended, mosaic.dtype.type(0))
        response = scipy.fft.rfft2(one, shape, workers=1).astype(np.result_type(mosaic.dtype, np.complex64))
        total = total + scipy.fft.rfft2(source, shape, workers=1) * response
    spread = scipy.fft.irfft2(total, shape, workers=1)
    return np.ascontiguousarray(spread[2 * r : 2 * r + rows, 2 * r : 2 * r + columns])
