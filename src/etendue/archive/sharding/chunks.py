"""Chunks, byte for byte as zarr would write them; encoded, checksummed and appended by the worker that computed them.

In:  arrays of one cell; the shards and slots of its chunks.
Out: the places of the chunks (``Written``); arrays read back. A test compares the bytes with the bytes that zarr's own
     API writes.

zarr-python sends every write through one event loop and rewrites a whole shard for each chunk added to it; here a chunk
costs its checksum and one write.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from math import prod
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np

from etendue.archive.sharding.partition import Cutter, Window, joined
from etendue.archive.sharding.segments import GATHERED, PARTS
from etendue.archive.sharding.shards import ChunkPlace, fits, part_path, read_bytes, read_index
from etendue.archive.sharding.unfolding import refuse_other_size
from etendue.contract.ports import WrittenChunk
from etendue.errors import ArchiveError
from etendue.types.arrays import Array

CODEC, LEVEL = "lz4", 5
DENSE = "zstd"  # of floats that are multiples of a step
RAW = "raw"  # the codec of a chunk: CODEC, DENSE, or RAW for the bytes as in memory


@cache
def _blosc() -> Any:
    """Return the compressor; imported late, because looking at an archive decodes nothing."""
    from numcodecs import blosc

    blosc.use_threads = False  # the bits and the time of a chunk must not depend on the threads around it
    return blosc


def pieces_of(array: Array, codec: str = CODEC) -> tuple[Any, bytes]:
    """Return the body of a chunk (little-endian bytes, blosc with bitshuffle unless raw) and its crc32c."""
    array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).reshape(-1)
    body: Any = (
        array.view(np.uint8)
        if codec == RAW
        else _blosc().compress(array, codec.encode(), LEVEL, _blosc().BITSHUFFLE, 0, array.itemsize)
    )
    if codec == RAW:
        body.flags.writeable = False  # of this view only: read-only data need not be copied
    return body, int(google_crc32c.value(body)).to_bytes(4, "little")


def encode(array: Array, codec: str = CODEC) -> bytes:
    """Return one chunk as bytes."""
    body, checksum = pieces_of(array, codec)
    return bytes(body) + checksum


def decode(data: bytes, dtype: str, shape: tuple[int, ...], codec: str = CODEC) -> Array:
    """Return the array of one chunk; raise ``ArchiveError`` if its checksum or size does not match."""
    body, checksum = data[:-4], data[-4:]
    if len(data) < 4 or int(google_crc32c.value(body)).to_bytes(4, "little") != checksum:
        raise ArchiveError("the stored bytes do not match their checksum")
    try:
        little = np.dtype(dtype).newbyteorder("<")
        if codec != RAW:
            refuse_other_size(body, prod(shape) * little.itemsize)
        array = np.frombuffer(body if codec == RAW else _blosc().decompress(body), dtype=little)
        return array.astype(dtype, copy=False).reshape(shape)
    except (RuntimeError, ValueError, TypeError) as error:
        raise ArchiveError(f"the stored bytes do not decode to an array of {dtype} {shape}: {error}") from None


def decode_all(chunks: Sequence[bytes], dtype: str, shape: tuple[int, ...], codec: str) -> Array | None:
    """Return one array with all chunks along its first dim; None if a chunk has another size. The caller must have
    checked the checksums.
    """
    size = prod(shape) * np.dtype(dtype).itemsize
    if codec != RAW:
        return np.array([decode(data, dtype, shape, codec) for data in chunks], dtype).reshape(-1, *shape)
    if any(len(data) != size + 4 for data in chunks):
        return None
    whole = np.frombuffer(b"".join([data[:-4] for data in chunks]), np.dtype(dtype).newbyteorder("<"))
    return whole.astype(dtype, copy=False).reshape(-1, *shape)


class Spent:
    """The bytes that this process has written, counted before compression, and the CPU time of its threads for writing
    (s).
    """

    def __init__(self) -> None:
        self.lock, self.bytes, self.seconds = threading.Lock(), 0, 0.0

    def add(self, size: int, seconds: float) -> None:
        with self.lock:
            self.bytes, self.seconds = self.bytes + size, self.seconds + seconds

    def taken(self) -> tuple[int, float]:
        """Return the bytes and the time (s), and reset both."""
        with self.lock:
            found, self.bytes, self.seconds = (self.bytes, self.seconds), 0, 0.0
        return found


SPENT = Spent()


@dataclass(frozen=True)
class Chunk:
    """One chunk of one variable: its slot in a shard, and the part of the cell that it covers (None: the whole cell).

    ``slots`` is the number of slots of the shard, 0 if the file is the chunk itself.
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
    """The chunks of one cell. This object is sent to the worker with the job and does not refer to the plan."""

    root: str
    run_id: str
    chunks: tuple[Chunk, ...]
    durable: bool = False
    held: tuple[WrittenChunk, ...] = ()  # valid stored chunks, which stay as they are
    # by shard and slot; a place of None means in its part
    places: dict[tuple[str, int], tuple[WrittenChunk, ChunkPlace | None]] = field(default_factory=dict)

    def write(self, arrays: Mapping[str, Any]) -> tuple[WrittenChunk, ...]:
        """Append every chunk to this process's part of its shard; return the places of the chunks."""
        began, size_in_memory = time.thread_time(), 0
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
            size_in_memory += array.nbytes
            size = len(body) + 4
            if size < GATHERED and chunk.codec == RAW and array.flags.writeable:
                body = bytes(body)  # it waits to be written, and its owner may change it meanwhile
            part, offset = PARTS.append(self.root, self.run_id, chunk.path, (body, checksum), size, self.durable)
            one = WrittenChunk(chunk.path, chunk.slot, part, offset, size, int.from_bytes(checksum, "little"))
            self.places[chunk.path, chunk.slot] = one, None
            written.append(one)
        SPENT.add(size_in_memory, time.thread_time() - began)
        return tuple(written)

    def settle(self) -> None:
        """Write all buffered chunks of the cells of a batch to their files."""
        PARTS.settle(self.root, self.run_id)

    def read(self, variable: str) -> Any:
        """Return the array of one variable, checked against its checksum."""
        own = [chunk for chunk in self.chunks if chunk.variable == variable]
        if len(own) == 1 and own[0].window is None:
            return np.array(self._read(own[0]))
        return joined(((chunk.window, self._read(chunk)) for chunk in own), [chunk.window for chunk in own])

    def read_band(self, variable: str, band: int) -> Any:
        """Return one band of a variable that is stored by band."""
        own = [c for c in self.chunks if c.variable == variable and c.window and c.window[0] == (band, band + 1)]
        return joined(((chunk.window, self._read(chunk)) for chunk in own), [chunk.window for chunk in own])[0]

    def _read(self, chunk: Chunk) -> Array:
        found = self.places.get((chunk.path, chunk.slot))
        if found is None:
            raise ArchiveError(f"{chunk.path}: there is no chunk {chunk.slot} in it")
        PARTS.flush(self.root)
        for place in self._where(chunk, *found):
            try:
                data = read_bytes(Path(self.root), place)
            except FileNotFoundError:
                continue
            if fits(data, place):
                return decode(data, chunk.dtype, chunk.shape, chunk.codec)
        raise ArchiveError(f"{chunk.path}: chunk {chunk.slot} is missing, or its bytes do not match their checksum")

    def _where(self, chunk: Chunk, written: WrittenChunk, place: ChunkPlace | None) -> Iterator[ChunkPlace]:
        """Yield the possible places of a chunk: the known place, its part, and the shard that this part may be now."""
        if place is not None:
            yield place
        yield ChunkPlace(part_path(written), written.offset, written.size, written.digest)
        try:
            _, index = read_index(Path(self.root) / chunk.path, chunk.slots)
        except FileNotFoundError:
            return
        if index and chunk.slot in index:
            yield ChunkPlace(chunk.path, *index[chunk.slot], written.digest)
