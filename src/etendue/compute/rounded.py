"""Round the pictures of a cell to their planned digits before its stage passes them on.

In:  a ``Job`` with steps, powers of two; the checked arrays of its cell, or some rows of them.
Out: the same arrays as multiples of their steps.

Rounding takes place once, before an array is read, stored or given to the caller, so that all of these have the same
bits. The transform inside a segment is not touched. Values that are already rounded do not change.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from etendue.compute.bands import BandArray
from etendue.compute.job import Job
from etendue.compute.ownership import frozen
from etendue.types.arrays import Array, CellArrays

BLOCK = 1 << 15  # values rounded at a time, so that they stay in the cache


@dataclass(eq=False)
class RoundedBands(BandArray):
    """The bands of a large variable, each rounded when it is computed."""

    bands: BandArray
    step: float

    def __post_init__(self) -> None:
        self.shape, self.dtype = self.bands.shape, self.bands.dtype

    def __getitem__(self, band: int) -> Array:
        return frozen(rounded(np.asarray(self.bands[band]), self.step))


def handed_on(job: Job, arrays: CellArrays) -> CellArrays:
    """Return the arrays of a cell with its pictures rounded."""
    for name, step in job.steps.items():
        if name in arrays:
            array = arrays[name]
            arrays[name] = RoundedBands(array, step) if isinstance(array, BandArray) else frozen(rounded(array, step))
    return arrays


def rounded(array: Array, step: float) -> Array:
    """Return the nearest multiples of a power of two, ties go to the even multiple; undefined and infinite values, and
    values without digits below the step, do not change. No value becomes -0.
    """
    array = np.ascontiguousarray(array)
    found = np.empty_like(array)
    given, flat = array.reshape(-1), found.reshape(-1)
    inverse, step, zero = (array.dtype.type(value) for value in (1 / step, step, 0))
    with np.errstate(over="ignore", invalid="ignore"):
        for start in range(0, given.size, BLOCK):
            own, block = given[start : start + BLOCK], flat[start : start + BLOCK]
            np.multiply(own, inverse, out=block)  # exact, unless it overflows
            np.rint(block, out=block)
            block *= step
            block += zero
            if not np.isfinite(block.dot(block)):
                np.copyto(block, own, where=~np.isfinite(block))
    return found
