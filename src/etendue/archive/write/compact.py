"""Rewrite an archive: axes sorted, shards cut as for a new sweep, every chunk with the same bytes.

In:  the folder of an archive whose last run ended normally, in this format or with one file per chunk.
Out: another archive beside it, complete or absent. The old archive is only read.

Each chunk is checked against its checksum on the way. Groups and arrays in the store that no run has written are copied
unchanged. ``in_place`` replaces the old archive by the new one: shards that need no change are shared by both (hard
links) while it works, and not rewritten.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from dataclasses import replace
from pathlib import Path

from etendue import interrupts
from etendue.archive.read.reading import StoredArchive, open_archive
from etendue.archive.records.folders import link_at
from etendue.archive.records.manifest import read_manifest
from etendue.archive.records.names import COMPACTED
from etendue.archive.write.rewriting import Anew, Compacted
from etendue.errors import ArchiveError, ArchiveInUse


def compact(old: Path, new: Path) -> Compacted:
    """Rewrite an archive into a new folder.

    Raises
    ------
    ArchiveError
        The old folder is not an archive, or the archive is unfinished or damaged, or the new path exists.
    ArchiveInUse
        A run is writing to it.
    """
    old, aside = old.resolve(), new.parent.resolve() / f".{new.name}{COMPACTED}"
    if new.exists() or new.is_symlink():
        raise ArchiveError(f"{new} exists; give a new folder for the compacted archive")
    open_archive(old)
    lock = locked(old, fcntl.LOCK_SH)
    try:
        archive = open_archive(old)
        check_in_order(old, archive)
        if aside.is_symlink():
            raise link_at(aside.parent, aside.name)
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


def locked(folder: Path, how: int) -> int:
    """Return the open lock of an archive to which no run is writing."""
    lock = os.open(folder / "lock", os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(lock, how | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        raise ArchiveInUse(f"{folder} is in use; compact it after that run has ended") from None
    return lock


def check_in_order(old: Path, archive: StoredArchive) -> None:
    manifest = read_manifest(old)
    changed = ["manifest.json"] if manifest is None else manifest.changed(old)
    lost = {chunk.group for cell in archive.cells.values() for chunk in cell.chunks} - archive.journal.axes.keys()
    if changed or lost or archive.journal.damaged or archive.journal.torn:
        raise ArchiveError(
            f"{old / (changed or ['journal.jsonl'])[0]} is missing or damaged: only a complete archive "
            f"can be compacted. "
            f"Run its pipeline on it first"
        )
