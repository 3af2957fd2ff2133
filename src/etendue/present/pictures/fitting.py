"""Reduction of pictures: exact area averages, also of rows as they arrive.

In:  (..., y, x) arrays of any size; a function applied to each value first.
Out: (..., y', x') float32, at most 256 samples on either side.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from etendue.transfer.resampling import area_weights
from etendue.types.arrays import Array

LARGEST = 256  # samples on either side
Decode = Callable[[Array], Array]


def as_float(rows: Array) -> Array:
    return rows.astype(np.float32, copy=False)


def fitted(picture: Array, decode: Decode = as_float) -> Array:
    """Average over areas until the picture fits; smaller pictures are unchanged.

    Parameters
    ----------
    picture : (..., y, x) array
    decode : callable
        Converts values to float32, elementwise; called for some rows at a time, so that nothing of the size of the
        picture is allocated.

    Returns
    -------
    (..., y', x') float32, at most 256 on either side
    """
    y, x = picture.shape[-2:]
    if max(y, x) <= LARGEST:
        return decode(picture)
    gathered = Fitted(picture.shape, decode)
    gathered.take(0, picture)
    return gathered.made()


def tinted(plane: Array, tints: Array, decode: Decode) -> Array:
    """Do the same as `fitted` for a plane with a pattern, as (3, y', x'): each sample contributes to the colours of its
    filter.
    """
    if max(plane.shape) <= LARGEST:
        return coloured(decode(plane), tints)
    gathered = Tinted(plane.shape, tints, decode)
    gathered.take(0, plane)
    return gathered.made()


def coloured(plane: Array, tints: Array, first: tuple[int, int] = (0, 0)) -> Array:
    """Return a plane as (3, y, x), each sample in the colour of its filter; ``first`` is the row and column of the
    whole frame at which the plane starts.
    """
    (y, x), (height, width) = plane.shape, tints.shape[:2]
    tiled = tints[np.ix_((first[0] + np.arange(y)) % height, (first[1] + np.arange(x)) % width)]
    return np.moveaxis(tiled, -1, 0) * plane


class Rows(ABC):
    """Averages rows of a large picture as they arrive: each output row is computed as soon as its input rows have
    arrived.
    """

    def __init__(self, shape: tuple[int, ...], decode: Decode) -> None:
        y, x = shape[-2:]
        self.down, self.across = _down(y, _fitting(y, max(y, x))), _down(x, _fitting(x, max(y, x)))
        self.decode, self.next = decode, 0
        self.start, self.left = 0, np.empty((*shape[:-2], 0, x), np.float32)  # rows needed again

    def take(self, start: int, rows: Array) -> None:
        """Take the rows from ``start`` on, which follow the rows taken so far."""
        if self.left.size:
            start, rows = self.start, np.concatenate((self.left, rows), axis=-2)
        while self.next < len(self.down):
            first, weights = self.down[self.next]
            if first + weights.size > start + rows.shape[-2]:
                break
            self.put(self.next, first, weights, self.decode(rows[..., first - start : first - start + weights.size, :]))
            self.next += 1
        self.start = self.down[self.next][0] if self.next < len(self.down) else start + rows.shape[-2]
        self.left = rows[..., self.start - start :, :].copy()

    @abstractmethod
    def put(self, row: int, first: int, weights: Array, light: Array) -> None: ...

    @abstractmethod
    def made(self) -> Array: ...


class Fitted(Rows):
    def __init__(self, shape: tuple[int, ...], decode: Decode) -> None:
        super().__init__(shape, decode)
        self.rows = np.empty((*shape[:-2], len(self.down), shape[-1]), np.float32)

    def put(self, row: int, first: int, weights: Array, light: Array) -> None:
        self.rows[..., row, :] = weights @ light

    def made(self) -> Array:
        return _across(self.rows, self.across)


class Tinted(Rows):
    """`Rows` in which each sample contributes to the colours of its filter."""

    def __init__(self, shape: tuple[int, ...], tints: Array, decode: Decode) -> None:
        super().__init__(shape, decode)
        self.tints = tints
        self.rows = np.zeros((len(tints), len(self.down), shape[-1]), np.float32)  # by the row of the pattern's period

    def put(self, row: int, first: int, weights: Array, light: Array) -> None:
        height = len(self.tints)
        for phase in range(height):
            own = slice((phase - first) % height, None, height)
            self.rows[phase, row] = weights[own] @ light[own]

    def made(self) -> Array:
        height, width = self.tints.shape[:2]
        coloured = np.zeros((3, *self.rows.shape[1:]), np.float32)
        for phase in range(height):
            for place in range(width):
                for colour in np.flatnonzero(self.tints[phase, place]):
                    coloured[colour, :, place::width] += (
                        self.tints[phase, place, colour] * self.rows[phase, :, place::width]
                    )
        return _across(coloured, self.across)


def _fitting(size: int, largest: int) -> int:
    """Return the number of samples on one side of a picture that fits."""
    return max(1, round(size * LARGEST / largest))


@lru_cache(maxsize=16)
def _down(before: int, after: int) -> tuple[tuple[int, Array], ...]:
    """Return, for each output sample, the first input sample that it averages, and the weights of this and the
    following samples.
    """
    whole = area_weights(before, after).astype(np.float32)
    spans = [(row * before // after, -(-(row + 1) * before // after)) for row in range(after)]
    return tuple((first, whole[row, first:last].copy()) for row, (first, last) in enumerate(spans))


def _across(rows: Array, down: tuple[tuple[int, Array], ...]) -> Array:
    """Average along x with the weights from `_down`: (..., y', x) to (..., y', x')."""
    turned = np.ascontiguousarray(np.swapaxes(rows, -1, -2))
    found = np.empty((*turned.shape[:-2], len(down), turned.shape[-1]), np.float32)
    for row, (first, weights) in enumerate(down):
        found[..., row, :] = weights @ turned[..., first : first + weights.size, :]
    return np.swapaxes(found, -1, -2)
