"""Grids of nodes over a frame, fine enough to interpolate kernels bilinearly.

In:  positions on the image grid (um), kernels of any image point, the allowed error.
Out: nodes, their kernels and the interpolation error.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from etendue import require
from etendue_camera.arrays import FloatArray
from etendue_camera.field.psf_kernels import Sampler

_LARGEST = 512 << 20  # maximum bytes of kernels
_MOST = 100_000  # maximum number of kernels: a minute or two
_FAIR = 0.25  # expected factor on the interpolation error when the grid spacing is halved


class Level(NamedTuple):
    """Nodes along y and x, kernels (nodes y, nodes x, wavelengths, size, size), and the interpolation error."""

    grid: tuple[int, int]
    kernels: FloatArray
    error: float


def spacing_of(y: FloatArray, x: FloatArray, alone: float) -> float:
    """Return the spacing of positions, which must be even and equal along both axes; ``alone`` for a single
    position.
    """
    steps = []
    for name, line in (("y_um", y), ("x_um", x)):
        require.that(line.ndim == 1 and line.size >= 1, f"{name} has shape {line.shape}; it must be one-dimensional")
        if line.size > 1:
            step = (line[-1] - line[0]) / (line.size - 1)
            require.that(
                step > 0 and not np.abs(np.diff(line) - step).max() > 1e-6 * step + 1e-9 * np.abs(line).max(),
                f"{name} must ascend in even steps",
            )
            steps.append(float(step))
    if len(steps) == 2 and abs(steps[0] - steps[1]) > 1e-6 * steps[0]:
        raise ValueError(
            f"samples are {steps[0]:g} um apart along y and {steps[1]:g} um along x; kernels need the same spacing "
            f"along both"
        )
    return steps[0] if steps else alone


def _positions(line: FloatArray, nodes: int) -> FloatArray:
    return np.linspace(line[0], line[-1], nodes) if nodes > 1 else np.array([0.5 * (line[0] + line[-1])])


def _kernels(sampler: Sampler, y: FloatArray, x: FloatArray, grid: tuple[int, int]) -> FloatArray:
    yy, xx = np.meshgrid(_positions(y, grid[0]), _positions(x, grid[1]), indexing="ij")
    return sampler.kernels(yy.ravel(), xx.ravel()).reshape(*grid, -1, sampler.size, sampler.size)


def _grid_of(cells: int, ny: int, nx: int) -> tuple[int, int]:
    """Return the number of nodes along y and x for a number of cells along the longer side of a frame."""
    longest = max(ny, nx)
    rows, columns = (1 if n == 1 else min(n, max(1, round(cells * n / longest)) + 1) for n in (ny, nx))
    return rows, columns


def _too_many(grid: tuple[int, int], size: int, wavelengths: int) -> bool:
    """Return whether the next finer grid of nodes exceeds the limits on kernels."""
    finer = (2 * grid[0] - 1) * (2 * grid[1] - 1)
    return finer * size**2 * wavelengths * 8 > _LARGEST or finer * wavelengths > _MOST


def kernels_fit(size: int, wavelengths: int, ny: int, nx: int) -> bool:
    """Return whether the interpolation error can be measured for kernels of this size.

    That is the case if the first grid has a node at every sample, or if its spacing can be halved.

    Parameters
    ----------
    size : int
        Samples along each side of a kernel.
    wavelengths : int
        Number of kernels at each node.
    ny, nx : int
        Number of samples of the frame.
    """
    grid = _grid_of(2, ny, nx)
    return grid == (ny, nx) or not _too_many(grid, size, wavelengths)


def refined(sampler: Sampler, y: FloatArray, x: FloatArray, goal: float, last_goal: float, count: int) -> list[Level]:
    """Halve the grid spacing repeatedly; return the first grid whose error meets ``goal`` and, if different, the first
    that meets ``last_goal``.
    """
    grid = _grid_of(max(count - 1, 1) if count else 2, y.size, x.size)
    kernels, before = _kernels(sampler, y, x, grid), np.inf
    good: list[Level] = []
    while True:
        if grid == (y.size, x.size):
            return [*good, Level(grid, kernels, 0.0)]
        finer = (2 * grid[0] - 1, 2 * grid[1] - 1)
        too_many = _too_many(grid, sampler.size, sampler.wavelengths)
        if too_many and count and grid[0] % 2 and grid[1] % 2:
            return [Level(grid, kernels, _FAIR * _mixing_error(kernels[::2, ::2], kernels))]
        if too_many:
            raise ValueError(
                f"an error of {last_goal:.2g} of full scale requires more than {grid[0]} x {grid[1]} kernels of "
                f"{sampler.size} x {sampler.size} samples: with so many, interpolation between them has an error of "
                f"{before * _FAIR:.2g}; allow a larger error, or take a smaller window"
            )
        fine = _between_nodes(sampler, y, x, kernels, grid)
        error = _mixing_error(kernels, fine)
        if count:
            return [Level(grid, kernels, error)]
        falls_to = error * (_FAIR if not np.isfinite(before) else max(_FAIR, min(1.0, error / before)))
        if not good and error <= goal:
            good = [Level(grid, kernels, error)]
        if falls_to <= last_goal:
            return [*good, Level(finer, fine, falls_to)]
        if not all(f <= n for f, n in zip(finer, (y.size, x.size), strict=True)):  # put a node at every sample
            grid = (y.size, x.size)
            kernels = _kernels(sampler, y, x, grid)
            continue
        grid, kernels, before = finer, fine, error


def _between_nodes(
    sampler: Sampler, y: FloatArray, x: FloatArray, kernels: FloatArray, grid: tuple[int, int]
) -> FloatArray:
    """Return the kernels of the grid with half the spacing; known kernels are copied."""
    finer = (2 * grid[0] - 1, 2 * grid[1] - 1)
    out = np.empty((*finer, *kernels.shape[2:]))
    out[::2, ::2] = kernels
    yy, xx = np.meshgrid(_positions(y, finer[0]), _positions(x, finer[1]), indexing="ij")
    new = np.ones(finer, dtype=bool)
    new[::2, ::2] = False
    out[new] = sampler.kernels(yy[new], xx[new])
    return out


def _mixing_error(kernels: FloatArray, fine: FloatArray) -> float:
    """Return half the sum of |kernel - interpolation of its neighbours| at the worst node of the finer grid."""
    worst = 0.0
    for i in range(fine.shape[0]):
        row: FloatArray = kernels[i // 2] if i % 2 == 0 else 0.5 * (kernels[i // 2] + kernels[i // 2 + 1])
        mixed = np.empty_like(fine[i])
        mixed[::2] = row
        mixed[1::2] = 0.5 * (row[:-1] + row[1:])
        worst = max(worst, float(np.abs(fine[i] - mixed).sum(axis=(-2, -1)).max()))
    return 0.5 * worst
