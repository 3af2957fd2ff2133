"""Where stored chunks lie: what the journal says, held against the sizes and indexes of the files.

In:  the folder of an archive, its journal.
Out: the place of a chunk, or None where it is lost.

After a run that ended in order no chunk is read: the size of a shard is that of the journal, and its index names the
same place. What was written since, and what lies in a shard that is not as the journal says, is read back and held
against its digest; so one flipped bit of an index costs no cell.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from etendue.archive.sharding.shards import ChunkPlace, Shard, holds, part_path, read_index
from etendue.contract.ports import WrittenChunk


class Journalled(Protocol):
    """A journal, open or only read."""

    shards: dict[str, Shard]


@dataclass(frozen=True)
class State:
    """A shard as it is on disk; its index is None where it is damaged."""

    size: int
    index: Mapping[int, tuple[int, int]] | None


class Finder:
    """Looks at every shard once."""

    def __init__(self, folder: Path, journal: Journalled, linked: frozenset[str] = frozenset()) -> None:
        self.folder, self.journal = folder, journal
        self.linked = linked  # paths of links in the place of folders: nothing behind them is read
        self.states: dict[str, State | None] = {}

    def state(self, path: str, slots: int) -> State | None:
        """A shard as it is; None where there is none."""
        if path not in self.states:
            try:
                if self.behind_link(path):
                    raise OSError(errno.ELOOP, "it lies behind a link", path)
                self.states[path] = State(*read_index(self.folder / path, slots))
            except OSError:
                self.states[path] = None
        return self.states[path]

    def behind_link(self, path: str) -> bool:
        """Whether a path leads through a link: its file is somebody else's."""
        return bool(self.linked) and any(path[:at] in self.linked for at, letter in enumerate(path) if letter == "/")

    def odd(self, path: str, slots: int) -> bool:
        """Whether a shard that was put in its place is missing, has another size or a damaged index."""
        shard, state = self.journal.shards.get(path), self.state(path, slots)
        if shard is None or not shard.size:
            return False
        return state is None or state.size != shard.size or state.index is None

    def find(self, written: WrittenChunk, slots: int, fresh: bool = False) -> ChunkPlace | None:
        """Where the bytes of a chunk are; ``fresh``: they are read, whatever stands around them."""
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
        place = ChunkPlace(part_path(written), written.offset, written.size, written.digest)
        if holds(self.folder, place):
            return place
        if (
            state is not None and state.index is not None and written.slot in state.index
        ):  # it was renamed, and that is all
            offset, size = state.index[written.slot]
            place = ChunkPlace(written.path, offset, size, written.digest)
            if size == written.size and holds(self.folder, place):
                return place
        return None
