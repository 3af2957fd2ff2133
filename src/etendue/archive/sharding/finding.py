"""Locate stored chunks: entries of the journal checked against the sizes and indexes of the files.

In:  the folder of an archive, its journal.
Out: the place of a chunk, or None if it is lost.

After a run that ended normally, no chunk has to be read: the size of a shard matches the journal, and its index gives
the same place. Chunks written later, and chunks in a shard that does not match the journal, are read back and checked
against their digests; a flipped bit in an index therefore costs no cell.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from etendue.archive.sharding.shards import ChunkPlace, Index, Shard, holds, part_path, read_index
from etendue.contract.ports import WrittenChunk
from etendue.types.arrays import Array


class Journalled(Protocol):
    """A journal that is open for writing, or for reading only."""

    shards: dict[str, Shard]


@dataclass(frozen=True)
class State:
    """A shard on disk; ``index`` is None if it is damaged."""

    size: int
    index: Mapping[int, tuple[int, int]] | None


class Finder:
    """A locator of chunks, which reads the index of every shard once."""

    def __init__(self, folder: Path, journal: Journalled, linked: frozenset[str] = frozenset()) -> None:
        self.folder, self.journal = folder, journal
        self.linked = linked  # links that replace folders: nothing is read through them
        self.states: dict[str, State | None] = {}

    def state(self, path: str, slots: int) -> State | None:
        """Return the state of a shard; None if it does not exist."""
        if path not in self.states:
            try:
                if self.behind_link(path):
                    raise OSError(errno.ELOOP, "its path leads through a link", path)
                self.states[path] = State(*read_index(self.folder / path, slots))
            except OSError:
                self.states[path] = None
        return self.states[path]

    def behind_link(self, path: str) -> bool:
        """Return True if a path leads through a link, so that its file is foreign."""
        return bool(self.linked) and any(path[:at] in self.linked for at, letter in enumerate(path) if letter == "/")

    def odd(self, path: str, slots: int) -> bool:
        """Return True if a finished shard is missing, has another size or a damaged index."""
        shard, state = self.journal.shards.get(path), self.state(path, slots)
        if shard is None or not shard.size:
            return False
        return state is None or state.size != shard.size or state.index is None

    def all_at(self, path: str, slots: int, slot: Array, parts: Sequence[str], offset: Array, size: Array) -> Array:
        """Return the offsets of many chunks in their shard, from their slots and the places to which they were written;
        -1 if journal and index disagree about a chunk.
        """
        shard, state = self.journal.shards.get(path), self.state(path, slots)
        if shard is None or state is None or state.size != shard.size or not isinstance(state.index, Index):
            return np.full(len(slot), -1)
        at, there = shard.all_at(parts, offset, size), state.index.index[slot].astype(np.int64)
        return np.where((there[:, 0] == at) & (there[:, 1] == size), at, -1)

    def find(self, written: WrittenChunk, slots: int, fresh: bool = False) -> ChunkPlace | None:
        """Return the place of the bytes of a chunk; ``fresh``: read and check them in any case."""
        state, shard = self.state(written.path, slots), self.journal.shards.get(written.path)
        if self.behind_link(written.path):
            return None
        if shard is not None and state is not None:
            at = shard.at(written)
            if at is not None:
                place = ChunkPlace(written.path, at, written.size, written.digest)
                known = (
                    state.size == shard.size
                    and state.index is not None
                    and state.index.get(written.slot) == (at, written.size)
                )
                if (known and not fresh and not shard.fresh) or holds(self.folder, place):
                    return place
        # Not in the shard as journalled. An interrupted run leaves its chunks in a part:
        place = ChunkPlace(part_path(written), written.offset, written.size, written.digest)
        if holds(self.folder, place):
            return place
        # the part was renamed to its shard, and the journal line for that is missing
        if state is not None and state.index is not None and written.slot in state.index:
            offset, size = state.index[written.slot]
            place = ChunkPlace(written.path, offset, size, written.digest)
            if size == written.size and holds(self.folder, place):
                return place
        return None
