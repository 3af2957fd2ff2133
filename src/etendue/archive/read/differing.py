"""Measure how far two arrays of the same cell differ.

In:  two arrays, or bands of them.
Out: ``Difference``: whether the bits agree; if not, the largest and the rms difference and the full scale.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from etendue.types.arrays import Array

PIECE = 1 << 18  # values compared at a time, which bounds the temporary memory


@dataclass(frozen=True)
class Difference:
    """The difference between two arrays of one variable of one cell.

    Attributes
    ----------
    same : whether shape, type and every bit agree
    shapes : '' where shape and type agree, else both
    values : how many values were compared
    differing : how many of them differ
    undefined : how many are NaN or infinite in one of the arrays alone, or differently
    largest : largest absolute difference of the defined values
    rms : root mean square difference of the defined values
    scale : full scale: the largest absolute value of the first array
    """

    same: bool
    shapes: str = ""
    values: int = 0
    differing: int = 0
    undefined: int = 0
    largest: float = 0.0
    rms: float = 0.0
    scale: float = 0.0

    @property
    def relative(self) -> float | None:
        """The rms difference relative to full scale; None if it is undefined."""
        if self.shapes or self.undefined or not math.isfinite(self.rms):
            return None
        if not self.scale:
            return 0.0 if not self.rms else None
        return self.rms / self.scale


def between(first: Array, second: Array) -> Difference:
    """Return the difference of two arrays; the first defines full scale."""
    if first.shape != second.shape or first.dtype != second.dtype:
        return Difference(False, f"{first.dtype}{list(first.shape)} and {second.dtype}{list(second.shape)}")
    one, other = np.ascontiguousarray(first).reshape(-1), np.ascontiguousarray(second).reshape(-1)
    return together(_piece(one[n : n + PIECE], other[n : n + PIECE]) for n in range(0, max(one.size, 1), PIECE))


def _piece(one: Array, other: Array) -> Difference:
    if one.tobytes() == other.tobytes():
        return Difference(True, values=one.size, scale=_scale(one))
    a, b = one.astype(np.float64), other.astype(np.float64)
    defined = np.isfinite(a) & np.isfinite(b)
    alike = defined | (a == b) | (np.isnan(a) & np.isnan(b))
    off = np.abs(a[defined] - b[defined])
    changed = one.view(f"V{one.itemsize}") != other.view(f"V{one.itemsize}")
    square = float(np.mean(np.square(off))) if off.size else 0.0
    return Difference(
        False,
        "",
        one.size,
        int(changed.sum()),
        int(one.size - alike.sum()),
        float(off.max(initial=0.0)),
        math.sqrt(square),
        _scale(one),
    )


def _scale(values: Array) -> float:
    """Return the largest finite absolute value."""
    if not values.size:
        return 0.0
    low, high = float(values.min()), float(values.max())
    if math.isfinite(low) and math.isfinite(high):
        return max(abs(low), abs(high))
    finite = values[np.isfinite(values)]
    return float(np.abs(finite.astype(np.float64)).max(initial=0.0))


def together(parts: Iterable[Difference]) -> Difference:
    """Combine the differences of the parts of one array."""
    whole = Difference(True)
    for part in parts:
        count = whole.values + part.values
        square = (whole.values * whole.rms**2 + part.values * part.rms**2) / count if count else 0.0
        whole = Difference(
            whole.same and part.same,
            whole.shapes or part.shapes,
            count,
            whole.differing + part.differing,
            whole.undefined + part.undefined,
            max(whole.largest, part.largest),
            math.sqrt(square),
            max(whole.scale, part.scale),
        )
    return whole
