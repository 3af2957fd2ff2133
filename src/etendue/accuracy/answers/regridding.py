"""Resample an array from a finer or wider grid to the grid of another array, to compare both.

In:  an array with its grid, and the grid to compare on.
Out: the array on that grid: bands and cells are averaged, samples interpolated, a margin is cut off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from etendue.contract.arrays.grid import Bands, Coordinate, Grid, Line

if TYPE_CHECKING:
    from etendue.types.arrays import Array

NEAR = 1e-6  # fraction of a step; positions closer than this count as equal


def on_grid(array: Array, dims: tuple[str, ...], own: Grid, other: Grid) -> Array | None:
    """Return an array at the coordinates of another grid: bands and cells as means, samples by cubic interpolation.

    Return None if units or labels differ, or if the other grid extends beyond this one.
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
    """Return the matrix (other, own) that converts values from one coordinate to another."""
    if isinstance(own, Bands) and isinstance(other, Bands):
        return _overlaps(np.array(own.edges), np.array(other.edges))
    if not (isinstance(own, Line) and isinstance(other, Line)) or own.units != other.units:
        return None
    if own.cells:
        return _overlaps(_edges(own), _edges(other))
    places = (np.array(other.values()) - own.start) / own.step  # positions among the samples of the own line
    first = np.floor(places + NEAR).astype(int)
    return _lagrange(first, places - first, own.size)


def _overlaps(own: Array, other: Array) -> Array | None:
    """Return the share of each interval of ``other`` that each interval of ``own`` covers; None if an interval of
    ``other`` is not covered.
    """
    low, high = np.maximum(own[:-1], other[:-1, None]), np.minimum(own[1:], other[1:, None])
    weights = np.clip(high - low, 0, None) / np.diff(other)[:, None]
    covered = weights.sum(axis=1, keepdims=True)
    return weights / covered if covered.min() > 0.5 else None


def _edges(line: Line) -> Array:
    return line.start + line.step * (np.arange(line.size + 1) - 0.5)


def _lagrange(first: Array, offset: Array, size: int) -> Array | None:
    """Return weights of cubic interpolation between four samples; at the ends the outermost samples are repeated."""
    if first.min() < -1 or first.max() > size:
        return None
    weights, t = np.zeros((first.size, size)), offset
    spread = (
        -t * (t - 1) * (t - 2) / 6,
        (t + 1) * (t - 1) * (t - 2) / 2,
        -(t + 1) * t * (t - 2) / 2,
        (t + 1) * t * (t - 1) / 6,
    )
    for place, share in enumerate(spread):
        np.add.at(weights, (np.arange(first.size), np.clip(first + place - 1, 0, size - 1)), share)
    return weights
