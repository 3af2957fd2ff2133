"""How a cell is split into chunks: whole, by band, in bands of rows, or both.

In:  dims, shape and bytes of a variable of one cell.
Out: the shape of its chunks, and the part of the cell that each covers; arrays split this way and rejoined.

A reader of a window of a large frame decodes only the row bands that overlap it, and a writer never holds the whole
frame encoded. All chunks of a Zarr array have the same shape: if the rows do not divide evenly, the last band extends
beyond the frame with fill values, as Zarr defines it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from math import ceil, prod
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.contract.arrays.dims import is_light
from etendue.plan import cost
from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    from etendue.types.arrays import Array

LARGEST_CHUNK = 64 << 20  # bytes; a larger cell is split into row bands
BANDS = 4  # this many row bands together hold about as much as the largest chunk, so one is 16 MB

Shape = tuple[int, ...]
Window = tuple[tuple[int, int], ...]  # (start, end) along each dim of a cell


def chunk_of(dims: Sequence[str], shape: Shape, itemsize: int) -> Shape:
    """Return the shape of the chunks of a cell; the cell's own shape if it is one chunk."""
    whole = tuple(max(n, 1) for n in shape)
    # it is computed by band; Blosc cannot compress 2 GiB or more
    if len(dims) == 3 and is_light(dims) and itemsize * prod(shape) > cost.LARGEST_WHOLE:
        whole = (1, *whole[1:])
    size = itemsize * prod(whole)
    if size <= LARGEST_CHUNK or tuple(dims)[-2:] != ("y", "x"):
        return whole
    rows = ceil(whole[-2] / ceil(size * BANDS / LARGEST_CHUNK))
    # Prefer a height that divides the rows evenly, down to half as high: no fill values then.
    even = next((n for n in range(rows, rows // 2, -1) if whole[-2] % n == 0), rows)
    return (*whole[:-2], even, whole[-1])


def known_chunk(shape: Shape, block: DocumentView) -> Shape:
    """Return the chunk shape of one cell from the journal; earlier versions had only whole cells and bands."""
    whole = tuple(max(n, 1) for n in shape)
    return tuple(block["chunk"]) if "chunk" in block else whole if block["pieces"] == 1 else (1, *whole[1:])


def counts_of(shape: Shape, chunk: Shape) -> Shape:
    """Return the number of chunks along each dim of a cell."""
    return tuple(ceil(max(n, 1) / own) for n, own in zip(shape, chunk, strict=True))


def pieces_of(shape: Shape, chunk: Shape) -> int:
    """Return the number of chunks of a cell."""
    return prod(counts_of(shape, chunk))


def windows_of(shape: Shape, chunk: Shape) -> list[Window | None]:
    """Return the part of a cell that each of its chunks covers, in Zarr's order; None for the whole cell."""
    counts = counts_of(shape, chunk)
    if prod(counts) == 1:
        return [None]
    return [window_of(shape, chunk, at) for at in product(*map(range, counts))]


def window_of(shape: Shape, chunk: Shape, at: Sequence[int]) -> Window:
    """Return the part of a cell that a chunk covers, from its position among the chunks."""
    return tuple((i * own, min((i + 1) * own, n)) for i, own, n in zip(at, chunk, shape, strict=True))


class Cutter:
    """Splits a cell; a cell computed by band (``Banded``) is asked for each band only once."""

    def __init__(self, array: Any) -> None:
        self.array, self.band, self.plane = array, -1, None

    def part(self, window: Window | None) -> Any:
        """Return a part of the cell."""
        if window is None:
            return self.array
        if isinstance(self.array, np.ndarray):
            return self.array[tuple(slice(*one) for one in window)]
        (band, _), *rest = window
        if band != self.band:
            self.plane = None  # free it before the next one is computed
            self.band, self.plane = band, self.array[band]
        return self.plane[tuple(slice(*one) for one in rest)][np.newaxis]  # type: ignore[index]

    def chunk(self, window: Window | None, shape: Shape) -> Any:
        """Return a part as it is stored: padded to the shape of a chunk."""
        part = self.part(window)
        if window is None or part.shape == shape:
            return part
        whole = np.full(shape, np.nan if part.dtype.kind == "f" else 0, part.dtype)
        whole[tuple(map(slice, part.shape))] = part
        return whole


def joined(parts: Iterable[tuple[Window | None, Array]], windows: Sequence[Window | None]) -> Any:
    """Join the stored parts at these windows: the whole cell, or the bands that they cover."""
    around = [
        (min(begin), max(end))
        for begin, end in (zip(*one, strict=True) for one in zip(*filter(None, windows), strict=True))
    ]
    whole: Any = None
    for window, array in parts:
        if window is None:
            return array
        if whole is None:
            whole = np.empty([end - begin for begin, end in around], array.dtype)
        place = tuple(
            slice(begin - first, end - first) for (begin, end), (first, _) in zip(window, around, strict=True)
        )
        whole[place] = array[tuple(slice(end - begin) for begin, end in window)]
    return whole
