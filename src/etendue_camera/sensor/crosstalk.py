"""Charge that diffuses behind the colour filters: from the pixel under whose filter it was made into its neighbours.

In:  the photodiode (absorption, depths, diffusion length), the light-sensitive window and the pitch (um).
Out: pixel kernels: the share of a pixel's charge that each neighbour collects; mosaics after that.
Sources: the diffusion equation behind `photodiode.collection`, solved in time instead of frequency. First-passage
densities of a half-space and of a slab: Carslaw and Jaeger, Conduction of Heat in Solids, sections 2.4 and 3.4.

An electron made at depth z wanders for a time tau before it reaches the depletion layer; meanwhile it moves sideways by
a Gaussian of variance 2 D_n tau in each direction. With t = D_n tau the collected charge is a mixture of Gaussians,

    D(f)/D(0) = kept + sum over t of share(t) exp(-(2 pi f)^2 t),

kept being the charge of the depletion layer. Each Gaussian is separable and its integrals over square pixels are error
functions, so that kernels are never negative, symmetric, and sum to 1.
"""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue_camera.arrays import FloatArray
from etendue_camera.sensor import photodiode
from etendue_camera.sensor.cfa import Mask, channel_index, continued

STEP = 0.3  # of ln t; the trapezoidal rule then errs by exp(-2 pi (pi/2) / 0.3) = 5e-15
SHORTEST = 1e-16  # um2; a charge that moves less than 1.4e-8 um stays where it is
LONGEST = 1e12  # um2, where neither depth nor recombination ends the wandering
MODES = 32  # of a slab; their rest is exp(-41) from t = 0.006 L^2 on


def times(depth: float, length: float) -> FloatArray:
    """Nodes t, um2, evenly spaced in ln t, up to where recombination and the back have ended all wandering."""
    decay = 1.0 / length**2 + (0.5 * math.pi / depth) ** 2 if depth > 0 else math.inf
    last = min(45.0 / decay, LONGEST) if decay > 0 else LONGEST
    count = math.ceil(math.log(max(last, 1e-8) / SHORTEST) / STEP)
    return SHORTEST * np.exp(STEP * np.arange(count + 1))


