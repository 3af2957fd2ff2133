"""The shards of a run, in its owner's hands: which chunks each is to hold, and when it is put in its place.

In:  chunks that are stored and right, cells to be computed, what became of them.
Out: shards in their places, as soon as nothing of them is left to be computed, or when the run ends.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from etendue.archive import disk
from etendue.archive.chunks import Chunk
from etendue.archive.finding import Finder, State
from etendue.archive.journal import Journal
from etendue.archive.shards import Place, Shard, kept_of, part_path, put_shard
from etendue.spec.ports import Written

Stored = Mapping[tuple[str, int], tuple[Written, Place]]  # chunks by shard and slot: as they were written, where they lie


class Blocks:
    """What the shards of an archive are to hold when a run has ended.

    Attributes
    ----------
    moved : shards that stood in their places and were made anew, bytes copied, bytes of chunks that were computed
    """

    def __init__(self, folder: Path, journal: Journal, finder: Finder, durable: bool) -> None:
        self.folder, self.journal, self.finder, self.durable = folder, journal, finder, durable
        self.wanted: dict[str, dict[int, tuple[Written, Place]]] = {}
        self.slots: dict[str, int] = {}
        self.waiting: dict[str, int] = {}
        self.moved = {"shards": 0, "copied": 0, "computed": 0}

    def keep(self, chunks: Iterable[Chunk], stored: Stored) -> None:
        """Chunks that stay as they are."""
        for chunk in chunks:
            found = stored.get((chunk.path, chunk.slot))
            self.slots[chunk.path] = chunk.slots
            own = self.wanted.setdefault(chunk.path, {})
            if found is not None:
                own[chunk.slot] = found

    def expect(self, chunks: Iterable[Chunk], held: Iterable[Written] = ()) -> None:
        """Chunks that will be computed, those held aside."""
        there = {(one.path, one.slot) for one in held}
        for chunk in chunks:
            if (chunk.path, chunk.slot) not in there:
                self.slots[chunk.path] = chunk.slots
                self.wanted.setdefault(chunk.path, {}).pop(chunk.slot, None)
                self.waiting[chunk.path] = self.waiting.get(chunk.path, 0) + 1

    def ended(self, chunks: Iterable[Chunk], written: Iterable[Written]) -> list[str]:
        """Take what became of a cell; gives the shards of which nothing is left to be computed."""
        there, complete = {(one.path, one.slot): one for one in written}, []
        for chunk in chunks:
            one = there.get((chunk.path, chunk.slot))
            own = self.wanted.setdefault(chunk.path, {})
            if one is None:
                own.pop(chunk.slot, None)
            elif chunk.slot in own and own[chunk.slot][0] == one:
                continue  # it was held, or is told twice
            else:
                own[chunk.slot] = one, Place(part_path(one), one.offset, one.size, one.digest)
                self.moved["computed"] += one.size
            left = self.waiting.get(chunk.path, 0) - 1
            self.waiting[chunk.path] = left
            if left <= 0:
                complete.append(chunk.path)
        return complete

    def changed(self, path: str) -> bool:
        """Whether what stands in the place of a shard is not what it is to be."""
        state, own, slots = self.finder.state(path, self.slots[path]), self.wanted[path], self.slots[path]
        if state is None or not own:
            return bool(state) or bool(own)
        if self.finder.odd(path, slots) or path not in self.journal.shards:
            return True
        return state.index != self._there(path) or len(state.index) != len(own)

    def _there(self, path: str) -> dict[int, tuple[int, int]]:
        """What the index of a shard has to say of the chunks that lie in it."""
        return {slot: (place.offset, place.size) for slot, (_, place) in self.wanted[path].items() if place.file == path}

    def odd(self) -> list[str]:
        """Shards that stand in their places and are not as they were put there."""
        return [path for path, slots in self.slots.items() if self.finder.odd(path, slots)]

    def unsettled(self) -> list[str]:
        """The shards of which nothing is left to be computed, and that are not what they are to be."""
        return [path for path in self.wanted if self.waiting.get(path, 0) <= 0 and self.changed(path)]

    def put(self, paths: Iterable[str]) -> None:
        """Put shards in their places, where what stands there is not right already."""
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
        if state is not None and state.index == self._there(path) and len(state.index) == len(own):
            self.journal.put({path: Shard(state.size, kept_of(own), True)})  # it was put there, and nobody came to say so
            return
        put = put_shard(self.folder, path, slots, own, self.durable)
        self.journal.put({path: put.shard})
        for part in {place.file for _, place in own.values()} - {path}:
            disk.remove(self.folder, part)
        for slot, (written, place) in own.items():
            own[slot] = written, Place(path, put.places[slot][0], place.size, place.digest)
        self.finder.states[path] = State(put.shard.size, put.places)
        self.moved["copied"] += put.copied
        self.moved["shards"] += state is not None

    def close(self) -> None:
        """Put every shard in its place, with what there is."""
        self.put(list(self.wanted))

    def parts(self) -> set[str]:
        """The parts in which chunks lie that are not in their places yet."""
        return {place.file for own in self.wanted.values() for _, place in own.values() if place.file.endswith(disk.PART)}
