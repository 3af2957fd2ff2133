"""The dead-leaves chart: overlapping discs of all sizes, a texture that looks alike at every scale.

In:  positions y (ny,) and x (nx,) on the image plane (um, 0 in the centre), the range of radii (um), reflectances, a
     seed.
Out: reflectance (ny, nx), dimensionless, in the dtype of y and x, within the range of the requested levels.
Sources: Matheron's dead leaves; Cao, Guichard and Hornung (2009) for radii with density r^-3 as a texture target.

``softness`` and ``cell`` are the same as in ``charts.Rendering``. The discs belong to the chart, not to the grid: a
finer grid, or another softness, shows the same discs.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.scene.cell_means import step_mean
from etendue_camera.scene.charts import Rendering, require_axes, require_levels, require_positive, soft_step

LAYERS = 9.0  # mean number of discs above a point: a fraction exp(-9) of the plane is left at the mean grey
TILE = 96  # positions drawn at once along each axis
TAIL = 6.0  # rms widths beyond which the Gaussian is omitted
MOST = 4_000_000  # discs


class Leaves(NamedTuple):
    """Discs, topmost first."""

    y: FloatArray  # (n,), um
    x: FloatArray
    radius: FloatArray
    level: FloatArray  # reflectance
    low: float
    high: float


class LeafChart(NamedTuple):
    """Parameters of a dead-leaves chart.

    ``width`` and ``height``, um, above 0: size of the covered area, centred on 0. ``smallest`` and ``largest``, um, 0 <
    smallest < largest: range of the radii, whose density is r^-exponent; 3 makes the chart look alike at every scale.
    Levels are uniformly distributed from ``darkest`` to ``lightest``, reflectances. ``seed``, 0 or above, determines
    the chart: the same seed and geometry give the same chart, independently of the camera's noise.
    """

    width: float
    height: float
    smallest: float
    largest: float
    darkest: float
    lightest: float
    seed: int
    exponent: float = 3.0


@lru_cache(maxsize=4)
def leaves(chart: LeafChart) -> Leaves:
    """Return the discs of a chart.

    Returns
    -------
    Leaves

    Raises
    ------
    ValueError
        If an argument is outside its range, or the chart needs more than four million discs.
    """
    width, height, smallest, largest, low, high, seed, exponent = chart
    require_positive(width=width, height=height, smallest=smallest, largest=largest)
    require_levels(low, high)
    require.that(smallest < largest, f"smallest must be below largest, got {smallest} and {largest} um")
    require.that(seed == int(seed) and seed >= 0, f"seed must be a whole number from 0, got {seed}")
    require.that(-10 <= exponent <= 10, f"exponent must lie between -10 and 10, got {exponent}")
    area = (width + 2 * largest) * (height + 2 * largest)
    count = math.ceil(LAYERS * area / (math.pi * _mean_power(smallest, largest, exponent, 2)))
    require.that(
        count <= MOST, f"smallest is {smallest} um, for which the chart needs {count} discs; allowed: at most {MOST}"
    )
    rng = np.random.default_rng(int(seed))
    share, ratio, power = rng.random(count), largest / smallest, 1 - exponent
    flat = abs(power) < 1e-6
    radius = smallest * (ratio**share if flat else (1 + share * (ratio**power - 1)) ** (1 / power))
    y = (rng.random(count) - 0.5) * (height + 2 * largest)
    x = (rng.random(count) - 0.5) * (width + 2 * largest)
    return Leaves(y, x, radius, low + (high - low) * rng.random(count), float(low), float(high))


def _mean_power(smallest: float, largest: float, exponent: float, power: int) -> float:
    """Return the mean of radius^power over the density of the radii."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    t = 0.5 * math.log(largest / smallest) * (nodes + 1)  # logarithm of the radius
    density = weights * np.exp((1 - exponent) * t)
    return float(smallest**power * (density @ np.exp(power * t)) / density.sum())


