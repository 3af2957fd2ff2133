"""Merge several exposures of one scene: mean, clipped mean, and the noise-weighted merge of a bracket.

In:  frames of linear values, times, the level at which each saturates, their noise model.
Out: the light per time, and its remaining variance.
Sources: inverse-variance weights: Granados et al., "Optimal HDR reconstruction with linear digital cameras", CVPR 2010,
section 3 (weights from the expected signal; weights from the noisy value would favour values that are too dark by
chance). Clipped mean: Stetson, PASP 99 (1987).
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue_camera.arrays import Array

Noise = tuple[ArrayLike, ArrayLike]  # shot noise and floor
NEAR = 0.95  # of the saturation level: values from here on may be clipped


def usable(frames: NDArray, level: ArrayLike, margin: int) -> NDArray[np.bool_]:
    """Return a mask: true where no channel is clipped at or around the pixel, since demosaicing spreads clipped values.

    Parameters
    ----------
    frames : (frame, channel, y, x) array, linear
    level : (frame,), unit of frames
        Level at which each frame saturates.
    margin : int, pixels
        At or above 0.

    Returns
    -------
    (frame, y, x) array of bool
    """
    cut = (frames >= NEAR * np.asarray(level)[:, None, None, None].astype(frames.dtype)).any(axis=1)
    return np.asarray(~scipy.ndimage.maximum_filter(cut, size=(1, 2 * margin + 1, 2 * margin + 1)) if margin else ~cut)


def pooled(frames: NDArray, times: ArrayLike, used: NDArray[np.bool_]) -> NDArray:
    """Return the light per time: the sum of the used frames over the sum of their times.

    Where no frame is used, return the light of the shortest frame.

    Parameters
    ----------
    frames : (frame, channel, y, x) array, linear
    times : (frame,), above 0, in any unit, such as the shortest time
    used : (frame, 1 or channel, y, x) array of bool

    Returns
    -------
    (channel, y, x) array, unit of frames per time

    Notes
    -----
    This is the best estimate if shot noise is the only noise: photons over time.
    """
    t = np.asarray(times, frames.dtype)[:, None, None, None]
    total = (t * used).sum(axis=0)
    shortest = int(np.argmin(times))
    held = np.where(total > 0, (frames * used).sum(axis=0), frames[shortest])
    return np.asarray(held / np.where(total > 0, total, t[shortest]))


def variance_of(rate: NDArray, times: ArrayLike, noise: Noise) -> NDArray:
    """Return the variance of each frame's light per time.

    Parameters
    ----------
    rate : (channel, y, x) array, unit per time
        Expected light per time.
    times : (frame,)
    noise : two (channel,) arrays, unit and unit^2
        Variance of a value in a frame: the first array times the value, plus the second array.

    Returns
    -------
    (frame, channel, y, x) array, unit^2 per time^2

    Raises
    ------
    ValueError
        If a variance exceeds the range of the dtype of the rate.
    """
    t = np.asarray(times, rate.dtype)[:, None, None, None]
    a, b = (np.asarray(x, rate.dtype)[:, None, None] for x in noise)
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise ValueError(
            f"the noise of a frame has a variance of {np.max(noise[1]):.3g}, beyond {rate.dtype}; use a larger "
            f"conversion gain"
        )
    return np.asarray((a * np.maximum(rate, 0) * t + b) / t**2)


def merged(
    frames: NDArray,
    times: ArrayLike,
    level: ArrayLike,
    noise: Noise,
    method: str,
    sigmas: float,
    margin: int,
) -> tuple[NDArray, NDArray]:
    """Merge several frames into one picture of light per time; return the picture and its variance.

    Parameters
    ----------
    frames : (frame, channel, y, x) array, linear
    times : (frame,)
    level : (frame,), unit of frames
    noise : two (channel,) arrays
        As in `variance_of`.
    method : 'mean', 'sigma_clipped' or 'hdr'
        Frames to use at each pixel: all; those within ``sigmas`` of the median; or the values that are not clipped,
        weighted by their known noise.
    sigmas : float
        Above 0.
    margin : int, pixels
        Distance up to which pixels around a clipped pixel are excluded.

    Returns
    -------
    rate : (channel, y, x) array, unit per time
    variance : the same, unit^2 per time^2
        Variance of a measured value of the mosaic with these weights; demosaicing reduces the noise of interpolated
        values further.

    Raises
    ------
    ValueError
        For an unknown method, or a time that is not above 0.
    """
    if not np.all(np.asarray(times) > 0):
        raise ValueError(
            f"the times of the frames are {', '.join(f'{t:g}' for t in np.ravel(times))}; they must be above 0"
        )
    t = np.asarray(times, frames.dtype)[:, None, None, None]
    if method == "mean":
        used: Array = np.ones((len(frames), 1, 1, 1), bool)
    elif method == "sigma_clipped":
        middle = np.median(frames / t, axis=0)
        used = np.abs(frames / t - middle) <= sigmas * np.sqrt(variance_of(middle, times, noise))
    elif method == "hdr":
        used = usable(frames, level, margin)[:, None]
    else:
        raise ValueError(f"method is {method!r}; allowed: mean, sigma_clipped, hdr")
    rate = pooled(frames, times, used)
    variance = variance_of(rate, times, noise)
    shortest = int(np.argmin(times))
    if method != "hdr":
        total = np.broadcast_to((t * used).sum(axis=0), rate.shape)
        left = (variance * t**2 * used).sum(axis=0) / np.where(total > 0, total, 1) ** 2
        return rate, np.where(total > 0, left, variance[shortest])
    weight = np.where(used, 1 / np.maximum(variance, np.finfo(frames.dtype).tiny), 0)
    whole = weight.sum(axis=0)
    best = (weight * (frames / t)).sum(axis=0) / np.where(whole > 0, whole, 1)
    return np.where(whole > 0, best, rate), np.where(whole > 0, 1 / np.where(whole > 0, whole, 1), variance[shortest])
