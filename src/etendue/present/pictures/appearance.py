"""Appearance of a variable: the one conversion from its arrays to what is seen, for the contact sheet, plots, the page
and exported pictures.

In:  an array over y and x, perhaps with bands or channels first; how it is drawn (``contract.drawn.Drawn``).
Out: (3, y, x) linear sRGB, encoded values or grey, at full size or reduced; the value shown as white; bytes.

Leading dims are converted to colours by functions that distributions register (``contract.arrays.colouring``), and so
are patterns of filters. Undefined values are striped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from etendue.contract.arrays import colouring as kinds
from etendue.contract.arrays.drawn import Drawn, Pictured, lit_by
from etendue.present.pictures.fitting import LARGEST, coloured, fitted, tinted
from etendue.types.arrays import Array

BRIGHT, SHARE = 0.995, 0.9  # this quantile of the brightest channel is shown at this share of white
HATCH = (225, 120, 112), (250, 232, 230)  # stripes where there is no value
STRIPE = 4  # samples


@dataclass(frozen=True)
class Appearance:
    """How the arrays of one variable are converted to colours. It is sent to the process that computes the arrays.

    ``matrix``: (3, planes) matrix from the leading dim to linear sRGB; None: the first three planes are the colours, or
    a single plane is grey. ``tints``: (rows, columns, 3) colours of one period of a pattern, from its first sample.
    ``grey``: whether numbers are shown as a map.
    """

    drawn: Drawn
    matrix: Any = None
    tints: Any = None
    grey: bool = False

    def rgb(self, array: Array, first: tuple[int, int] = (0, 0)) -> Array:
        """Return the colours (3, y, x) of a whole array, or of a window that starts at row and column ``first``, as
        float32; linear values are not scaled.
        """
        array = np.asarray(array)
        if self.tints is not None:
            return coloured(self.values(array), self.tints, first)
        return self.mixed(self.share(array, self.ends(array)) if self.grey else self.values(array))

    def small(self, array: Array) -> Array:
        """Return the colours of the whole array, averaged over areas to at most 256 samples per side."""
        array = np.asarray(array)
        if self.tints is not None:
            return tinted(array, self.tints, self.values)
        ends = self.ends(array) if self.grey else None
        return self.mixed(fitted(array, self.values if ends is None else lambda rows: self.share(rows, ends)))

    def values(self, rows: Array) -> Array:
        """Return the numbers minus the black level, at least 0, as float32."""
        rows = rows.astype(np.float32, copy=False)
        return np.maximum(rows - np.float32(self.drawn.black), 0) if self.drawn.black else rows

    def mixed(self, planes: Iterable[Any]) -> Array:
        """Mix planes of any size to colours, (3, y, x). Planes are summed in order, so they may arrive one by one."""
        if self.matrix is None:
            planes = planes if isinstance(planes, np.ndarray) else np.stack(list(planes))
            planes = planes[None] if planes.ndim == 2 else planes
            return planes[:3] if len(planes) >= 3 else np.repeat(planes[:1], 3, axis=0)
        mixed: Array = np.zeros(0)
        for number, (plane, weights) in enumerate(zip(planes, self.matrix.T.astype(np.float32), strict=True)):
            mixed = mixed if number else np.zeros((3, *plane.shape), np.float32)
            for own, weight in zip(mixed, weights, strict=True):
                own += weight * plane
        return mixed

    def ends(self, plane: Array) -> tuple[float, float]:
        """Return the numbers that a map shows as black and as white; their logarithms if the map is logarithmic."""
        if self.drawn.range is not None:
            low, high = np.log(self.drawn.range) if self.drawn.log else self.drawn.range
            return float(low), float(high)
        low, high = np.inf, -np.inf
        for first in range(0, plane.shape[0], LARGEST):
            found = self._measured(plane[first : first + LARGEST])
            found = found[np.isfinite(found)]
            low, high = min(low, found.min(initial=np.inf)), max(high, found.max(initial=-np.inf))
        return float(low), float(high)

    def share(self, rows: Array, ends: tuple[float, float]) -> Array:
        """Return the position of each number between the ends, from 0 to 1."""
        found, (low, high) = self._measured(rows), ends
        with np.errstate(invalid="ignore"):
            share = (found - low) / (high - low) if high > low else np.where(np.isnan(found), np.nan, 0.5)
        return np.clip(share, 0, 1).astype(np.float32)

    def _measured(self, rows: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.log(rows, dtype=np.float64) if self.drawn.log else rows.astype(np.float64)


def appearance(
    drawn: Drawn, dims: Sequence[str], edges: Any = None, channels: Sequence[Any] = (), first: tuple[int, int] = (0, 0)
) -> Appearance | None:
    """Return the appearance of arrays with these dims; None if they are not a picture.

    Parameters
    ----------
    dims : y and x, preceded by at most one other
    edges : (bands + 1) array, nm
        Edges of the bands of light.
    channels : names of planes
    first : row and column of the pattern at which an array starts
    """
    front, plane = tuple(dims[:-2]), tuple(dims[-2:])
    if plane != ("y", "x") or len(front) > 1 or not set(front) <= set(kinds.flat_dims()):
        return None
    if drawn.sent:
        return Appearance(drawn)
    if front:  # numbers as grey; red, green and blue planes as colours
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


def brightness(drawn: Drawn, small: Array | None) -> float:
    """Return the linear value shown as white in a picture that is shown alone, from its reduced version ``small``.

    If the brightness is adapted for viewing, the result is at least a thousandth of the brightest value: next to a
    point source, all other values may be close to zero.
    """
    if not drawn.scaled or small is None:
        return drawn.white or 1.0
    peaks = small.max(axis=0)
    peaks = peaks[np.isfinite(peaks)]
    bright = max(float(np.quantile(peaks, BRIGHT)), 1e-3 * float(peaks.max())) / SHARE if peaks.size else 0.0
    return bright if bright > 0 else 1.0


def white_among(order: Sequence[Pictured], number: int, bright_of: Callable[[int], float | None]) -> float:
    """Return the linear value shown as white in picture ``number`` of a cell, whose pictures ``order`` lists in the
    order of the light; ``bright_of`` returns this value for a picture shown alone, or None.
    """
    there = list(range(len(order)))
    while order[number].drawn.scaled:
        other = there[lit_by([order[n] for n in there], there.index(number))]
        if (found := bright_of(other)) is not None or other == number:
            return found or 1.0
        there.remove(other)
    return order[number].drawn.white or 1.0


def rendered(drawn: Drawn, light: Array, white: float) -> Array:
    """Return a variable as a (y, x, 3) uint8 picture, the same for contact sheets, plots, pages and files.

    ``light`` is the result of `Appearance`, for the whole frame, some rows or a reduced frame; ``white`` is the value
    shown as white.
    """
    picture: Array = np.rint(255 * seen(drawn, light, white)).astype(np.uint8)
    return np.ascontiguousarray(np.moveaxis(picture, 0, -1))


def seen(drawn: Drawn, found: Array, bright: float) -> Array:
    """Return display values (3, y, x) from 0 to 1 for the result of `Appearance`; if the result is linear, ``bright``
    is shown as white.
    """
    lost = np.isnan(found).any(axis=0)
    found = np.nan_to_num(found, nan=0.0, posinf=np.inf, neginf=-np.inf) if lost.any() else found
    found = encoded(np.clip(found / np.float32(bright), 0, 1)) if drawn.linear else np.clip(found, 0, 1)
    return np.where(lost, striped(lost.shape), found) if lost.any() else found


def striped(shape: tuple[int, ...]) -> Array:
    """Return (3, y, x) float32 stripes that mark missing values."""
    rows, columns = np.indices(shape)
    stripes = np.where(
        (((rows + columns) // STRIPE) % 2 == 0)[..., None], *(np.array(colour, np.float32) / 255 for colour in HATCH)
    )
    return np.moveaxis(stripes, -1, 0)


def encoded(linear: Array) -> Any:
    """Apply the sRGB curve, IEC 61966-2-1, to linear values in 0 to 1; the dtype is kept."""
    linear = np.asarray(linear)
    curve = np.maximum(linear, linear.dtype.type(0.0031308)) ** linear.dtype.type(1 / 2.4)
    return np.where(
        linear <= linear.dtype.type(0.0031308),
        linear * linear.dtype.type(12.92),
        linear.dtype.type(1.055) * curve - linear.dtype.type(0.055),
    )
