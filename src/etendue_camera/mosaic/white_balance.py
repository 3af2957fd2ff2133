"""White balance before demosaicing: estimate the white of a mosaic, and equalise its channels.

In:  a linearised mosaic (y, x), 1 at clipping; the mask of its filters; whites by channel.
Out: whites, gains, balanced mosaics, the level shown as white, the angle between two whites.
Sources: Buchsbaum 1980, J. Franklin Inst. 310 (grey world); Land and McCann 1971, J. Opt. Soc. Am. 61 (white patch);
Finlayson and Trezzi 2004, Color Imaging Conf. 12 (power means between the two). Each estimate is as good as its
assumption about the scene.
"""

import numpy as np
from numpy.typing import ArrayLike

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.sensor import cfa

VANISHING = 1e-9  # of the largest response: below it a gain would be noise


def cell_means(
    mosaic: FloatArray,
    mask: cfa.Mask,
    cell: int,
    ceiling: float,
    lowest: float,
    first_row: int = 0,
    first_column: int = 0,
) -> tuple[FloatArray, int]:
    """Return the mean of each channel over small cells of a mosaic, omitting clipped and dark cells.

    Parameters
    ----------
    mosaic : (y, x) array, 1 at clipping
    mask : cfa.Mask
    cell : int, pixel
        Side of the cells, at least 1; rounded up to whole periods of the mask, so that a cell contains every channel.
    ceiling : float
        Cells that contain a value at or above this level are omitted.
    lowest : float
        Cells whose mean is below this value are omitted.
    first_row, first_column : int
        Position of the mosaic's first pixel on the sensor.

    Returns
    -------
    means : (channel, n) array of float64
        Mean signals of the n remaining cells; n may be 0.
    cells : int
        Number of all cells. Rows and columns beyond the last whole cell are ignored.

    Raises
    ------
    ValueError
        If the mosaic is not a finite (y, x) array with pixels, the cell is below 1, or the frame has no pixel of a
        channel.

    Notes
    -----
    Cells are used or omitted as a whole, so that all channels are averaged over the same places. If pixels were omitted
    one by one, the channel that clips first would miss bright places, and the estimate would be biased against that
    channel.
    """
    mosaic = np.asarray(mosaic)
    require.shape(
        mosaic.ndim == 2 and mosaic.size and np.isfinite(mosaic).all(),
        "mosaic",
        mosaic,
        "(y, x) with pixels, all of them finite",
    )
    require.allowed(cell >= 1, "cell", cell, "whole numbers from 1")
    # whole periods, at least ``cell``, but no more than the frame has; a frame below one period is one cell
    sides = [
        max(min(-(-cell // period) * period, size // period * period), min(size, period))
        for size, period in zip(mosaic.shape, mask.period, strict=True)
    ]
    counts = [size // side for size, side in zip(mosaic.shape, sides, strict=True)]
    blocks = mosaic[: counts[0] * sides[0], : counts[1] * sides[1]].reshape(counts[0], sides[0], counts[1], sides[1])
    index = cfa.channel_index(mask, sides[0], sides[1], first_row, first_column)
    means = np.full((len(mask.channels), *counts), np.nan)
    for number, channel in enumerate(mask.channels):
        here = index == number
        if not here.any():
            raise ValueError(
                f"a frame of {mosaic.shape[0]} x {mosaic.shape[1]} pixels has no pixels of channel {channel}: "
                "white cannot be estimated from it"
            )
        means[number] = np.einsum("iajb,ab->ij", blocks, here / here.sum(), dtype=np.float64, casting="same_kind")
    usable = (blocks.max(axis=(1, 3)) < ceiling) & (blocks.mean(axis=(1, 3), dtype=np.float64) >= lowest)
    return means[:, usable], usable.size


def grey_world(means: FloatArray, power: float = 1.0) -> FloatArray:
    """Return the white of a scene that is grey on average: the power mean over cells, by channel.

    Parameters
    ----------
    means : (channel, n) array
        At least one cell.
    power : float
        1 or above: 1 is the plain mean, larger values emphasise the brightest cells. Above 1, negative values count as
        0.

    Returns
    -------
    (channel,) array, unit of means

    Raises
    ------
    ValueError
        Without cells, or for a power below 1 or infinite.
    """
    means = _some(means)
    require.allowed(1 <= power < np.inf, "power", power, "finite numbers from 1; for an infinite power use white_patch")
    if power == 1:
        return means.mean(axis=1)
    above = np.maximum(means, 0.0)
    largest = above.max(axis=1)
    scale = np.where(largest > 0, largest, 1.0)  # so that no power overflows or vanishes
    return scale * np.mean((above / scale[:, None]) ** power, axis=1) ** (1.0 / power)


def white_patch(means: FloatArray, quantile: float = 0.99) -> FloatArray:
    """Return the white of a scene whose brightest area is white: a quantile over cells, by channel.

    Parameters
    ----------
    means : (channel, n) array
        At least one cell.
    quantile : float
        Above 0, at most 1. Below 1, a few hot pixels or glints do not dominate.

    Returns
    -------
    (channel,) array, unit of means

    Raises
    ------
    ValueError
        Without cells, or for a quantile out of range.
    """
    require.allowed(0 < quantile <= 1, "quantile", quantile, "numbers above 0 and at most 1")
    return np.asarray(np.quantile(_some(means), quantile, axis=1))


def _some(means: FloatArray) -> FloatArray:
    means = np.asarray(means, np.float64)
    require.shape(
        means.ndim == 2 and means.shape[1],
        "means",
        means,
        "(channel, n) with at least one cell: neither clipped nor dark",
    )
    return means


def angle_between(one: ArrayLike, other: ArrayLike) -> float:
    """Return the angle between two whites; their levels do not matter.

    Parameters
    ----------
    one, other : (channel,) array
        Not zero.

    Returns
    -------
    float, degrees
        0 to 180.

    Raises
    ------
    ValueError
        For shapes that differ, or a vector that is zero or not finite.

    Notes
    -----
    Source: Kahan's 2 atan(|u - v| / |u + v|) of the unit vectors; the arc cosine of their product loses all digits
    below 1e-6 degrees. Error: below 4e-16 relative to 1 rad.
    """
    units = []
    for vector in (np.asarray(one, np.float64), np.asarray(other, np.float64)):
        largest = np.abs(vector).max(initial=0.0)
        if vector.ndim != 1 or not 0 < largest < np.inf:
            raise ValueError(f"a white is {vector.tolist()}; it must be finite and not all 0")
        scaled = vector / largest
        units.append(scaled / np.linalg.norm(scaled))
    if units[0].shape != units[1].shape:
        raise ValueError(f"whites have {units[0].size} and {units[1].size} channels; they must have equal numbers")
    return float(np.degrees(2 * np.arctan2(np.linalg.norm(units[0] - units[1]), np.linalg.norm(units[0] + units[1]))))


def lifted(responses: ArrayLike, floor: float) -> tuple[FloatArray, int]:
    """Return responses to a white, with vanishing responses raised to a floor.

    Parameters
    ----------
    responses : (n,) array
        Responses of cones or of a camera's channels.
    floor : float
        Fraction of the largest response to which weaker ones are raised, at least 0 and below 1; 0 raises no channel.

    Returns
    -------
    responses : (n,) array of float64
    count : int
        Number of raised responses.

    Raises
    ------
    ValueError
        If no response is above 0, a response is not finite, or the floor is out of range. With a floor of 0, also for a
        response below 1e-9 of the largest: its gain would be infinite, negative or mere noise.
    """
    found = np.asarray(responses, np.float64)
    require.allowed(0 <= floor < 1, "floor", floor, "numbers from 0 and below 1")
    largest = found.max(initial=0.0)
    if found.ndim != 1 or not np.isfinite(found).all() or not largest > 0:
        raise ValueError(f"the white is {found.tolist()}; it must be finite with at least one value above 0")
    if floor == 0:
        if not found.min() >= VANISHING * largest:
            raise ValueError(
                f"the white has a vanishing channel ({found.tolist()}), whose gain would be infinite or noise; "
                "set a floor above 0, or check the filter, the illuminant and peak_qe"
            )
        return found.copy(), 0
    weak = found < floor * largest
    return np.where(weak, floor * largest, found), int(np.count_nonzero(weak))


def gains_of(white: ArrayLike) -> FloatArray:
    """Return gains that make all channels of a white equal to its largest.

    They are at least 1, so that clipped values do not fall below the clipping level.

    Parameters
    ----------
    white : (channel,) array
        Above 0.

    Returns
    -------
    (channel,) array of float64
        Exactly 1 for the largest channel, which is the first to clip.

    Raises
    ------
    ValueError
        If a channel vanishes.
    """
    found, _ = lifted(white, 0.0)
    return found.max() / found


def display_white(white: float, clipped: float, fixed: bool = False) -> float:
    """Return the level of a balanced picture that is rendered as display white.

    Parameters
    ----------
    white : float, above 0
        Level of the scene white if nothing clipped.
    clipped : float, above 0
        Lowest level at which a balanced channel clips.
    fixed : bool
        Whether brightness is set by the camera instead of the scene.

    Returns
    -------
    float
        At most ``clipped``, so that clipped areas are never grey.

    Raises
    ------
    ValueError
        If a level is at or below 0, or NaN.
    """
    require.that(
        white > 0 and 0 < clipped < np.inf,
        f"white is {white!r} and clipping begins at {clipped!r}; allowed: numbers above 0",
    )
    return clipped if fixed else min(white, clipped)


def balanced(
    mosaic: FloatArray,
    gains: ArrayLike,
    mask: cfa.Mask,
    first_row: int = 0,
    first_column: int = 0,
    ceiling: float = np.inf,
) -> FloatArray:
    """Multiply each pixel by the gain of its channel.

    Parameters
    ----------
    mosaic : (..., y, x) array
    gains : (channel,) array
        In the order of ``mask.channels``.
    mask : cfa.Mask
    first_row, first_column : int
        Position of the mosaic's first pixel on the sensor.
    ceiling : float
        Level at which all channels are clipped; inf: no clipping.

    Returns
    -------
    (..., y, x) array, dtype of mosaic
        A channel with gain 1 is unchanged below the ceiling, bit for bit.

    Raises
    ------
    ValueError
        If the numbers of gains and channels differ, or the mosaic has fewer than two dims.
    """
    mosaic, gains = np.asarray(mosaic), np.asarray(gains, np.float64)
    require.that(
        mosaic.ndim >= 2 and gains.shape == (len(mask.channels),),
        f"mosaic has shape {mosaic.shape} and gains {gains.shape}; allowed: (..., y, x) and ({len(mask.channels)},)",
    )
    found = np.empty_like(mosaic)
    for channel, gain in zip(mask.channels, gains, strict=True):
        for rows, columns in cfa.sites_of(mask, channel, first_row, first_column):
            where = (..., rows, columns)
            np.multiply(mosaic[where], mosaic.dtype.type(gain), out=found[where])
    if ceiling < np.inf:
        found.clip(max=mosaic.dtype.type(ceiling), out=found)
    return found
