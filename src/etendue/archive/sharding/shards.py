"""Shards: many chunks of one variable in one file, followed by an index of their places.

In:  chunks by their number in a shard (slot), and the files that hold their bytes.
Out: a complete shard in its place, and the byte ranges of the files that it holds.

The format is Zarr's ``sharding_indexed`` with the index at the end: offset and length of every slot as little-endian
uint64 (all ones if there is no chunk), and the crc32c of these bytes. Chunks may be in any order, with gaps between
them.
"""

from __future__ import annotations

import fcntl
import os
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from pathlib import Path

import google_crc32c
import numpy as np

from etendue.archive.records import disk
from etendue.archive.remote import stubs
from etendue.contract.ports import WrittenChunk
from etendue.types.arrays import Array

LARGEST = 64 << 20  # bytes of a shard; more data is split into more shards
SMALLEST = 8 << 20  # bytes that gaps may waste before a shard is copied rather than renamed
MOST = 4096  # chunks of a shard: reading one of them reads the index of all
EXTRA = 64  # shards of all variables beyond the first one each; if there are more, shards are made larger
NOTHING = 2**64 - 1


def block_of(sizes: tuple[int, ...], cell_bytes: int, pieces: int = 1, largest: int = LARGEST) -> tuple[int, ...]:
    """Return, for each axis, the number of values that share a shard: all values of the innermost axes, as far as bytes
    and number of chunks allow; the next axis is split evenly.
    """
    block, room = [1] * len(sizes), max(min(largest // max(cell_bytes, 1), MOST // pieces), 1)
    for number in reversed(range(len(sizes))):
        size = max(sizes[number], 1)
        block[number] = size if size <= room else ceil(size / ceil(size / room))
        if size > room:
            break
        room //= size
    return tuple(block)


# -- the index --------------------------------------------------------------------------------------------------------


def index_size(slots: int) -> int:
    """Return the bytes of the index of a shard; a chunk file without slots has no index (0)."""
    return 16 * slots + 4 if slots else 0


def index_bytes(slots: int, places: Mapping[int, tuple[int, int]]) -> bytes:
    """Return the index of a shard from (offset, length) by slot."""
    data = Index.of(slots, places).index.tobytes()
    return bytes(data) + int(google_crc32c.value(data)).to_bytes(4, "little")


class Index(Mapping[int, tuple[int, int]]):
    """(offset, length) by slot, kept as the array in the index of a shard: 16 bytes per slot."""

    def __init__(self, index: Array) -> None:
        self.index, self.there = index, (index != NOTHING).any(axis=1)

    @classmethod
    def of(cls, slots: int, places: Mapping[int, tuple[int, int]]) -> Index:
        index = np.full((slots, 2), NOTHING, "<u8")
        if places:
            index[list(places)] = list(places.values())
        return cls(index)

    def __getitem__(self, slot: int) -> tuple[int, int]:
        if not (0 <= slot < len(self.there) and self.there[slot]):
            raise KeyError(slot)
        offset, length = self.index[slot].tolist()
        return offset, length

    def __iter__(self) -> Iterator[int]:
        return iter(np.flatnonzero(self.there).tolist())

    def __len__(self) -> int:
        return int(np.count_nonzero(self.there))


def read_index(path: Path, slots: int) -> tuple[int, Mapping[int, tuple[int, int]] | None]:
    """Return the size of a shard, and (offset, length) by slot, or None if its index is damaged.

    Raises
    ------
    OSError
        The file does not exist.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        size, length = os.fstat(handle).st_size, index_size(slots)
        if not slots:
            return size, {0: (0, size)}
        data = os.pread(handle, length, max(size - length, 0))
    finally:
        os.close(handle)
    body = data[:-4]
    if len(data) != length or int(google_crc32c.value(body)).to_bytes(4, "little") != data[-4:]:
        return size, None
    index = np.frombuffer(body, "<u8").reshape(slots, 2)
    return size, Index(index)


# -- chunks in shards -------------------------------------------------------------------------------------------------


LARGEST_CHUNK = 1 << 31  # bytes; the limit of Blosc


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """The present place of the bytes of a chunk: in a shard or in a part."""

    file: str  # below the archive
    offset: int
    size: int
    digest: int


@dataclass(frozen=True)
class Shard:
    """A shard as it was put in its place."""

    size: int
    # (part, from, to, length): these bytes of the part are at ``to`` in the shard
    kept: tuple[tuple[str, int, int, int], ...]
    fresh: bool = False  # put since the last run that ended in order

    def at(self, written: WrittenChunk) -> int | None:
        """Return the offset in the shard of a chunk that was appended to a part; None if the shard does not hold the
        chunk.
        """
        starts, runs = self._runs.get(written.part, ((), ()))
        number = bisect_right(starts, written.offset) - 1
        if number < 0:
            return None
        start, to, length = runs[number]
        return to + written.offset - start if written.offset + written.size <= start + length else None

    def all_at(self, parts: Sequence[str], offset: Array, size: Array) -> Array:
        """Return the offsets of many chunks; -1 if the shard does not hold a chunk."""
        found, named = np.full(len(parts), -1), np.array(parts, dtype=object)
        for part in set(parts):
            runs = self._runs.get(part)
            if runs is not None:
                own = np.flatnonzero(named == part)
                number = np.searchsorted(runs[0], offset[own], side="right") - 1
                start, to, length = np.array(runs[1])[number].T
                inside = (number >= 0) & (offset[own] + size[own] <= start + length)
                found[own] = np.where(inside, to + offset[own] - start, -1)
        return found

    @cached_property
    def _runs(self) -> dict[str, tuple[Sequence[int], Sequence[tuple[int, int, int]]]]:
        """By part, the starts of its byte ranges, in order, and the ranges: (offset in the part, offset in the shard,
        length).
        """
        found: dict[str, list[tuple[int, int, int]]] = {}
        for part, start, to, length in self.kept:
            found.setdefault(part, []).append((start, to, length))
        return {part: ([one[0] for one in own], own) for part, own in ((p, sorted(own)) for p, own in found.items())}


def part_path(written: WrittenChunk) -> str:
    """Return the path of the part, beside its shard, to which bytes were appended."""
    folder, _, name = written.path.rpartition("/")
    return f"{folder}/.{name}.{written.part}{disk.PART}"


def holds(root: Path, place: ChunkPlace) -> bool:
    """Return True if the bytes of a chunk are at the place and match their digest."""
    try:
        data = read_bytes(root, place)
    except OSError:
        return False
    return fits(data, place)


def fits(data: bytes, place: ChunkPlace) -> bool:
    """Return True if bytes have the size and the trailing checksum of a chunk."""
    if len(data) != place.size or place.size < 4:
        return False
    return int(google_crc32c.value(data[:-4])) == place.digest == int.from_bytes(data[-4:], "little")


def read_bytes(root: Path, place: ChunkPlace) -> bytes:
    """Return the bytes at the place of a chunk: fewer if the file ends earlier, none if the size is implausible."""
    with ShardFiles(root) as files:
        return files.read(place)


class ShardFiles:
    """A context manager that reads chunks of several files; a file stays open while consecutive chunks come from it."""

    def __init__(self, root: Path) -> None:
        self.root, self.file, self.handle, self.stands_in = root, "", -1, False

    def __enter__(self) -> ShardFiles:
        return self

    def __exit__(self, *error: object) -> None:
        self._close()

    def _close(self) -> None:
        handle, self.handle, self.file = self.handle, -1, ""
        if handle >= 0:
            os.close(handle)

    def read(self, place: ChunkPlace) -> bytes:
        """Read one chunk, as ``read_bytes`` does."""
        if place.size > LARGEST_CHUNK:
            return b""
        if self.handle < 0 or place.file != self.file:
            self._close()
            self.handle = os.open(
                f"{self.root}/{place.file}", os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
            )
            self.file, self.stands_in = place.file, stubs.is_stand_in(self.handle)
        if self.stands_in:
            return stubs.read(self.root, place.file, self.handle, place.offset, place.size)
        data = os.pread(self.handle, place.size, place.offset)
        while len(data) < place.size:
            more = os.pread(self.handle, place.size - len(data), place.offset + len(data))
            if not more:
                break
            data += more
        return data


# -- putting a shard in its place -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Put:
    """The result of putting a shard in its place."""

    shard: Shard
    places: Mapping[int, tuple[int, int]]  # offset and length by slot
    copied: int  # bytes


def put_shard(
    root: Path, path: str, slots: int, chunks: Mapping[int, tuple[WrittenChunk, ChunkPlace]], durable: bool = False
) -> Put:
    """Make a shard of chunks in parts or in an existing shard, and put it in its place.

    The part with most of the bytes becomes the shard: other chunks are appended to it, then the index, then it is
    renamed. An existing shard in that place is replaced, never modified.
    """
    chunks = dict(chunks)  # a mapping may make each of them anew whenever it is asked
    base = _base(root, path, slots, chunks)
    folder, _, name = path.rpartition("/")
    beside = base or f"{folder}/.{name}.{os.urandom(6).hex()}{disk.PART}"
    handle = disk.open_own(root, beside) if base else disk.create(root, beside, durable)
    try:
        # A worker of an earlier run that still has the part open can no longer write to it.
        fcntl.flock(handle, fcntl.LOCK_EX)
        own = {slot: place for slot, (_, place) in chunks.items() if place.file == base}
        end = max((place.offset + place.size for place in own.values()), default=0)
        if os.fstat(handle).st_size != end:
            # Bytes after the last wanted chunk must go: readers find the index from the end of the file.
            os.ftruncate(handle, end)
        places = {slot: (place.offset, place.size) for slot, place in own.items()}
        others = {slot: place for slot, (_, place) in chunks.items() if slot not in own}
        copied = end
        for slot, offset in _copied(root, handle, end, others):
            places[slot] = (offset, chunks[slot][1].size)
            copied += chunks[slot][1].size
        data = index_bytes(slots, places) if slots else b""
        disk.write_at(handle, [data], copied)
        if durable:
            # Before the rename: after a power cut, no name may stand for a file without its content.
            os.fsync(handle)
        disk.rename(root, beside, path, durable)
    except BaseException:
        if not base:
            with suppress(OSError):
                disk.remove(root, beside)
        raise
    finally:
        os.close(handle)
    kept = _runs((one.part, one.offset, places[slot][0], one.size) for slot, (one, _) in chunks.items())
    return Put(Shard(copied + len(data), kept, True), Index.of(slots, places) if slots else places, copied - end)


def kept_of(chunks: Mapping[int, tuple[WrittenChunk, ChunkPlace]]) -> tuple[tuple[str, int, int, int], ...]:
    """Return the byte ranges of parts that a shard contains."""
    return _runs((written.part, written.offset, place.offset, written.size) for written, place in chunks.values())


def _base(root: Path, path: str, slots: int, chunks: Mapping[int, tuple[WrittenChunk, ChunkPlace]]) -> str:
    """Return the part that becomes the shard: the part with most of the bytes; '' if too many of its bytes are unused
    or it has a second name.
    """
    held: dict[str, int] = {}
    for _, place in chunks.values():
        if place.file != path:
            held[place.file] = held.get(place.file, 0) + place.size
    if not held or not slots:
        return ""
    base = max(held, key=lambda file: (held[file], file))
    # A file with a second name is not changed, because it would change under that name too.
    end = max(place.offset + place.size for _, place in chunks.values() if place.file == base)
    if end - held[base] > max(held[base] // 8, min(SMALLEST, held[base] // 2)) or (root / base).lstat().st_nlink > 1:
        return ""
    return base


def _copied(root: Path, target: int, end: int, places: Mapping[int, ChunkPlace]) -> Iterable[tuple[int, int]]:
    """Append chunks from other files, in the order in which each file holds them; yield slot and new offset of each
    chunk.
    """
    opened: dict[str, int] = {}
    try:
        runs: list[tuple[str, int, int]] = []
        for slot, place in sorted(places.items(), key=lambda one: (one[1].file, one[1].offset)):
            # Adjacent chunks are merged, so that each run of bytes takes one system call.
            if runs and runs[-1][0] == place.file and runs[-1][1] + runs[-1][2] == place.offset:
                runs[-1] = (place.file, runs[-1][1], runs[-1][2] + place.size)
            else:
                runs.append((place.file, place.offset, place.size))
            yield slot, end
            end += place.size
        at = end - sum(length for _, _, length in runs)
        for file, start, length in runs:
            if file not in opened:
                opened[file] = stubs.opened(root, file)
            disk.copy_range(opened[file], start, target, at, length)
            at += length
    finally:
        for handle in opened.values():
            os.close(handle)


def _runs(pieces: Iterable[tuple[str, int, int, int]]) -> tuple[tuple[str, int, int, int], ...]:
    """Merge byte ranges (part, from, to, length) that are adjacent both in the part and in the shard."""
    runs: list[tuple[str, int, int, int]] = []
    for part, start, to, length in sorted(pieces):
        if runs and runs[-1][0] == part and runs[-1][1] + runs[-1][3] == start and runs[-1][2] + runs[-1][3] == to:
            runs[-1] = (part, runs[-1][1], runs[-1][2], runs[-1][3] + length)
        else:
            runs.append((part, start, to, length))
    return tuple(runs)
