"""Parts of a cell that is stored in several chunks: whole, by band, in bands of rows, or both.

In:  the shapes of a cell and of its chunks.
Out: the part of the cell that each chunk covers; arrays split this way and rejoined.

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

from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    from etendue.types.arrays import Array

Shape = tuple[int, ...]
Window = tuple[tuple[int, int], ...]  # (start, end) along each dim of a cell


def known_chunk(shape: Shape, block: DocumentView) -> Shape:
    """Return the shape of the chunks of a cell from the journal. Entries of earlier versions do not state it: their
    chunks are whole cells or single bands.
    """
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
    """A cell to be split into parts; if the cell is computed by band (``Banded``), each band is computed only once."""

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
    """Return the stored parts of a cell joined to one array: the whole cell, or the bands that ``windows`` cover."""
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
