"""Fidelity to a reference: PSNR, SSIM, and statistics of a map of differences.

In:  a picture and its reference on the same pixels, (3, y, x) or (y, x), same units.
Out: decibels, a similarity of at most 1, statistics of a map.
Sources: Wang, Bovik, Sheikh, Simoncelli 2004 (SSIM); other sources at each function.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from etendue import require

WINDOW, SPREAD = 11, 1.5  # SSIM window, pixels: width, and standard deviation of its weights
K1, K2 = 0.01, 0.03


class MapSpread(NamedTuple):
    """Statistics of a map of differences."""

    mean: float
    median: float
    p95: float  # 95 % of the pixels are at or below it


def psnr(picture: ArrayLike, reference: ArrayLike, peak: float = 1.0) -> float:
    """Return the peak signal-to-noise ratio: the squared peak over the mean squared error of all values.

    Parameters
    ----------
    picture, reference : (...) array, same shape
        Channels have equal weights, as in the CPSNR of the demosaicing literature.
    peak : float, above 0
        Full scale in the same unit: 1 for linear or encoded pictures, 255 for 8 bit.

    Returns
    -------
    float, dB
        10 log10(peak^2 / MSE); infinity for equal pictures, NaN if one contains NaN.

    Raises
    ------
    ValueError
        If the shapes differ, there is no pixel, or the peak is not above 0.

    Notes
    -----
    Differences and sums are float64 for any input: float32 sums over a million pixels would lose 4 of 7
    digits. Error: below 1e-12 dB against long double sums.

    Examples
    --------
    >>> import numpy as np
    >>> from etendue_camera.quality.fidelity import psnr
    >>> round(psnr(np.full((8, 8), 0.6), np.full((8, 8), 0.5)), 6)
    20.0
    """
    picture, reference = _pair(picture, reference)
    peak = _above_zero("peak", peak)
    error = np.subtract(picture, reference, dtype=np.float64).ravel()
    mean_square = float(error @ error) / error.size
    return float("inf") if mean_square == 0 else float(20 * np.log10(peak) - 10 * np.log10(mean_square))


def ssim_map(picture: ArrayLike, reference: ArrayLike, peak: float = 1.0) -> NDArray[np.float64]:
    """Return the structural similarity at every position where the window fits.

    Parameters
    ----------
    picture, reference : (..., y, x) array, same shape
        At least 11 pixels high and wide; leading dims are channels, which are compared separately.
    peak : float, above 0
        Full scale.

    Returns
    -------
    (..., y - 10, x - 10) array, dimensionless
        1 where the surroundings are equal, lower where they differ; it can be negative.

    Raises
    ------
    ValueError
        If the shapes differ, the picture is smaller than the window, or the peak is not above 0.

    Notes
    -----
    Source: Wang et al. 2004 eq. 13 with its window (11 x 11, Gaussian of 1.5 pixels, weights summing to 1) and
    K1 = 0.01, K2 = 0.03; variances are population variances of the weighted window, not sample variances. Error: below
    1e-12 against sums over each window (float64), due to cancellation in E[x^2] - E[x]^2.
    """
    picture, reference = _pair(picture, reference)
    require.that(
        picture.ndim >= 2 and min(picture.shape[-2:]) >= WINDOW,
        f"picture has shape {picture.shape}; allowed: at least {WINDOW} x {WINDOW} pixels, the window of SSIM",
    )
    peak = _above_zero("peak", peak)
    x, y = picture.astype(np.float64), reference.astype(np.float64)
    mean_x, mean_y = _windowed(x), _windowed(y)
    square = _windowed(x * x + y * y) - mean_x**2 - mean_y**2
    cross = _windowed(x * y) - mean_x * mean_y
    c1, c2 = (K1 * peak) ** 2, (K2 * peak) ** 2
    return (2 * mean_x * mean_y + c1) * (2 * cross + c2) / ((mean_x**2 + mean_y**2 + c1) * (square + c2))


def ssim(picture: ArrayLike, reference: ArrayLike, peak: float = 1.0) -> float:
    """Return the mean structural similarity over all window positions and channels; see `ssim_map`."""
    return float(ssim_map(picture, reference, peak).mean())


def spread(values: ArrayLike) -> MapSpread:
    """Return mean, median and 95th percentile of a map of differences; all NaN if it contains NaN.

    Raises
    ------
    ValueError
        If there is no value.
    """
    values = np.asarray(values)
    require.that(values.size != 0, "values is empty; a map of at least one pixel is required")
    median, p95 = np.quantile(values.astype(np.float64).ravel(), (0.5, 0.95))
    return MapSpread(float(np.mean(values, dtype=np.float64)), float(median), float(p95))


def _windowed(planes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weighted mean over the window, at every position where the window fits."""
    reach = WINDOW // 2
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / SPREAD) ** 2)
    weights /= weights.sum()
    inside = slice(reach, -reach)
    columns = scipy.ndimage.correlate1d(planes, weights, axis=-1)[..., inside]
    return scipy.ndimage.correlate1d(columns, weights, axis=-2)[..., inside, :]


def _pair(picture: ArrayLike, reference: ArrayLike) -> tuple[NDArray, NDArray]:
    picture, reference = np.asarray(picture), np.asarray(reference)
    require.equal_shapes("picture", picture, "reference", reference)
    require.shape(picture.size != 0, "picture", picture, "at least one pixel")
    return picture, reference


def _above_zero(name: str, value: float) -> float:
    require.only(np.ndim(value) == 0 and 0 < value < np.inf, name, repr(value), "a number above 0")
    return float(value)
