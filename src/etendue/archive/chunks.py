"""Chunks: the bytes zarr would write for them, encoded, checksummed and appended by the worker that made them.

In:  arrays of one cell; where its chunks belong.
Out: where they were put (``Written``); arrays read back. A test holds the bytes equal to those of zarr's own API.

zarr-python sends every write through one event loop and rewrites a shard for each chunk of it; here a chunk costs its
checksum and one write.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
from numcodecs import blosc

from etendue.archive.parts import PARTS
from etendue.archive.pieces import Cutter, Window, joined
from etendue.archive.shards import Place, fits, part_path, read_bytes, read_index
from etendue.archive.unfolding import refuse_other_size
from etendue.contract.ports import Written
from etendue.errors import ArchiveError
from etendue.types.arrays import Array

blosc.use_threads = False  # the bits and the time of a chunk must not depend on the threads around it
CODEC, LEVEL = "lz4", 5
RAW = "raw"  # the kinds of a chunk: CODEC, or as it is in memory


def pieces_of(array: Array, codec: str = CODEC) -> tuple[Any, bytes]:
    """The body of a chunk (little-endian bytes, blosc with bitshuffle unless raw) and the crc32c behind it."""
    array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).reshape(-1)
    body: Any = (
        array.view(np.uint8)
        if codec == RAW
        else blosc.compress(array, CODEC.encode(), LEVEL, blosc.BITSHUFFLE, 0, array.itemsize)
    )
    if codec == RAW:
        body.flags.writeable = False  # of this view alone; what is read only needs no copy
    return body, int(google_crc32c.value(body)).to_bytes(4, "little")


def encode(array: Array, codec: str = CODEC) -> bytes:
    """One chunk."""
    body, checksum = pieces_of(array, codec)
    return bytes(body) + checksum


def decode(data: bytes, dtype: str, shape: tuple[int, ...], codec: str = CODEC) -> Array:
    """The array of one chunk; raises ``ArchiveError`` where the checksum or the size does not fit."""
    body, checksum = data[:-4], data[-4:]
    if len(data) < 4 or int(google_crc32c.value(body)).to_bytes(4, "little") != checksum:
        raise ArchiveError("the stored bytes do not fit their checksum")
    try:
        little = np.dtype(dtype).newbyteorder("<")
        if codec != RAW:
            refuse_other_size(body, prod(shape) * little.itemsize)
        array = np.frombuffer(body if codec == RAW else blosc.decompress(body), dtype=little)
        return array.astype(dtype, copy=False).reshape(shape)
    except (RuntimeError, ValueError, TypeError) as error:
        raise ArchiveError(f"the stored bytes are no array of {dtype} {shape}: {error}") from None


@dataclass(frozen=True)
class Chunk:
    """One chunk of one variable: its slot in a shard, and which part of the cell it is; None: all of it.

    ``slots`` of the shard: 0 for a file that is the chunk itself.
    """

    variable: str
    path: str
    slot: int
    slots: int
    dtype: str
    shape: tuple[int, ...]
    codec: str = CODEC
    window: Window | None = None


@dataclass(frozen=True)
class CellFiles:
    """The chunks of one cell. Travels with the job; knows nothing of the plan."""

    root: str
    run_id: str
    chunks: tuple[Chunk, ...]
    durable: bool = False
    held: tuple[Written, ...] = ()  # chunks that are stored and right: they stay as they are
    places: dict[tuple[str, int], tuple[Written, Place | None]] = field(
        default_factory=dict
    )  # by shard and slot; None: in its part

    def write(self, arrays: Mapping[str, Any]) -> tuple[Written, ...]:
        """Append every chunk to this process's part of its shard."""
        written = list(self.held)
        there = {(file.path, file.slot) for file in self.held}
        cutters: dict[str, Cutter] = {}
        for chunk in self.chunks:
            if (chunk.path, chunk.slot) in there:
                continue
            if chunk.window is None:
                array = arrays[chunk.variable]
            else:
                cutter = cutters.get(chunk.variable) or cutters.setdefault(
                    chunk.variable, Cutter(arrays[chunk.variable])
                )
                array = cutter.chunk(chunk.window, chunk.shape)
            body, checksum = pieces_of(array, chunk.codec)
            size = len(body) + 4
            part, offset = PARTS.append(self.root, self.run_id, chunk.path, (body, checksum), size, self.durable)
            one = Written(chunk.path, chunk.slot, part, offset, size, int.from_bytes(checksum, "little"))
            self.places[chunk.path, chunk.slot] = one, None
            written.append(one)
        return tuple(written)

    def settle(self) -> None:
        """What the cells of a batch have written stands in its files."""
        PARTS.settle(self.root, self.run_id)

    def read(self, variable: str) -> Any:
        """The array of one variable, checked against its checksum."""
        own = [chunk for chunk in self.chunks if chunk.variable == variable]
        if len(own) == 1 and own[0].window is None:
            return np.array(self._read(own[0]))
        return joined(((chunk.window, self._read(chunk)) for chunk in own), [chunk.window for chunk in own])

    def read_band(self, variable: str, band: int) -> Any:
        """One band of a variable that is stored by band."""
        own = [c for c in self.chunks if c.variable == variable and c.window and c.window[0] == (band, band + 1)]
        return joined(((chunk.window, self._read(chunk)) for chunk in own), [chunk.window for chunk in own])[0]

    def _read(self, chunk: Chunk) -> Array:
        found = self.places.get((chunk.path, chunk.slot))
        if found is None:
            raise ArchiveError(f"{chunk.path}: it holds no chunk {chunk.slot}")
        PARTS.flush(self.root)
        for place in self._where(chunk, *found):
            try:
                data = read_bytes(Path(self.root), place)
            except FileNotFoundError:
                continue
            if fits(data, place):
                return decode(data, chunk.dtype, chunk.shape, chunk.codec)
        raise ArchiveError(f"{chunk.path}: chunk {chunk.slot} is missing, or its bytes do not fit their checksum")

    def _where(self, chunk: Chunk, written: Written, place: Place | None) -> Iterator[Place]:
        """Where a chunk may lie: a shard may have been made of its part since."""
        if place is not None:
            yield place
        yield Place(part_path(written), written.offset, written.size, written.digest)
        try:
            _, index = read_index(Path(self.root) / chunk.path, chunk.slots)
        except FileNotFoundError:
            return
        if index and chunk.slot in index:
            yield Place(chunk.path, *index[chunk.slot], written.digest)
