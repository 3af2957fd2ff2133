"""Demosaicing for any periodic colour filter array.

In:  a mosaic (y, x), linear, in any unit; its mask; its first pixel on the sensor.
Out: planes (channel, y, x) in the same unit; measured samples are unchanged.
Sources: piecewise-linear interpolation from scattered samples, with weights that depend only on the place in the
period.

For each place in the period and each channel not measured there, the samples around the place get non-negative weights
that reproduce every plane a + b y + c x. The samples are in the smallest square of neighbours that has such weights;
the weights minimise the sum of (weight x squared distance)^2. On a Bayer array these are the means of two and four
neighbours: the result equals the result of `bilinear.bilinear`, also at the border.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from etendue_camera.sensor.cfa import Mask, channel_index, continued

Tap = tuple[int, int, float]


@lru_cache(maxsize=64)
def taps(mask: Mask, row: int, column: int, channel: str) -> tuple[Tap, ...]:
    """Return the weights of the samples of a channel around one place of the period: (rows, columns, weight).

    Parameters
    ----------
    mask : Mask
    row, column : int
        The place in the period.
    channel : str
        One of ``mask.channels``.

    Returns
    -------
    tuple of (int, int, float)
        Rows and columns relative to the place, and weights above 0 that sum to 1; the weighted mean position is the
        place itself. Where the channel is measured, the place is the only sample.
    """
    height, width = mask.period
    if mask.rows[row][column] == channel:
        return ((0, 0, 1.0),)
    for reach in range(1, 2 * max(height, width) + 1):
        offsets = np.array(
            [
                (dy, dx)
                for dy in range(-reach, reach + 1)
                for dx in range(-reach, reach + 1)
                if mask.rows[(row + dy) % height][(column + dx) % width] == channel
            ],
            dtype=float,
        ).reshape(-1, 2)
        found = _weights(offsets)
        if found is not None:
            return tuple((int(dy), int(dx), float(w)) for (dy, dx), w in zip(offsets, found, strict=True) if w > 0)
    raise ValueError(
        f"pixel ({row}, {column}) of the pattern {mask} is not surrounded by pixels of channel {channel!r}"
    )


def _weights(offsets: NDArray) -> NDArray | None:
    """Return the smallest non-negative weights with sum 1 and mean offset 0; None if there are none."""
    if len(offsets) < 2:
        return None
    moments = np.vstack([np.ones(len(offsets)), offsets.T])
    wanted = np.array([1.0, 0.0, 0.0])
    cost = np.sum(offsets**2, axis=1)
    firm = 1e5  # weight of the constraints against the cost; their remaining error is corrected below
    weights, _ = scipy.optimize.nnls(
        np.vstack([firm * moments, np.diag(cost)]), np.concatenate([firm * wanted, np.zeros(len(offsets))])
    )
    if np.abs(moments @ weights - wanted).max() > 1e-6:
        return None
    used = weights > 1e-9
    scaled = moments[:, used] / cost[used]
    # exact least-squares solution on the samples with a weight: minimum norm of cost x weight
    exact = np.linalg.lstsq(scaled, wanted, rcond=None)[0] / cost[used]
    if exact.min() < -1e-12 or np.abs(moments[:, used] @ exact - wanted).max() > 1e-12:
        return None
    result = np.zeros(len(offsets))
    result[used] = np.maximum(exact, 0.0)
    return result


def linear(mosaic: NDArray, mask: Mask, first_row: int = 0, first_column: int = 0) -> NDArray:
    """Interpolate missing channels piecewise linearly from the nearest samples.

    Parameters
    ----------
    mosaic : (y, x) array, any unit
    mask : Mask
    first_row, first_column : int
        Position of the mosaic's first pixel on the sensor.

    Returns
    -------
    (channel, y, x) array, unit and dtype of mosaic (integers become float64)
        In the order of ``mask.channels``. Always within the range of the channel's samples.

    Raises
    ------
    ValueError
        If mosaic is not (y, x) with at least one sample.

    Notes
    -----
    Exact for constant planes everywhere, and for linear planes farther from the border than the weights extend (one
    pixel for Bayer, two for quad-Bayer and X-Trans, three for RGBW). Beyond the border the mosaic is continued by whole
    periods (`cfa.continued`). A frame shorter than the period uses the nearest sample instead, and for a channel that
    it does not contain the mean of the other channels.
    """
    mosaic = np.asarray(mosaic)
    if mosaic.ndim != 2 or mosaic.size == 0:
        raise ValueError(f"mosaic has shape {mosaic.shape}; it must be (y, x), at least 1 x 1")
    if not np.issubdtype(mosaic.dtype, np.floating):
        mosaic = mosaic.astype(np.float64)
    rows, columns = mosaic.shape
    height, width = mask.period
    if rows < height or columns < width:
        return _nearest(mosaic, mask, first_row, first_column)
    places = [(y, x) for y in range(height) for x in range(width)]
    wanted = _all_taps(mask)
    reach = _farthest(wanted)
    framed = mosaic[np.ix_(continued(rows, height, reach), continued(columns, width, reach))]
    planes = np.empty((len(mask.channels), rows, columns), mosaic.dtype)
    for y, x in places:
        top, left = (y - first_row) % height, (x - first_column) % width
        for plane, channel in zip(planes, mask.channels, strict=True):
            site = plane[top::height, left::width]
            total = None
            for dy, dx, weight in wanted[y, x, channel]:
                down, right = reach + top + dy, reach + left + dx
                some = framed[down : down + (rows - top) : height, right : right + (columns - left) : width]
                some = some if weight == 1.0 else some * mosaic.dtype.type(weight)
                total = some if total is None else total + some
            site[...] = total
    return planes


def reach_of(mask: Mask) -> int:
    """Return the largest distance in rows between a place and a sample that contributes to it, but at least one period,
    because a frame of fewer rows is interpolated by another method.
    """
    return max(_farthest(_all_taps(mask)), mask.period[0])


def _all_taps(mask: Mask) -> dict[tuple[int, int, str], tuple[Tap, ...]]:
    height, width = mask.period
    return {(y, x, c): taps(mask, y, x, c) for y in range(height) for x in range(width) for c in mask.channels}


def _farthest(wanted: dict[tuple[int, int, str], tuple[Tap, ...]]) -> int:
    return max(max(abs(dy), abs(dx)) for found in wanted.values() for dy, dx, _ in found)


def _nearest(mosaic: NDArray, mask: Mask, first_row: int, first_column: int) -> NDArray:
    rows, columns = mosaic.shape
    index = channel_index(mask, rows, columns, first_row, first_column)
    planes = np.empty((len(mask.channels), *mosaic.shape), mosaic.dtype)
    present = [c for c in range(len(planes)) if (index == c).any()]
    for c in present:
        y, x = scipy.ndimage.distance_transform_edt(index != c, return_distances=False, return_indices=True)
        planes[c] = mosaic[y, x]
    mean = planes[present].mean(axis=0).astype(mosaic.dtype)
    for c in set(range(len(planes))).difference(present):
        planes[c] = mean
    return planes
