"""Sums and extremes over a pixel's neighbours, on arrays reduced to pixels with a full neighbourhood.

In:  arrays (y, x), any unit.
Out: sums over windows, in the same unit.

An operation that looks k samples around returns an array that is shorter by k at each end, so all arrays made from one
have the same centre, and `meet` cuts them to what they share. Windows are summed by pairs of opposite neighbours:
mirrored arrays have mirrored sums, bit for bit. No running sums: what a sample does ends where the window ends, NaN
included.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Sum = Callable[[NDArray, int, int], NDArray]


def moved(values: NDArray, axis: int, by: int, reach: int) -> NDArray:
    """View of what stands `by` samples further, for all samples that are `reach` or more from both ends."""
    start, stop = reach + by, values.shape[axis] - reach + by
    return values[start:stop] if axis == 0 else values[:, start:stop]


def pair(values: NDArray, axis: int, step: int = 1) -> NDArray:
    """The sum of the neighbours `step` before and after."""
    return moved(values, axis, -step, step) + moved(values, axis, step, step)


def slope(values: NDArray, axis: int) -> NDArray:
    """The next sample minus the one before: twice the derivative."""
    return moved(values, axis, 1, 1) - moved(values, axis, -1, 1)


def three(values: NDArray, axis: int, step: int = 1) -> NDArray:
    """The sum of 3 samples, `step` apart."""
    total = pair(values, axis, step)
    total += moved(values, axis, 0, step)
    return total


def five(values: NDArray, axis: int, step: int = 1) -> NDArray:
    """The sum of 5 samples, `step` apart."""
    total = pair(values, axis, 2 * step)
    total += moved(pair(values, axis, step), axis, 0, step)
    total += moved(values, axis, 0, 2 * step)
    return total


def nine(values: NDArray, axis: int, step: int = 1) -> NDArray:
    """The sum of 9 samples, `step` apart."""
    return three(three(values, axis, step), axis, 3 * step)


def extreme(values: NDArray, choose: np.ufunc) -> NDArray:
    """The least of a pixel and its 8 neighbours by `np.minimum`, the greatest by `np.maximum`."""
    for axis in (0, 1):
        beside = choose(moved(values, axis, -1, 1), moved(values, axis, 1, 1))
        values = choose(beside, moved(values, axis, 0, 1), out=beside)
    return values


def square(values: NDArray, window: Sum) -> NDArray:
    """The sum over a square window."""
    return window(window(values, 0, 1), 1, 1)


def meet(*arrays: NDArray) -> tuple[NDArray, ...]:
    """Views of what arrays of one centre have in common."""
    rows, columns = (min(a.shape[axis] for a in arrays) for axis in (0, 1))
    return tuple(centre(a, rows, columns) for a in arrays)


def centre(values: NDArray, rows: int, columns: int) -> NDArray:
    """View of the innermost rows and columns, of a number that leaves equally many at both ends."""
    top, left = (values.shape[0] - rows) // 2, (values.shape[1] - columns) // 2
    return values[top : top + rows, left : left + columns]


def within(reach: int, shape: tuple[int, ...], *arrays: NDArray) -> tuple[NDArray, ...]:
    """Views of what arrays of one centre have inside a frame of that shape, `reach` from its edges."""
    rows, columns = shape
    return tuple(centre(a, rows - 2 * reach, columns - 2 * reach) for a in arrays)


def scaled(values: NDArray, factor: float) -> NDArray:
    """The array itself, multiplied in place by a number rounded to its own type."""
    values *= values.dtype.type(factor)
    return np.asarray(values)
