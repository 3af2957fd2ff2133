"""Parts: unfinished shards. Every process appends its chunks to its own part files, next to the places of the shards.

In:  encoded chunks, and the shard each belongs to.
Out: the places of the chunks. The owner of the run turns parts into shards (``shards.put_shard``); no byte is copied if
     one process wrote the whole shard.

All threads of a process append to the same parts. Small chunks are collected without copying and written together by
one vectored write, at the latest when a batch ends (``settle``). A process never appends to a part that the owner has
taken: it notices that the size of the file differs from the size that it wrote, and starts a new part.
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

GATHERED = 96 << 10  # chunks below this many bytes are collected before they are written
MOST_GATHERED = 1 << 20
MOST_PIECES = 1000  # of one vectored write; Linux takes 1024
HANDLES = 128  # open files; the least recently used one is closed first


class Taken(Exception):
    """The owner of the run has turned this part into a shard, or removed it."""


class ShardSegment:
    """One unfinished file of a shard; only this process appends to it."""

    def __init__(self, root: str, path: str, durable: bool) -> None:
        folder, _, name = path.rpartition("/")
        self.root, self.durable = root, durable
        self.name = os.urandom(6).hex()
        self.path = f"{folder}/.{name}.{self.name}{disk.PART}"
        self.written = self.synced = 0  # bytes in the file
        self.waiting: list[Any] = []  # pieces that are not in the file yet, and their bytes
        self.gathered = 0
        self.handle: int | None = None
        self.begun = False
        self.lock = threading.Lock()

    def append(self, pieces: Sequence[Any], size: int) -> int:
        """Append a chunk; return its offset. The pieces must not change until they are written.

        Raises
        ------
        Taken
            The owner of the run has turned this part into a shard or removed it, so that nothing more may be appended.
        """
        with self.lock:
            if size < GATHERED:
                # The offset returned below is valid only in a part that the owner has not taken. One check per batch is
                # enough, because `_put` checks again when the batch is written.
                if not self.waiting:
                    self._ours()
                offset = self.written + self.gathered
                self.waiting += pieces
                self.gathered += size
                if self.gathered >= MOST_GATHERED or len(self.waiting) >= MOST_PIECES:
                    self._flush()
                return offset
            self._flush()
            offset = self.written
            self._put(pieces, size)
            return offset

    def settle(self) -> None:
        """Write everything appended to the file; with ``durable`` it also survives a power cut."""
        with self.lock:
            self._flush()
            if self.durable and self.synced < self.written:
                os.fsync(self._open())
                self.synced = self.written

    def settled(self) -> bool:
        """Return True if everything appended is in the file and, with ``durable``, synced."""
        return not self.waiting and not (self.durable and self.synced < self.written)

    def flush(self) -> None:
        """Write everything appended to the file."""
        with self.lock:
            self._flush()

    def rest(self) -> None:
        """Close the file handle until it is needed again."""
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
        # A part that has become a shard is longer by its index; a part that was removed has no name left.
        state = os.fstat(self._open())
        if state.st_size != self.written or not state.st_nlink:
            raise Taken

    def _flush(self) -> None:
        if self.waiting:
            self._put(self.waiting, self.gathered)
            self.waiting, self.gathered = [], 0

    def _put(self, pieces: Sequence[Any], size: int) -> None:
        handle = self._open()
        fcntl.flock(handle, fcntl.LOCK_SH)  # so that the owner does not turn the part into a shard meanwhile
        try:
            self._ours()
            try:
                disk.write_at(handle, pieces, self.written)
            except OSError:
                # Remove the bytes of the incomplete write, because the offset of the next chunk counts from
                # ``written``.
                os.ftruncate(handle, self.written)
                raise
            self.written += size
        finally:
            fcntl.flock(handle, fcntl.LOCK_UN)


class Parts:
    """The parts of this process, for one run at a time in each archive."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.open: dict[tuple[str, str], ShardSegment] = {}
        self.handles: OrderedDict[tuple[str, str], ShardSegment] = OrderedDict()
        self.runs: dict[str, str] = {}  # by archive: the run these parts belong to
        self.unsettled: dict[str, dict[str, ShardSegment]] = {}

    def append(
        self, root: str, run_id: str, path: str, pieces: Sequence[Any], size: int, durable: bool
    ) -> tuple[str, int]:
        """Append a chunk of a shard; return the name of the part and the offset in it.

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
                    raise ArchiveInUse(f"{root}: {path} already contains results of another batch; run again") from None
                self._drop(root, path, part)
                continue
            with self.lock:  # after the bytes are taken: another thread may be settling
                self.unsettled.setdefault(root, {})[part.name] = part
            return part.name, offset

    def settle(self, root: str, run_id: str) -> None:
        """Write all chunks that the threads of this process have appended.

        A part stays in the list until its chunks are written. A thread that no longer finds its part there reports its
        cells as finished, and the owner makes a shard of their chunks.
        """
        check_owner(root, run_id)
        with self.lock:
            parts = list(self.unsettled.get(root, {}).values())
        for part in parts:
            try:
                part.settle()
            except Taken:
                raise ArchiveInUse(f"{root} now belongs to another run; this run stops") from None
            with self.lock:
                if part.settled():  # no other thread has appended to it since
                    self.unsettled.get(root, {}).pop(part.name, None)

    def flush(self, root: str) -> None:
        """Flush appended chunks, so that other processes can read them from the file."""
        with self.lock:
            parts = list(self.unsettled.get(root, {}).values())
        for part in parts:
            part.flush()

    def close(self, root: str) -> None:
        """Release everything held for an archive whose run has ended."""
        with self.lock:
            self._forget(root)

    def _part(self, root: str, run_id: str, path: str, durable: bool) -> ShardSegment:
        known = self.open.get((root, path)) if self.runs.get(root) == run_id else None
        if known is not None and known.handle is not None and len(self.handles) < HANDLES:
            return known  # which handle was used last matters only where some have to be closed
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
    """Raise ``ArchiveInUse`` if the archive has another owner."""
    try:
        owner = plain_files.content(Path(root) / "run.id", 4096, links=False)
    except FileNotFoundError:
        owner = b""
    if owner != run_id.encode():
        raise ArchiveInUse(f"{root} now belongs to another run; this run stops")


PARTS = Parts()
