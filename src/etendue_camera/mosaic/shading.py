"""Lens shading correction: gains that flatten a frame of uniform light, from known falloff or from a flat field.

In:  relative illumination; tables of gains by image height; a flat field behind a mask.
Out: gains; tables.
Sources: a gain is the inverse of the relative illumination. Black is unchanged: 0 in a linearised mosaic means no
light.
"""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.sensor import cfa

PIECES = 16  # of the curve through a flat field, each covering the same area of the frame


class GainTable(NamedTuple):
    """Gains by image height: nodes (rows,) in mm from 0 upwards, gains (rows, columns), column names."""

    heights_mm: FloatArray
    gains: FloatArray
    columns: tuple[str, ...]


def gain_of(relative: ArrayLike, strength: float, largest: float) -> FloatArray:
    """Return gains that correct a relative illumination, fully or partly.

    Parameters
    ----------
    relative : (...) array, 1
        At or above 0; 1 on the axis.
    strength : float
        Fraction of the correction, 0 to 1: the gain is 1 + strength (1/relative - 1).
    largest : float
        Upper limit of the gains, at least 1.

    Returns
    -------
    (...) array, dtype of relative
        At most ``largest``; exactly 1 where the relative illumination is 1, or if the strength is 0.

    Raises
    ------
    ValueError
        If arguments are out of range.
    """
    relative = np.asarray(relative)
    require.allowed(0 <= strength <= 1, "strength", strength, "numbers from 0 to 1")
    require.allowed(1 <= largest < np.inf, "largest", largest, "finite numbers from 1: noise grows by as much")
    if not np.all(relative >= 0):
        raise ValueError(f"relative goes down to {np.nanmin(relative):g} or is NaN; it must be at or above 0")
    kind = relative.dtype.type
    held = np.maximum(relative, kind(1e-30))  # an unlit corner gets the largest gain, not an infinite one
    return np.asarray(np.minimum(1 + kind(strength) * (1 / held - 1), kind(largest)))


def read_gains(file: str | Path) -> GainTable:
    """Read a table from a CSV file: ``height_mm,gain`` for all channels, or ``height_mm,R,G,B``.

    Parameters
    ----------
    file : path
        One row per height, ascending from 0 on the axis; lines that start with # are comments.

    Returns
    -------
    GainTable

    Raises
    ------
    ValueError
        If the header or a row cannot be read, heights do not start at 0 or do not ascend, or a gain is not above 0. The
        message names the row.
    """
    with open(file, newline="", encoding="utf-8-sig") as opened:
        rows = [
            [cell.strip() for cell in row]
            for row in csv.reader(line for line in opened if not line.startswith("#"))
            if row
        ]
    if not rows or rows[0][0] != "height_mm" or len(rows[0]) < 2:
        raise ValueError(
            f"{file} starts with {','.join(rows[0]) if rows else 'nothing'}; expected height_mm,gain or height_mm,R,G,B"
        )
    table = np.empty((len(rows) - 1, len(rows[0])))
    for number, row in enumerate(rows[1:]):
        try:
            table[number] = [float(cell) for cell in row]
        except ValueError:
            raise ValueError(f"{file}, row {number + 1}: {','.join(row)}; expected {table.shape[1]} numbers") from None
        if not (np.isfinite(table[number]).all() and table[number, 1:].min() > 0):
            raise ValueError(f"{file}, row {number + 1}: {','.join(row)}; numbers must be finite and gains above 0")
    require.that(
        len(table) and table[0, 0] == 0 and not np.any(np.diff(table[:, 0]) <= 0),
        f"{file}: heights must start at 0, the axis, and ascend",
    )
    return GainTable(table[:, 0], table[:, 1:], tuple(rows[0][1:]))


def write_gains(file: str | Path, table: GainTable) -> None:
    """Write a table that `read_gains` restores to the last bit."""
    with open(file, "w", newline="", encoding="utf-8") as opened:
        writer = csv.writer(opened, lineterminator="\n")
        writer.writerow(["height_mm", *table.columns])
        writer.writerows(
            [repr(float(h)), *(repr(float(g)) for g in row)]
            for h, row in zip(table.heights_mm, table.gains, strict=True)
        )


