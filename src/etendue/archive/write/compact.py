"""An archive written anew: axes sorted, shards cut as for a fresh sweep, every chunk with the bytes it has.

In:  the folder of an archive whose last run has ended in order, of this form or with a file for every chunk.
Out: another archive beside it, whole or not at all. The old one is only read.

Each chunk is held against its checksum on the way. What somebody else has put into the store is copied as it is.
``in_place`` puts the new one where the old one is: what is as it should be already is shared by both for that while,
and not written.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from dataclasses import replace
from pathlib import Path

from etendue import interrupts
from etendue.archive.read.reading import StoredArchive, open_archive
from etendue.archive.records import disk
from etendue.archive.records.manifest import read_manifest
from etendue.archive.write.rewriting import Anew, Compacted
from etendue.errors import ArchiveError, ArchiveInUse

ASIDE = ".compact.partial"


def compact(old: Path, new: Path) -> Compacted:
    """Write an archive anew.

    Raises
    ------
    ArchiveError
        The old one is none, is unfinished or damaged; something stands in the place of the new one.
    ArchiveInUse
        A run is writing to it.
    """
    old, aside = old.resolve(), new.parent.resolve() / f".{new.name}{ASIDE}"
    if new.exists() or new.is_symlink():
        raise ArchiveError(f"{new} exists; name a new folder for the archive that is to be written")
    open_archive(old)
    lock = locked(old, fcntl.LOCK_SH)
    try:
        archive = open_archive(old)
        check_in_order(old, archive)
        if aside.is_symlink():
            raise disk.link_at(aside.parent, aside.name)
        shutil.rmtree(aside, ignore_errors=True)  # of an earlier attempt that was killed
        aside.mkdir()
        try:
            with interrupts.held():
                done = Anew(archive, aside).write()
            aside.rename(new)
        except BaseException:
            shutil.rmtree(aside, ignore_errors=True)
            raise
    finally:
        os.close(lock)
    return replace(done, folder=new)


def aside_of(folder: Path) -> Path:
    """Where an archive is written anew: beside its place."""
    whole = folder.resolve()
    return whole.with_name(f".{whole.name}{ASIDE}")


def left_by_compact(folder: Path) -> str:
    """The folder in which one that was killed has begun another archive in the place of this one; '' where there is
    none.
    """
    aside = aside_of(folder)
    return str(aside) if aside.is_dir() and not aside.is_symlink() else ""


def locked(folder: Path, how: int) -> int:
    """The open lock of an archive that nobody is writing to."""
    lock = os.open(folder / "lock", os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(lock, how | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise ArchiveInUse(f"{folder} is in use; write it anew when that has ended") from None
    return lock


def check_in_order(old: Path, archive: StoredArchive) -> None:
    manifest = read_manifest(old)
    changed = ["manifest.json"] if manifest is None else manifest.changed(old)
    lost = {chunk.group for cell in archive.cells.values() for chunk in cell.chunks} - archive.journal.axes.keys()
    if changed or lost or archive.journal.damaged or archive.journal.torn:
        raise ArchiveError(
            f"{old / (changed or ['journal.jsonl'])[0]} is missing or not as a run left it: only an archive in order "
            f"is written anew. "
            f"Run its pipeline on it first"
        )
