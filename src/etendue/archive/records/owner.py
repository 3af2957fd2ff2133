"""Ownership of an archive: its lock, and the run named in ``run.id``, so that workers of an ended run stop.

In:  the folder of an archive, or the content of the file.
Out: whether a run owns it; a checksummed name for a run, which shows whether the file was changed. Also registers the
action that follows a run in that folder: none, or the upload to an object store.
"""

from __future__ import annotations

import fcntl
import os
import time
import uuid
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from etendue import plain_files
from etendue.errors import ArchiveError, ArchiveInUse

ABANDONED = "abandoned"  # replaces the owner's name if a stage did not end when the run was interrupted


class Behind:
    """Callbacks of the owner of a run; this base class does nothing and serves a folder that is only read.

    Attributes
    ----------
    running : whether a run is writing to the store now, according to the store itself
    """

    def __init__(self, running: bool = False) -> None:
        self.running = running

    def own(self) -> None:
        """Called before the first change; afterwards no other process writes. It may refuse by raising an error."""

    def begun(self) -> None:
        """Called when everything known before computing has been written."""

    def sealed(self, paths: Iterable[str]) -> None:
        """Called when these shards are complete. It may raise an earlier error of a background thread."""


NOBODY = Behind()
_known: dict[Path, Behind] = {}


def behind(folder: Path) -> Behind:
    return _known.get(folder, NOBODY)


def stand(folder: Path, who: Behind | None) -> None:
    """Register the callbacks for a folder; None removes them."""
    if who is None:
        _known.pop(folder, None)
    else:
        _known[folder] = who


def fresh_id() -> str:
    """Return a unique name for a run, followed by its checksum."""
    name = uuid.uuid4().hex
    return f"{name}{zlib.crc32(name.encode()):08x}"


def is_id(text: bytes) -> bool:
    """Return True if the content of ``run.id`` has the form that a run writes; early versions wrote no checksum."""
    return (
        text == ABANDONED.encode()
        or len(text) == 32
        or (len(text) == 40 and text[32:] == f"{zlib.crc32(text[:32]):08x}".encode())
    )


def take(lock: int) -> None:
    """Lock an archive. Retries briefly, because ``is_running`` of another process holds the lock for an instant.

    Raises
    ------
    BlockingIOError
        Another process owns the archive.
    """
    for _ in range(20):
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            time.sleep(0.005)
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_running(folder: Path) -> bool:
    """Return True if a run owns the archive now."""
    if behind(folder).running:
        return True
    try:
        handle = os.open(folder / "lock", os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    except BlockingIOError:
        return True
    finally:
        os.close(handle)


def owner_of(folder: Path) -> bytes:
    """Return the content of ``run.id``: the name of the last run that has written to the archive."""
    try:
        return plain_files.content(folder / "run.id", 4096, links=False)
    except (OSError, ValueError):
        return b""


def is_written(folder: Path, before: bytes) -> bool:
    """Return True if a run owns the archive now, or has owned it since ``before`` was read."""
    return is_running(folder) or owner_of(folder) != before


@contextmanager
def unless_written(folder: Path) -> Iterator[None]:
    """While a run is replacing cells, a reader sees chunks that are missing: report these as work in progress, not as
    damage.

    Raises
    ------
    ArchiveInUse
        A run is writing to the archive, or has begun since; raised instead of another ``ArchiveError``.
    """
    before = owner_of(folder)
    try:
        yield
    except ArchiveInUse:
        raise
    except ArchiveError as error:
        if is_written(folder, before):
            raise ArchiveInUse(f"{folder} is being written by a run; try again after it has ended ({error})") from None
        raise
