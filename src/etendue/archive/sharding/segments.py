"""Parts: shards in the making. Every process appends what it computes to files of its own beside the shards' places.

In:  encoded chunks, the shard each belongs to.
Out: where they were put. The owner of the run makes shards of parts (``shards.put_shard``); no byte is copied where one
     process
wrote all of a shard.

The threads of a process share its parts. Small chunks are gathered and written together, at the latest when a batch
ends (``settle``). A part that the owner has taken is left alone: its size is no longer what was written here, and a new
one is begun.
"""

from __future__ import annotations

import fcntl
import os
import threading
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from etendue import plain_files
from etendue.archive.records import disk
from etendue.errors import ArchiveInUse

GATHERED = 32 << 10  # chunks below this size are gathered
MOST_GATHERED = 1 << 20
HANDLES = 128  # open files; the one that was used least recently is closed first


class Taken(Exception):
    """The owner of the run has made a shard of this part, or removed it."""


class ShardSegment:
    """One unfinished file of a shard, which this process alone appends to."""

    def __init__(self, root: str, path: str, durable: bool) -> None:
        folder, _, name = path.rpartition("/")
        self.root, self.durable = root, durable
        self.name = os.urandom(6).hex()
        self.path = f"{folder}/.{name}.{self.name}{disk.PART}"
        self.written = self.synced = 0  # bytes in the file
        self.waiting = bytearray()
        self.handle: int | None = None
        self.begun = False
        self.lock = threading.Lock()

    def append(self, pieces: Sequence[Any], size: int) -> int:
        """Put a chunk behind the others; gives its offset.

        Raises
        ------
        Taken
            Nothing more may be appended.
        """
        with self.lock:
            if size < GATHERED:
                if not self.waiting:
                    self._ours()
                offset = self.written + len(self.waiting)
                for piece in pieces:
                    self.waiting += memoryview(piece).cast("B")
                if len(self.waiting) >= MOST_GATHERED:
                    self._flush()
                return offset
            self._flush()
            offset = self.written
            self._put(pieces, size)
            return offset

    def settle(self) -> None:
        """What was appended stands in the file; with ``durable`` it also survives a power cut."""
        with self.lock:
            self._flush()
            if self.durable and self.synced < self.written:
                os.fsync(self._open())
                self.synced = self.written

    def settled(self) -> bool:
        """Whether nothing is left to be settled."""
        return not self.waiting and not (self.durable and self.synced < self.written)

    def flush(self) -> None:
        """What was appended stands in the file."""
        with self.lock:
            self._flush()

    def rest(self) -> None:
        """Let go of the open file for now."""
        with self.lock:
            if self.handle is not None:
                os.close(self.handle)
                self.handle = None

    def _open(self) -> int:
        if self.handle is None:
            try:
                self.handle = (
                    disk.open_own(self.root, self.path)
                    if self.begun
                    else disk.create(self.root, self.path, self.durable)
                )
            except FileNotFoundError:
                raise Taken from None
            self.begun = True
        return self.handle

    def _ours(self) -> None:
        state = os.fstat(self._open())
        if state.st_size != self.written or not state.st_nlink:
            raise Taken

    def _flush(self) -> None:
        if self.waiting:
            self._put([bytes(self.waiting)], len(self.waiting))
            self.waiting.clear()

    def _put(self, pieces: Sequence[Any], size: int) -> None:
        handle = self._open()
        fcntl.flock(handle, fcntl.LOCK_SH)  # not while the owner makes a shard of it
        try:
            self._ours()
            try:
                disk.write_at(handle, pieces, self.written)
            except OSError:
                os.ftruncate(handle, self.written)
                raise
            self.written += size
        finally:
            fcntl.flock(handle, fcntl.LOCK_UN)


class Parts:
    """The parts of this process, of one run at a time in each archive."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.open: dict[tuple[str, str], ShardSegment] = {}
        self.handles: OrderedDict[tuple[str, str], ShardSegment] = OrderedDict()
        self.runs: dict[str, str] = {}  # by archive: whose parts these are
        self.unsettled: dict[str, dict[str, ShardSegment]] = {}

    def append(
        self, root: str, run_id: str, path: str, pieces: Sequence[Any], size: int, durable: bool
    ) -> tuple[str, int]:
        """Append a chunk of a shard; gives the name of the part, and the offset in it.

        Raises
        ------
        ArchiveInUse
            The archive belongs to another run.
        """
        while True:
            part = self._part(root, run_id, path, durable)
            try:
                offset = part.append(pieces, size)
            except Taken:
                if part.waiting:
                    raise ArchiveInUse(
                        f"{root}: what another batch has written of {path} is in its place already; run again"
                    ) from None
                self._drop(root, path, part)
                continue
            with self.lock:  # behind the bytes: another thread may be settling
                self.unsettled.setdefault(root, {})[part.name] = part
            return part.name, offset

    def settle(self, root: str, run_id: str) -> None:
        """Whatever the threads of this process have appended stands in its files.

        A part is on the list until it is settled: a thread that finds nothing left of its own may tell of its cells,
        and the owner makes a shard of them.
        """
        check_owner(root, run_id)
        with self.lock:
            parts = list(self.unsettled.get(root, {}).values())
        for part in parts:
            try:
                part.settle()
            except Taken:
                raise ArchiveInUse(f"{root} belongs to another run now; this one stops") from None
            with self.lock:
                if part.settled():  # no other thread has appended to it since
                    self.unsettled.get(root, {}).pop(part.name, None)

    def flush(self, root: str) -> None:
        """What was appended can be read, by whoever opens its file."""
        with self.lock:
            parts = list(self.unsettled.get(root, {}).values())
        for part in parts:
            part.flush()

    def close(self, root: str) -> None:
        """Let go of everything of an archive: its run has ended."""
        with self.lock:
            self._forget(root)

    def _part(self, root: str, run_id: str, path: str, durable: bool) -> ShardSegment:
        with self.lock:
            if self.runs.get(root) != run_id:
                check_owner(root, run_id)
                self._forget(root)
                self.runs[root] = run_id
            part = self.open.get((root, path))
            if part is None:
                part = self.open[root, path] = ShardSegment(root, path, durable)
            self.handles[root, path] = part
            self.handles.move_to_end((root, path))
            if len(self.handles) > HANDLES:
                self.handles.popitem(last=False)[1].rest()
            return part

    def _drop(self, root: str, path: str, part: ShardSegment) -> None:
        with self.lock:
            if self.open.get((root, path)) is part:
                del self.open[root, path]
                self.handles.pop((root, path), None)
            self.unsettled.get(root, {}).pop(part.name, None)
        part.rest()

    def _forget(self, root: str) -> None:
        for key in [key for key in self.open if key[0] == root]:
            self.open.pop(key).rest()
            self.handles.pop(key, None)
        self.unsettled.pop(root, None)
        self.runs.pop(root, None)


def check_owner(root: str, run_id: str) -> None:
    """Refuse to go on where the archive has another owner."""
    try:
        owner = plain_files.content(Path(root) / "run.id", 4096, links=False)
    except FileNotFoundError:
        owner = b""
    if owner != run_id.encode():
        raise ArchiveInUse(f"{root} belongs to another run now; this one stops")


PARTS = Parts()
