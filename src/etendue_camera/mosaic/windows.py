"""Sums and extremes over a pixel's neighbours, on arrays reduced to pixels with a full neighbourhood.

In:  arrays (y, x), any unit.
Out: sums over windows, in the same unit.

An operation that uses k samples on each side returns an array that is shorter by k at each end. All arrays derived from
the same array therefore have the same centre, and `meet` crops them to their common part. Windows are summed by pairs
of opposite neighbours, so that mirrored arrays have mirrored sums, bit for bit. Running sums are not used: the effect
of a sample, even NaN, ends with its window.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Sum = Callable[[NDArray, int, int], NDArray]


def moved(values: NDArray, axis: int, by: int, reach: int) -> NDArray:
    """Return a view of the samples that lie `by` positions after each position, for all positions that are at least
    `reach` away from both ends.
    """
    start, stop = reach + by, values.shape[axis] - reach + by
    return values[start:stop] if axis == 0 else values[:, start:stop]


def pair(values: NDArray, axis: int, step: int = 1) -> NDArray:
    """Return, for every sample, the sum of the samples `step` positions before and after it."""
    return moved(values, axis, -step, step) + moved(values, axis, step, step)


def slope(values: NDArray, axis: int) -> NDArray:
    """Return the next sample minus the previous sample: twice the derivative."""
    return moved(values, axis, 1, 1) - moved(values, axis, -1, 1)


def three(values: NDArray, axis: int, step: int = 1) -> NDArray:
    """Return the sum of 3 samples, `step` apart."""
    total = pair(values, axis, step)
    total += moved(values, axis, 0, step)
    return total


def five(values: NDArray, axis: int, step: int = 1) -> NDArray:
    """Return the sum of 5 samples, `step` apart."""
    total = pair(values, axis, 2 * step)
    total += moved(pair(values, axis, step), axis, 0, step)
    total += moved(values, axis, 0, 2 * step)
    return total


def nine(values: NDArray, axis: int, step: int = 1) -> NDArray:
    """Return the sum of 9 samples, `step` apart."""
    return three(three(values, axis, step), axis, 3 * step)


def extreme(values: NDArray, choose: np.ufunc) -> NDArray:
    """Return the minimum (`np.minimum`) or maximum (`np.maximum`) of each pixel and its 8 neighbours."""
    for axis in (0, 1):
        beside = choose(moved(values, axis, -1, 1), moved(values, axis, 1, 1))
        values = choose(beside, moved(values, axis, 0, 1), out=beside)
    return values


def square(values: NDArray, window: Sum) -> NDArray:
    """Return the sum over a square window."""
    return window(window(values, 0, 1), 1, 1)


def meet(*arrays: NDArray) -> tuple[NDArray, ...]:
    """Return views of the common part of arrays with the same centre."""
    rows, columns = (min(a.shape[axis] for a in arrays) for axis in (0, 1))
    return tuple(centre(a, rows, columns) for a in arrays)


def centre(values: NDArray, rows: int, columns: int) -> NDArray:
    """Return a view of the innermost rows and columns; equally many must be left at both ends."""
    top, left = (values.shape[0] - rows) // 2, (values.shape[1] - columns) // 2
    return values[top : top + rows, left : left + columns]


def within(reach: int, shape: tuple[int, ...], *arrays: NDArray) -> tuple[NDArray, ...]:
    """Return views of the part of same-centred arrays that lies `reach` or more inside a frame of this shape."""
    rows, columns = shape
    return tuple(centre(a, rows - 2 * reach, columns - 2 * reach) for a in arrays)


def scaled(values: NDArray, factor: float) -> NDArray:
    """Multiply the array in place by a factor rounded to its dtype, and return it."""
    values *= values.dtype.type(factor)
    return np.asarray(values)