def dead_leaves(
    y: npt.ArrayLike, x: npt.ArrayLike, chart: Leaves, softness: float, cell: float = 0.0, oversampling: int = 4
) -> FloatArray:
    """Return the reflectance of a chart.

    Parameters
    ----------
    y, x : (ny,), (nx,) arrays, um
        Evenly spaced.
    chart : Leaves
    softness : float, um
    cell : float, um
    oversampling : int, 1 to 32
        Number of drawn cells per position along each axis. The area of a drawn cell that a disc covers is computed to
        first order.

    Returns
    -------
    (ny, nx) array, reflectance

    Raises
    ------
    ValueError
        If an argument is outside its range.

    Notes
    -----
    Discs are drawn from the top, each with the fraction that is still uncovered. The result is convolved with the exact
    weights of Gaussian and cell, after reducing the width of the Gaussian by the width of the drawn cells. Errors,
    relative to the range of levels, for oversampling 2, 4, 8 and 16 and disc radii from 4 samples: with a softness of 1
    sample, rms 8e-4, 2.2e-4, 6e-5, 2.5e-5, maximum 1.2e-2, 3.3e-3, 8e-4, 3e-4; for means of hard discs over cells, rms
    2.2e-3, 7e-4, 2.1e-4, 8e-5, maximum 4e-2, 1.5e-2, 4e-3, 2e-3. 1000 x 1000 samples with discs from 5 samples take 0.7
    s.
    """
    y, x = require_axes(y, x)
    Rendering(softness, cell)  # checks their ranges
    require.that(
        oversampling == int(oversampling) and 1 <= oversampling <= 32,
        f"oversampling must be a whole number from 1 to 32, got {oversampling}",
    )
    steps = np.concatenate([np.abs(np.diff(axis)) for axis in (y, x)])
    step = float(steps.min()) if steps.size else max(float(cell), float(softness), 1e-3 * float(chart.radius.min()))
    fine = step / int(oversampling)
    found = np.empty((y.size, x.size), dtype=x.dtype)
    for rows in range(0, y.size, TILE):
        down, top = _weights(y[rows : rows + TILE], softness, cell, fine, step)
        for columns in range(0, x.size, TILE):
            across, left = _weights(x[columns : columns + TILE], softness, cell, fine, step)
            painted = _painted(chart, top, left, down.shape[1], across.shape[1], fine)
            found[rows : rows + TILE, columns : columns + TILE] = down @ painted @ across.T
    return np.clip(found, chart.low, chart.high)


def _weights(
    position: FloatArray, softness: float, cell: float, fine: float, step: float
) -> tuple[npt.NDArray[np.float32], float]:
    """Return a matrix (positions, cells) and the coordinate at which the first cell begins. Row i holds the weights,
    with a sum of 1, with which the fine painted cells add up to the value at position i.

    The borders between positions are borders of cells, so that a mean between two borders is a sum over whole cells.
    """
    reach = 0.5 * max(cell, step) + TAIL * softness
    origin = float(position[0]) - 0.5 * step
    first = origin - fine * math.ceil((origin - float(position.min()) + reach) / fine)
    count = math.ceil((float(position.max()) + reach - first) / fine)
    borders = first + fine * np.arange(count + 1)
    spread = softness**2 - fine**2 / 6  # a drawn cell holds a mean and is uniform: two box filters of its width
    width = math.sqrt(spread) if spread > fine**2 / 3 else softness
    distance = borders - position.astype(np.float64)[:, None]
    passed = step_mean(distance, width, cell) if cell > 0 else soft_step(distance, width)
    weight = np.diff(passed, axis=1)
    return (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32), first


def _painted(chart: Leaves, top: float, left: float, rows: int, columns: int, fine: float) -> npt.NDArray[np.float32]:
    """Return the mean reflectance of fine cells; discs are drawn from the top until nothing shows through."""
    y, x = ((np.arange(n) + 0.5) * fine + start for n, start in ((rows, top), (columns, left)))
    grown = chart.radius + fine
    near = np.flatnonzero(
        (chart.y + grown > y[0]) & (chart.y - grown < y[-1]) & (chart.x + grown > x[0]) & (chart.x - grown < x[-1])
    )
    free = np.ones((rows, columns), np.float32)
    value = np.zeros((rows, columns), np.float32)
    v0, v1 = (np.searchsorted(y, edge) for edge in (chart.y[near] - grown[near], chart.y[near] + grown[near]))
    u0, u1 = (np.searchsorted(x, edge) for edge in (chart.x[near] - grown[near], chart.x[near] + grown[near]))
    y32, x32 = ((axis / fine).astype(np.float32) for axis in (y - top, x - left))
    centre_y, centre_x = (chart.y[near] - top) / fine, (chart.x[near] - left) / fine
    radius, level = chart.radius[near] / fine, chart.level[near]
    for i in range(near.size):
        box = np.s_[v0[i] : v1[i], u0[i] : u1[i]]
        open_ = free[box]
        if not open_.any():
            continue
        square = np.square(y32[v0[i] : v1[i]] - np.float32(centre_y[i]))[:, None] + np.square(
            x32[u0[i] : u1[i]] - np.float32(centre_x[i])
        )
        covered = np.clip(np.float32(radius[i] + 0.5) - np.sqrt(square), 0, 1)
        covered *= open_
        open_ -= covered
        open_[open_ < 1e-6] = 0
        covered *= np.float32(level[i])
        value[box] += covered
    return value + free * np.float32(0.5 * (chart.low + chart.high))