def shares(
    t: FloatArray, absorption: float, depletion: float, depth: float, length: float, back: photodiode.Back = "absorbing"
) -> tuple[float, FloatArray]:
    """How the collected charge divides: kept at once, and by wandering time.

    Parameters
    ----------
    t : (n,) array, um2
        Of `times`.
    absorption, depletion, depth, length, back
        As in `photodiode.collection`.

    Returns
    -------
    kept : float
        Charge from the depletion layer, of all that is collected.
    moved : (n,) array
        Charge that arrives after each t. Together they sum to 1.

    Raises
    ------
    ValueError
        As `photodiode.collection`; and where all charge would come from infinitely far.

    Notes
    -----
    Error: below 4e-14 of `photodiode.collection_mtf` at every frequency (3000 random points of its box).
    """
    whole = photodiode.collection_per_absorption(0.0, absorption, depletion, depth, length, back)
    if whole == math.inf:
        raise ValueError(
            "all charge comes from infinitely far: make absorption, diffusion_depth or diffusion_length finite"
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
    # up to the first node all that moves stays: the sum of sqrt(t/pi) over the nodes that would lie below it;
    # what the nodes miss at the far end belongs to the last
    early = math.sqrt(t[0] / math.pi) * STEP / -math.expm1(-0.5 * STEP) * math.exp(-absorption * depletion) / whole
    kept = min(kept + early, 1.0)
    moved /= whole
    moved[-1] += max(1.0 - kept - float(moved.sum()), 0.0)
    total = kept + float(moved.sum())
    return kept / total, moved / total


def _half_space(t: FloatArray, absorption: float) -> FloatArray:
    """Arrivals per t and per absorption at the top of endless silicon: 1/sqrt(pi t) - a erfcx(a sqrt t)."""
    x = absorption * np.sqrt(t)
    far = 1.0 / np.maximum(2.0 * x * x, 1.0)
    series = far * (1.0 - 3.0 * far * (1.0 - 5.0 * far * (1.0 - 7.0 * far)))
    near = 1.0 - math.sqrt(math.pi) * x * scipy.special.erfcx(x)
    return np.where(x > 50.0, series, near) / np.sqrt(math.pi * t)


def _slab(t: FloatArray, absorption: float, depth: float, back: str) -> FloatArray:
    """Arrivals at the top of a slab, by its modes; all terms are positive."""
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
    """Share of the charge that is found in each pixel along one axis.

    Parameters
    ----------
    t : (n,) array, um2
        Half the variance of the sideways movement.
    light : float, um
        Width of the window under which the charge is made, evenly; above 0.
    pitch : float, um
        Width of the pixels that collect.
    reach : int
        Neighbours on each side.
    offset : float, um
        Of the window from the centre of its pixel.

    Returns
    -------
    (n, 2 reach + 1) array
        Nowhere negative; rows sum to 1 but for the charge that goes farther.

    Notes
    -----
    Mean over the window of the chance to end in a pixel: second differences of the integral of the normal distribution,
    whose linear part is the plain overlap of window and pixel. Error: below 1e-13.
    """
    sigma = np.sqrt(2.0 * t)[:, None]
    edges = (np.arange(2 * reach + 2) - reach - 0.5) * pitch
    low, high = edges - (offset + 0.5 * light), edges - (offset - 0.5 * light)

    def rest(u: FloatArray) -> FloatArray:  # integral of the tail beyond |u|
        s = np.abs(u) / sigma
        return sigma * (np.exp(-0.5 * s * s) / math.sqrt(2.0 * math.pi) - s * scipy.special.ndtr(-s))

    # up to an edge: integral over the window of the chance to lie below it
    below = (np.maximum(high, 0.0) - np.maximum(low, 0.0)) / light + (rest(high) - rest(low)) / light
    return np.maximum(np.diff(below, axis=1), 0.0)


def kernels(
    kept: FloatArray, moved: FloatArray, along_y: FloatArray, along_x: FloatArray, beyond: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Pixel kernels of channels, and what they leave out.

    Parameters
    ----------
    kept : (channel,) array
    moved : (channel, n) array
        From `shares`, averaged over wavelength with the photons of each channel.
    along_y, along_x : (n, 2 reach + 1) array
        From `pixel_shares`.
    beyond : float
        Share of the charge that may go farther than the kernels reach; they are cut as small as that allows.

    Returns
    -------
    kernels : (channel, 2 r + 1, 2 r + 1) array
        Entry (r + i, r + j): share of a pixel's charge that arrives i rows below and j columns to the right.
    lost : (channel,) array
        What went farther, spread over the kernel in proportion, so that it sums to 1.
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
    """What uniform light becomes: (channel that collects, channel under whose filter the charge was made).

    The mean over a channel's pixels. Weighted by the number of each channel's pixels, columns sum to 1.
    """
    r = (kernel.shape[1] - 1) // 2
    height, width = mask.period
    index = channel_index(mask, height, width)
    folded = np.zeros((len(kernel), height, width))  # kernels by the place in the period on which their charge lands
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
    """A mosaic after its charge has wandered.

    Parameters
    ----------
    mosaic : (y, x) array, any unit
    kernel : (channel, 2 r + 1, 2 r + 1) array
        Of `kernels`, in the order of ``mask.channels``.
    mask : Mask
    first_row, first_column : int
        First pixel of the mosaic on the sensor.

    Returns
    -------
    (y, x) array, unit and dtype of mosaic

    Notes
    -----
    Beyond the border the mosaic is continued by whole periods of the mask (`cfa.continued`): uniform light comes out
    the same up to the border. Farther inside than the kernel reaches charge is conserved to rounding: 1e-15 of the
    total in double precision. Convolution by Fourier transform: error 3e-16 (6e-7 in single precision) of the largest
    value.
    """
    rows, columns = mosaic.shape
    r = (kernel.shape[1] - 1) // 2
    if r == 0 and (kernel == 1).all():  # all charge stays where it is
        return np.array(mosaic)
    height, width = mask.period
    extended = mosaic[np.ix_(continued(rows, height, r), continued(columns, width, r))]
    index = channel_index(mask, extended.shape[0], extended.shape[1], first_row - r, first_column - r)
    shape = tuple(scipy.fft.next_fast_len(n, real=True) for n in extended.shape)  # what wraps round stays in the margin
    total: NDArray = np.zeros((1, 1), np.complex64)
    for channel, one in enumerate(kernel):
        source = np.where(index == channel, extended, mosaic.dtype.type(0))
        response = scipy.fft.rfft2(one, shape, workers=1).astype(np.result_type(mosaic.dtype, np.complex64))
        total = total + scipy.fft.rfft2(source, shape, workers=1) * response
    spread = scipy.fft.irfft2(total, shape, workers=1)
    return np.ascontiguousarray(spread[2 * r : 2 * r + rows, 2 * r : 2 * r + columns])
