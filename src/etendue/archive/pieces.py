"""How a cell is cut into chunks: whole, by band, in bands of rows, or both.

In:  dims, shape and bytes of a variable of one cell.
Out: the shape of its chunks, which part of the cell each of them is; arrays cut so, and put together again.

Who reads a window of a large frame decodes the row bands under it and no others, and who writes one never holds it
encoded. Chunks of Zarr are all of one shape: where rows do not come out even the last band goes on behind the frame, in
fill values, as Zarr has it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from math import ceil, prod
from typing import Any

import numpy as np

from etendue.contract.dims import is_light
from etendue.plan import cost
from etendue.types.documents import DocumentView

LARGEST_CHUNK = 64 << 20  # bytes; a cell above it is cut in row bands
BANDS = 4  # of them together hold about as much as the largest chunk: 16 MB

Shape = tuple[int, ...]
Window = tuple[tuple[int, int], ...]  # from where to where along each dim of a cell


def chunk_of(dims: Sequence[str], shape: Shape, itemsize: int) -> Shape:
    """The shape of the chunks of a cell; its own where it is one chunk."""
    whole = tuple(max(n, 1) for n in shape)
    if (
        len(dims) == 3 and is_light(dims) and itemsize * prod(shape) > cost.LARGEST_WHOLE
    ):  # it is made by band; Blosc refuses 2 GiB
        whole = (1, *whole[1:])
    size = itemsize * prod(whole)
    if size <= LARGEST_CHUNK or tuple(dims)[-2:] != ("y", "x"):
        return whole
    rows = ceil(whole[-2] / ceil(size * BANDS / LARGEST_CHUNK))
    even = next((n for n in range(rows, rows // 2, -1) if whole[-2] % n == 0), rows)
    return (*whole[:-2], even, whole[-1])


def known_chunk(shape: Shape, block: DocumentView) -> Shape:
    """The shape of the chunks of one cell, as the journal says; earlier versions knew whole cells and bands."""
    whole = tuple(max(n, 1) for n in shape)
    return tuple(block["chunk"]) if "chunk" in block else whole if block["pieces"] == 1 else (1, *whole[1:])


def counts_of(shape: Shape, chunk: Shape) -> Shape:
    """How many chunks lie along each dim of a cell."""
    return tuple(ceil(max(n, 1) / own) for n, own in zip(shape, chunk, strict=True))


def pieces_of(shape: Shape, chunk: Shape) -> int:
    """How many chunks a cell is."""
    return prod(counts_of(shape, chunk))


def room_of(shape: Shape, chunk: Shape) -> Shape:
    """What the chunks of a cell hold together: its shape, its rows rounded up to whole bands."""
    return tuple(count * own for count, own in zip(counts_of(shape, chunk), chunk, strict=True))


def windows_of(shape: Shape, chunk: Shape) -> list[Window | None]:
    """Which part of a cell each of its chunks is, in the order of Zarr; None: all of it."""
    counts = counts_of(shape, chunk)
    if prod(counts) == 1:
        return [None]
    return [window_of(shape, chunk, at) for at in product(*map(range, counts))]


def window_of(shape: Shape, chunk: Shape, at: Sequence[int]) -> Window:
    """The part of a cell that a chunk is, from its position among them."""
    return tuple((i * own, min((i + 1) * own, n)) for i, own, n in zip(at, chunk, shape, strict=True))


class Cutter:
    """A cell being cut: one that is made by band (``Banded``) is asked for each of them once."""

    def __init__(self, array: Any) -> None:
        self.array, self.band, self.plane = array, -1, None

    def part(self, window: Window | None) -> Any:
        """A part of the cell."""
        if window is None:
            return self.array
        if isinstance(self.array, np.ndarray):
            return self.array[tuple(slice(*one) for one in window)]
        (band, _), *rest = window
        if band != self.band:
            self.plane = None  # before the next one is made
            self.band, self.plane = band, self.array[band]
        return self.plane[tuple(slice(*one) for one in rest)][np.newaxis]  # type: ignore[index]

    def chunk(self, window: Window | None, shape: Shape) -> Any:
        """A part as it is stored: filled up to the shape of a chunk."""
        part = self.part(window)
        if window is None or part.shape == shape:
            return part
        whole = np.full(shape, np.nan if part.dtype.kind == "f" else 0, part.dtype)
        whole[tuple(map(slice, part.shape))] = part
        return whole


def joined(parts: Iterable[tuple[Window | None, Any]], windows: Sequence[Window | None]) -> Any:
    """What the parts at these windows make up together, each as it is stored: the whole cell, or the bands that they
    cover.
    """
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
