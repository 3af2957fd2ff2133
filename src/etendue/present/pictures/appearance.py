"""How a variable looks: the one way from its arrays to what is seen, for the contact sheet, plots, the page and
exported pictures.

In:  an array over y and x, perhaps bands or channels in front; what is said of how it is drawn (``spec.drawn.Drawn``).
Out: (3, y, x) linear sRGB, encoded values or grey, at full size or made small; the value that is shown as white; bytes.

What stands in front of y and x becomes colours by functions that distributions bring (``contract.seen``), and so do
patterns of filters. What is undefined is striped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.contract import seen as kinds
from etendue.contract.drawn import Drawn, Pictured, lit_by
from etendue.present.pictures.fitting import LARGEST, coloured, fitted, tinted
from etendue.types.arrays import Array

BRIGHT, SHARE = 0.995, 0.9  # this quantile of the brightest channel is shown at this share of white
HATCH = (225, 120, 112), (250, 232, 230)  # stripes where there is nothing to be seen
STRIPE = 4  # samples


@dataclass(frozen=True)
class Appearance:
    """How the arrays of one variable are seen. It travels to where they are computed.

    ``matrix``: (3, planes) from what stands in front of y and x to linear sRGB; None: the first three planes, or one as
    grey. ``tints``: (rows, columns, 3) of one period of a pattern from its first pixel. ``grey``: whether numbers are
    shown as a map.
    """

    drawn: Drawn
    matrix: Any = None
    tints: Any = None
    grey: bool = False

    def rgb(self, array: Array, row: int = 0) -> Array:
        """(3, y, x) float32, not yet scaled where it is linear, of all rows or of some from ``row`` on."""
        array = np.asarray(array)
        if self.tints is not None:
            return coloured(self.values(array), self.tints, row)
        return self.mixed(self.share(array, self.ends(array)) if self.grey else self.values(array))

    def small(self, array: Array) -> Array:
        """The same, averaged over areas until it fits."""
        array = np.asarray(array)
        if self.tints is not None:
            return tinted(array, self.tints, self.values)
        ends = self.ends(array) if self.grey else None
        return self.mixed(fitted(array, self.values if ends is None else lambda rows: self.share(rows, ends)))

    def values(self, rows: Array) -> Array:
        """Numbers above black."""
        rows = rows.astype(np.float32, copy=False)
        return np.maximum(rows - np.float32(self.drawn.black), 0) if self.drawn.black else rows

    def mixed(self, planes: Array) -> Array:
        """Planes in their colours, at any size."""
        if self.matrix is None:
            planes = planes[None] if planes.ndim == 2 else planes
            return planes[:3] if len(planes) >= 3 else np.repeat(planes[:1], 3, axis=0)
        return np.tensordot(self.matrix.astype(planes.dtype), planes, axes=1)

    def ends(self, plane: Array) -> tuple[float, float]:
        """The numbers of a map that are black and white, or their logarithms."""
        if self.drawn.range is not None:
            low, high = np.log(self.drawn.range) if self.drawn.log else self.drawn.range
            return float(low), float(high)
        low, high = np.inf, -np.inf
        for first in range(0, plane.shape[0], LARGEST):
            found = self._measured(plane[first : first + LARGEST])
            found = found[np.isfinite(found)]
            low, high = min(low, found.min(initial=np.inf)), max(high, found.max(initial=-np.inf))
        return float(low), float(high)

    def share(self, rows: Array, ends: tuple[float, float]) -> Any:
        """How far numbers lie between both ends."""
        found, (low, high) = self._measured(rows), ends
        with np.errstate(invalid="ignore"):
            share = (found - low) / (high - low) if high > low else np.where(np.isnan(found), np.nan, 0.5)
        return np.clip(share, 0, 1).astype(np.float32)

    def _measured(self, rows: Array) -> Any:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(rows, dtype=np.float64) if self.drawn.log else rows.astype(np.float64)


def appearance(
    drawn: Drawn, dims: Sequence[str], edges: Any = None, channels: Sequence[Any] = (), first: tuple[int, int] = (0, 0)
) -> Appearance | None:
    """How arrays with these dims are seen; None where they are no picture.

    Parameters
    ----------
    dims : y and x, and at most one in front
    edges : (bands + 1) array, nm
        Of light.
    channels : names of planes
    first : row and column of the pattern with which an array begins
    """
    front, plane = tuple(dims[:-2]), tuple(dims[-2:])
    if plane != ("y", "x") or len(front) > 1 or not set(front) <= set(kinds.flat_dims()):
        return None
    if drawn.sent:
        return Appearance(drawn)
    if front:  # numbers as grey; those of red, green and blue side by side as colours
        matrix = kinds.function(front[0])
        return Appearance(
            drawn,
            None if matrix is None else matrix(drawn, edges, [str(name) for name in channels]),
            grey=not drawn.linear,
        )
    if not drawn.linear or not drawn.pattern:
        return Appearance(drawn, grey=not drawn.linear)
    pattern = kinds.pattern(drawn.pattern)
    period = [[pattern.tints[letter] for letter in row] for row in pattern.moved(*first)]
    return Appearance(drawn, tints=np.array(period, dtype=np.float32))


def brightness(small: Array) -> float:
    """The linear value that is shown as white where it is chosen for the eye: of a picture that has been made small.

    A thousandth of the brightest at least: beside a point all else may be next to nothing.
    """
    peaks = small.max(axis=0)
    peaks = peaks[np.isfinite(peaks)]
    bright = max(float(np.quantile(peaks, BRIGHT)), 1e-3 * float(peaks.max())) / SHARE if peaks.size else 0.0
    return bright if bright > 0 else 1.0


def whites_of(pictures: Sequence[tuple[Pictured, Array]]) -> list[float]:
    """The value shown as white in each of a cell's pictures, made small, in the order of the light."""
    order, found = [one for one, _ in pictures], dict[int, float]()
    for number, (one, _) in enumerate(pictures):
        if one.drawn.scaled and (other := lit_by(order, number)) not in found:
            found[other] = brightness(pictures[other][1])
    return [found[lit_by(order, n)] if one.drawn.scaled else one.drawn.white or 1.0 for n, one in enumerate(order)]


