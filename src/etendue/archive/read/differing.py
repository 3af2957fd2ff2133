"""Measure the difference between two arrays of one variable.

In:  two arrays, or parts of them.
Out: ``Difference``: whether the bits agree; if not, the largest and the rms difference and the full scale.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from etendue.types.arrays import Array, FloatArray

PIECE = 1 << 18  # values compared at a time, which bounds the temporary memory


@dataclass(frozen=True)
class Difference:
    """The difference between two arrays of one variable of one cell.

    Attributes
    ----------
    same : whether shape, type and every bit agree
    why : reason why the arrays cannot be compared (different shapes or types, or a missing array); '' if they can
    values : number of compared values
    differing : number of values that differ
    undefined : number of values that are NaN or infinite in at least one of the arrays, and not the same in both
    defined : number of values that are finite in both arrays
    largest : largest absolute difference of the defined values
    rms : root mean square difference of the defined values
    scale : full scale: the largest absolute value of the first array, unless it is given
    """

    same: bool
    why: str = ""
    values: int = 0
    differing: int = 0
    undefined: int = 0
    defined: int = 0
    largest: float = 0.0
    rms: float = 0.0
    scale: float = 0.0

    @property
    def relative(self) -> float | None:
        """The rms difference relative to full scale; None if it is undefined."""
        return self._share(self.rms)

    @property
    def largest_relative(self) -> float | None:
        """The largest difference relative to full scale; None if it is undefined."""
        return self._share(self.largest)

    def _share(self, size: float) -> float | None:
        if self.why or self.undefined or not math.isfinite(size):
            return None
        if not self.scale:
            return 0.0 if not size else None
        return size / self.scale


def between(first: Array, second: Array, scale: float | None = None) -> Difference:
    """Return the difference of two arrays; the first defines full scale, unless it is given."""
    if first.shape != second.shape or first.dtype != second.dtype:
        return Difference(False, f"{first.dtype}{list(first.shape)} and {second.dtype}{list(second.shape)}")
    one, other = np.ascontiguousarray(first).reshape(-1), np.ascontiguousarray(second).reshape(-1)
    return together(_piece(one[n : n + PIECE], other[n : n + PIECE], scale) for n in range(0, max(one.size, 1), PIECE))


def _piece(one: Array, other: Array, scale: float | None) -> Difference:
    known, scale = np.isfinite(one) & np.isfinite(other), full_scale(one) if scale is None else scale
    if one.tobytes() == other.tobytes():
        return Difference(True, values=one.size, defined=int(known.sum()), scale=scale)
    off = apart(one, other)
    largest = float(off[known].max(initial=0.0))
    return Difference(
        False,
        values=one.size,
        differing=int((one.view(f"V{one.itemsize}") != other.view(f"V{one.itemsize}")).sum()),
        undefined=int(np.count_nonzero(off[~known])),
        defined=int(known.sum()),
        largest=largest,
        rms=largest * math.sqrt(np.mean(np.square(off[known] / largest))) if 0 < largest < math.inf else largest,
        scale=scale,
    )


def apart(one: Array, other: Array) -> FloatArray:
    """Return the absolute difference of each pair of values: 0 if both are NaN or the same infinity, infinity in every
    other pair with NaN or infinity.
    """
    one, other = np.asarray(one, np.float64), np.asarray(other, np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.where((one == other) | (np.isnan(one) & np.isnan(other)), 0.0, np.abs(one - other))
    return np.where(np.isnan(off), np.inf, off)


def full_scale(values: Array) -> float:
    """Return the largest finite absolute value; 0 if there is none."""
    largest = max(-float(np.min(values, initial=0)), float(np.max(values, initial=0)))
    if math.isfinite(largest):
        return largest
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def together(parts: Iterable[Difference]) -> Difference:
    """Return the difference of a whole array from the differences of its parts."""
    whole = Difference(True)
    for part in parts:
        defined = whole.defined + part.defined
        shares = (math.sqrt(one.defined / defined) * one.rms if one.rms else 0.0 for one in (whole, part))
        whole = Difference(
            whole.same and part.same,
            whole.why or part.why,
            whole.values + part.values,
            whole.differing + part.differing,
            whole.undefined + part.undefined,
            defined,
            max(whole.largest, part.largest),
            math.hypot(*shares),
            max(whole.scale, part.scale),
        )
    return whole
