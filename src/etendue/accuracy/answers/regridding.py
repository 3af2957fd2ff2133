"""Light on a finer or wider grid, brought to the grid it is compared on.

In:  an array with its grid, and the grid to compare on.
Out: the array there: bands as means over wider bands, cells as means, samples interpolated, a margin cut off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from etendue.contract.arrays.grid import Bands, Coordinate, Grid, Line

if TYPE_CHECKING:
    from etendue.types.arrays import Array

NEAR = 1e-6  # of a step: positions closer than this are equal
MIDPOINT = (-1 / 16, 9 / 16, 9 / 16, -1 / 16)  # cubic interpolation half way between samples: error of fourth order


def on_grid(array: Array, dims: tuple[str, ...], own: Grid, other: Grid) -> Array | None:
    """Return an array at the coordinates of another grid; None if that is not defined: the grid must be twice as fine
    along a line, have bands that divide those of the other, or be wider at the same step.
    """
    found: Array | None = np.asarray(array, np.float64)
    for axis, dim in enumerate(dims):
        if found is None or dim not in own or dim not in other:
            return None
        if own[dim] != other[dim]:
            weights = _weights(own[dim], other[dim])
            found = None if weights is None else np.moveaxis(np.tensordot(weights, found, (1, axis)), 0, axis)
    return found


def _weights(own: Coordinate, other: Coordinate) -> Array | None:
    """Return the matrix (other, own) that brings values from one coordinate to another."""
    if isinstance(own, Bands) and isinstance(other, Bands):
        low, high = np.array(own.edges[:-1]), np.array(own.edges[1:])
        shares = [np.clip(np.minimum(high, b) - np.maximum(low, a), 0, None) / (b - a) for a, b in _pairs(other)]
        weights = np.array(shares)
        return weights if np.allclose(weights.sum(axis=1), 1, atol=1e-9) else None
    if not (isinstance(own, Line) and isinstance(other, Line)) or own.units != other.units:
        return None
    weights, ratio = np.zeros((other.size, own.size)), other.step / own.step
    first = (other.start - own.start) / own.step  # position of the first value among those of the own line
    if abs(ratio - 1) < NEAR and abs(first - round(first)) < NEAR:
        numbers = round(first) + np.arange(other.size)
        spread: tuple[float, ...] = (1.0,)
    elif abs(ratio - 2) < NEAR and abs(first % 1 - 0.5) < NEAR:
        spread = (0.5, 0.5) if own.cells else MIDPOINT
        numbers = round(first - 0.5) - (len(spread) // 2 - 1) + 2 * np.arange(other.size)
    else:
        return None
    for place, share in enumerate(spread):
        np.add.at(weights, (np.arange(other.size), np.clip(numbers + place, 0, own.size - 1)), share)
    return weights


def _pairs(bands: Bands) -> list[tuple[float, float]]:
    return list(zip(bands.edges[:-1], bands.edges[1:], strict=True))