def calibrated(
    flat: FloatArray,
    mask: cfa.Mask,
    y_mm: FloatArray,
    x_mm: FloatArray,
    rows: int = 129,
    first_row: int = 0,
    first_column: int = 0,
) -> GainTable:
    """Calibrate a camera's table from a flat field, as its manufacturer would: gains of each channel by image height.

    Parameters
    ----------
    flat : (y, x) array, any unit
        Linearised mosaic of uniform light, black at 0; the mean of many frames if they are noisy.
    mask : cfa.Mask
    y_mm, x_mm : (y,), (x,) array, mm
        Positions relative to the axis, which must lie inside the frame.
    rows : int
        Number of rows of the table, at least 2; evenly spaced from the axis to the farthest pixel.
    first_row, first_column : int
        Position of the frame's first pixel on the sensor.

    Returns
    -------
    GainTable
        One column per channel, 1 on the axis.

    Raises
    ------
    ValueError
        If shapes do not fit, the axis is outside the frame, a channel has pixels at fewer than 8 heights, or its curve
        is not above 0 everywhere.

    Notes
    -----
    A cubic spline in the square of the height is fitted to all pixels of a channel by least squares: it is even about
    the axis, and each of its pieces covers equally many pixels. The largest error comes from linear interpolation
    between the rows: 3e-5 of the light for cos4 up to 39 degrees with 129 rows, falling with the square of the number
    of rows. A kink, where a rim begins to vignette, is rounded over a sixteenth of the area.
    """
    flat = np.asarray(flat)
    require.shape(
        flat.ndim == 2 and flat.shape == (np.size(y_mm), np.size(x_mm)) and np.isfinite(flat).all(),
        "flat",
        flat,
        f"({np.size(y_mm)}, {np.size(x_mm)}) as the positions say, all finite",
    )
    require.allowed(rows >= 2, "rows", rows, "whole numbers from 2")
    require.that(
        not min(y_mm) * max(y_mm) > 0 and not min(x_mm) * max(x_mm) > 0,
        "the axis is outside the frame; gains are relative to it: calibrate with a frame that contains it",
    )
    radius = np.hypot(np.asarray(y_mm, float)[:, None], np.asarray(x_mm, float)[None, :])
    nodes = np.linspace(0.0, radius.max(), rows)
    index = cfa.channel_index(mask, flat.shape[0], flat.shape[1], first_row, first_column)
    gains = np.empty((rows, len(mask.channels)))
    for number, channel in enumerate(mask.channels):
        here = index == number
        squared = (radius[here] / nodes[-1]) ** 2
        if np.unique(squared).size < 8:
            raise ValueError(
                f"channel {channel} has pixels at {np.unique(squared).size} heights; at least 8 are required"
            )
        curve = _curve(squared, flat[here].astype(float), (nodes / nodes[-1]) ** 2)
        if not curve.min() > 0:
            raise ValueError(
                f"channel {channel} falls to {curve.min():g} of the flat field; gains require light everywhere"
            )
        gains[:, number] = curve[0] / curve
    return GainTable(nodes, gains, mask.channels)


def _curve(where: FloatArray, values: FloatArray, nodes: FloatArray) -> FloatArray:
    """Return a least-squares cubic spline through points, at nodes; positions and nodes are between 0 and 1."""
    places, group, count = np.unique(where, return_inverse=True, return_counts=True)
    means = np.bincount(group, values) / count
    pieces = max(1, min(PIECES, places.size // 8))
    inner = np.linspace(0.0, 1.0, pieces + 1)
    inner[0], inner[-1] = places[0], places[-1]
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    return np.asarray(scipy.interpolate.make_lsq_spline(places, means, knots, k=3, w=np.sqrt(count))(nodes))
