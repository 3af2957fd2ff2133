"""Who owns an archive: its lock, and what stands in ``run.id``, so that the workers of a run that is over stop.

In:  the folder of an archive; nothing, or what is in the file.
Out: whether a run owns it; a name for a run, which tells whether it was changed since. Who stands behind the folder and
     is told what becomes of it: nobody, or an object store.
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

ABANDONED = "abandoned"  # in place of the owner's name: a stage did not end when the run was interrupted


class Behind:
    """Told by the owner of a run; as it stands, behind a folder that is only read.

    Attributes
    ----------
    running : whether a run writes to the store now, of whom only the store knows
    """

    def __init__(self, running: bool = False) -> None:
        self.running = running

    def own(self) -> None:
        """In front of the first change: from now on nobody else writes. May refuse."""

    def begun(self) -> None:
        """What is known before anything is computed stands in its place."""

    def sealed(self, paths: Iterable[str]) -> None:
        """These shards stand in their places. May raise what has gone wrong since."""


NOBODY = Behind()
_known: dict[Path, Behind] = {}


def behind(folder: Path) -> Behind:
    return _known.get(folder, NOBODY)


def stand(folder: Path, who: Behind | None) -> None:
    """Say who stands behind a folder; None: nobody any more."""
    if who is None:
        _known.pop(folder, None)
    else:
        _known[folder] = who


def fresh_id() -> str:
    """A name that no other run has, its checksum behind it."""
    name = uuid.uuid4().hex
    return f"{name}{zlib.crc32(name.encode()):08x}"


def is_id(text: bytes) -> bool:
    """Whether ``run.id`` holds what a run has written there; earlier ones wrote no checksum."""
    return (
        text == ABANDONED.encode()
        or len(text) == 32
        or (len(text) == 40 and text[32:] == f"{zlib.crc32(text[:32]):08x}".encode())
    )


def take(lock: int) -> None:
    """Own an archive. Who asks whether it has an owner (``is_running``) holds its lock for an instant: that is waited
    for.

    Raises
    ------
    BlockingIOError
        It has one.
    """
    for _ in range(20):
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            time.sleep(0.005)
    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)


def is_running(folder: Path) -> bool:
    """Whether a run owns an archive now."""
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
    """What is in ``run.id``: whoever has written to an archive last."""
    try:
        return plain_files.content(folder / "run.id", 4096, links=False)
    except (OSError, ValueError):
        return b""


def is_written(folder: Path, before: bytes) -> bool:
    """Whether a run owns an archive now, or has since ``before``."""
    return is_running(folder) or owner_of(folder) != before


@contextmanager
def unless_written(folder: Path) -> Iterator[None]:
    """What a reader finds lost while a run is replacing cells is under way, and not damaged.

    Raises
    ------
    ArchiveInUse
        In the place of another ``ArchiveError``, where a run writes to the archive, or has begun since.
    """
    before = owner_of(folder)
    try:
        yield
    except ArchiveInUse:
        raise
    except ArchiveError as error:
        if is_written(folder, before):
            raise ArchiveInUse(f"{folder} is being written by a run; look again when it has ended ({error})") from None
        raise
