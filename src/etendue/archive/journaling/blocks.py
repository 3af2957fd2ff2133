"""The shards of a run, managed by the owner of the run: the chunks that each shard must contain, and the moment at
which the shard is put in its place.

In:  valid stored chunks, cells to be computed, and their results.
Out: shards in their places, as soon as all their cells are computed, or when the run ends.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Mapping, MutableMapping
from pathlib import Path

import numpy as np

from etendue.archive.journaling.entries import WrittenChunks
from etendue.archive.journaling.journal import Journal
from etendue.archive.records import disk
from etendue.archive.sharding.finding import Finder, State
from etendue.archive.sharding.shards import ChunkPlace, Index, Shard, kept_of, part_path, put_shard
from etendue.contract.ports import WrittenChunk
from etendue.types.arrays import Array

# chunks by shard and slot: as written, and where they lie
Stored = Mapping[tuple[str, int], tuple[WrittenChunk, ChunkPlace]]
Slots = Iterable[tuple[str, int, int]]  # shard, slot, slots of the shard


class ShardContents(MutableMapping[int, tuple[WrittenChunk, ChunkPlace]]):
    """The chunks that one shard has to hold, by slot, in columns: 60 bytes per chunk instead of 400 as objects."""

    def __init__(self, path: str, slots: int) -> None:
        self.path = path
        self.rows = array("i", [-1]) * max(slots, 1)  # by slot
        self.written, self.file, self.offset = WrittenChunks(), array("i"), array("q")
        self.files: list[str] = []  # the files that hold them: there are few

    def __setitem__(self, slot: int, chunk: tuple[WrittenChunk, ChunkPlace]) -> None:
        one, place = chunk
        if place.file not in self.files:
            self.files.append(place.file)
        file, row = self.files.index(place.file), self.rows[slot]
        if row >= 0 and self.written[row] == one:
            self.file[row], self.offset[row] = file, place.offset
            return
        self.rows[slot] = len(self.written)
        self.written.add(one.path, one.slot, one.part, one.offset, one.size, one.digest)
        self.file.append(file)
        self.offset.append(place.offset)

    def add_written(self, one: WrittenChunk, file: str) -> None:
        """Add a chunk that is still in the part ``file`` to which it was written."""
        if file not in self.files:
            self.files.append(file)
        self.rows[one.slot] = len(self.written)
        self.written.add(one.path, one.slot, one.part, one.offset, one.size, one.digest)
        self.file.append(self.files.index(file))
        self.offset.append(one.offset)

    def add_all(self, chunks: WrittenChunks, numbers: Array, offset: Array) -> None:
        """Add new chunks, which are stored at these offsets in the shard itself."""
        if self.path not in self.files:
            self.files.append(self.path)
        begin = len(self.written)
        self.written.add_of(chunks, numbers)
        slots = np.asarray(chunks.slot)[numbers]
        np.asarray(self.rows)[slots] = np.arange(begin, begin + len(slots))
        self.file.extend([self.files.index(self.path)] * len(slots))
        self.offset.frombytes(offset.astype(np.int64).tobytes())

    def __getitem__(self, slot: int) -> tuple[WrittenChunk, ChunkPlace]:
        row = self._row(slot)
        one = self.written[row]
        return one, ChunkPlace(self.files[self.file[row]], self.offset[row], one.size, one.digest)

    def __delitem__(self, slot: int) -> None:
        self._row(slot)
        self.rows[slot] = -1

    def __iter__(self) -> Iterator[int]:
        return (slot for slot, _ in self._every())

    def __len__(self) -> int:
        return len(self.rows) - self.rows.count(-1)

    def __contains__(self, slot: object) -> bool:
        return isinstance(slot, int) and self.rows[slot] >= 0

    def _row(self, slot: int) -> int:
        if self.rows[slot] < 0:
            raise KeyError(slot)
        return self.rows[slot]

    def _every(self) -> Iterator[tuple[int, int]]:
        return ((slot, row) for slot, row in enumerate(self.rows) if row >= 0)

    def lies_as(self, index: Mapping[int, tuple[int, int]]) -> bool:
        """Return True if all chunks are in the shard itself, at the places that ``index`` gives, and ``index`` contains
        no other chunks.
        """
        rows = np.array(self.rows)
        slots = np.flatnonzero(rows >= 0)
        rows = rows[slots]
        files = set(np.array(self.file)[rows].tolist())
        if len(slots) != len(index) or any(self.files[file] != self.path for file in files):
            return False
        places = np.stack([np.array(self.offset)[rows], np.array(self.written.size)[rows]], axis=1)
        if isinstance(index, Index):
            return bool((places == index.index[slots].astype(np.int64)).all())
        return dict(zip(slots.tolist(), map(tuple, places.tolist()), strict=True)) == dict(index)

    def lying(self) -> set[str]:
        """Return the paths of the files that hold these chunks."""
        return {self.files[number] for number in {self.file[row] for _, row in self._every()}}

    def put(self, places: Mapping[int, tuple[int, int]]) -> None:
        """Record that all chunks are now in the shard."""
        self.files = [self.path]
        for slot, row in self._every():
            self.file[row], self.offset[row] = 0, places[slot][0]


class Blocks:
    """The chunks that the shards of an archive must contain when a run has ended.

    Attributes
    ----------
    moved : number of existing shards that were rewritten, bytes that were copied, bytes of chunks that were computed
    """

    def __init__(self, folder: Path, journal: Journal, finder: Finder, durable: bool) -> None:
        self.folder, self.journal, self.finder, self.durable = folder, journal, finder, durable
        self.wanted: dict[str, ShardContents] = {}
        self.slots: dict[str, int] = {}
        self.waiting: dict[str, int] = {}
        self.moved = {"shards": 0, "copied": 0, "computed": 0}

    def contents(self, path: str, slots: int) -> ShardContents:
        """Return the chunks that a shard must contain; the caller may change this object."""
        own = self.wanted.get(path)
        if own is None:
            own = self.wanted[path] = ShardContents(path, slots)
            self.slots[path] = slots
        return own

    def keep(self, chunks: Slots, stored: Stored) -> None:
        """Add stored chunks that do not change."""
        for path, slot, slots in chunks:
            own, found = self.contents(path, slots), stored.get((path, slot))
            if found is not None:
                own[slot] = found

    def found(self, chunks: Iterable[tuple[str, int]]) -> dict[tuple[str, int], tuple[WrittenChunk, ChunkPlace]]:
        """Return those of the given chunks (shard, slot) that are stored, each as it was written and with its present
        place.
        """
        there = ((path, slot, self.wanted.get(path)) for path, slot in chunks)
        return {(path, slot): own[slot] for path, slot, own in there if own is not None and slot in own}

    def expect(self, chunks: Slots, held: Iterable[WrittenChunk] = ()) -> None:
        """Register chunks that will be computed, except chunks in ``held``, which are stored already."""
        there = {(one.path, one.slot) for one in held}
        for path, slot, slots in chunks:
            if (path, slot) not in there:
                self.contents(path, slots).pop(slot, None)
                self.waiting[path] = self.waiting.get(path, 0) + 1

    def ended(self, chunks: Slots, written: Iterable[WrittenChunk]) -> list[str]:
        """Add the chunks of a cell that has ended; return the shards whose cells are all computed."""
        there, complete = {(one.path, one.slot): one for one in written}, []
        for path, slot, slots in chunks:
            one, own = there.get((path, slot)), self.contents(path, slots)
            if one is None:
                own.pop(slot, None)
            elif slot in own and own[slot][0] == one:
                continue  # it was held, or is reported twice
            else:
                own.add_written(one, part_path(one))
                self.moved["computed"] += one.size
            left = self.waiting.get(path, 0) - 1
            self.waiting[path] = left
            if left <= 0:
                complete.append(path)
        return complete

    def changed(self, path: str) -> bool:
        """Return True if a shard on disk lacks required chunks or contains other chunks."""
        state, own, slots = self.finder.state(path, self.slots[path]), self.wanted[path], self.slots[path]
        if state is None or not own:
            return bool(state) or bool(own)
        if self.finder.odd(path, slots) or path not in self.journal.shards:
            return True
        return state.index is None or not own.lies_as(state.index)

    def odd(self) -> list[str]:
        """Return finished shards that are missing, or have another size or a damaged index."""
        return [path for path, slots in self.slots.items() if self.finder.odd(path, slots)]

    def unsettled(self) -> list[str]:
        """Return the shards whose cells are all computed but whose content is not yet correct."""
        return [path for path in self.wanted if self.waiting.get(path, 0) <= 0 and self.changed(path)]

    def put(self, paths: Iterable[str]) -> None:
        """Put shards in their places unless they are correct already."""
        for path in dict.fromkeys(paths):
            if self.changed(path):
                self._put(path)

    def _put(self, path: str) -> None:
        own, slots = self.wanted[path], self.slots[path]
        if not own:
            disk.remove(self.folder, path)
            self.journal.put({path: Shard(0, ())})
            self.finder.states[path] = None
            return
        state = self.finder.state(path, slots)
        if state is not None and state.index is not None and own.lies_as(state.index):
            # It was put in its place, but the run was killed before the journal recorded that.
            self.journal.put({path: Shard(state.size, kept_of(own), True)})
            return
        put = put_shard(self.folder, path, slots, own, self.durable)
        self.journal.put({path: put.shard})
        for part in own.lying() - {path}:
            disk.remove(self.folder, part)
        own.put(put.places)
        self.finder.states[path] = State(put.shard.size, put.places)
        self.moved["copied"] += put.copied
        self.moved["shards"] += state is not None

    def close(self) -> None:
        """Put every shard in its place with the chunks that exist."""
        self.put(list(self.wanted))

    def parts(self) -> set[str]:
        """Return the parts that hold chunks not yet in a shard."""
        return {file for own in self.wanted.values() for file in own.lying() if file.endswith(disk.PART)}