def seen(drawn: Drawn, found: Array, bright: float) -> Array:
    """(3, y, x) in 0 to 1 as a display has it, of what `Appearance` gives; ``bright`` is shown as white where that
    is linear.
    """
    lost = np.isnan(found).any(axis=0)
    found = np.nan_to_num(found, nan=0.0, posinf=np.inf, neginf=-np.inf) if lost.any() else found
    found = encoded(np.clip(found / np.float32(bright), 0, 1)) if drawn.linear else np.clip(found, 0, 1)
    return np.where(lost, striped(lost.shape), found) if lost.any() else found


def striped(shape: tuple[int, ...]) -> Any:
    """(3, y, x) float32 of what is not there."""
    rows, columns = np.indices(shape)
    stripes = np.where(
        (((rows + columns) // STRIPE) % 2 == 0)[..., None], *(np.array(colour, np.float32) / 255 for colour in HATCH)
    )
    return np.moveaxis(stripes, -1, 0)


def as_bytes(seen: Array) -> Any:
    """(3, y, x) uint8."""
    return np.rint(255 * seen).astype(np.uint8)


def encoded(linear: Array) -> Any:
    """The curve of a screen: (...) of linear values in 0 to 1, IEC 61966-2-1, in the dtype of what is given."""
    linear = np.asarray(linear)
    curve = np.maximum(linear, linear.dtype.type(0.0031308)) ** linear.dtype.type(1 / 2.4)
    return np.where(
        linear <= linear.dtype.type(0.0031308),
        linear * linear.dtype.type(12.92),
        linear.dtype.type(1.055) * curve - linear.dtype.type(0.055),
    )
