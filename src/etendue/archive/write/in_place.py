"""Compact an archive in place, such that one complete archive exists at every instant.

In:  the folder of an archive whose last run ended normally.
Out: the same cells, with sorted axes and the shards of a new sweep; nothing is written if nothing would change.

The new archive is built beside the old one, shard by shard; shards that need no change are hard links. Then the system
exchanges the two folders atomically, and the old archive is removed. If the command is killed at any instant, running
it again continues with the existing files.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

from etendue import interrupts
from etendue.archive.read.reading import open_archive
from etendue.archive.records import disk
from etendue.archive.records.folders import link_at
from etendue.archive.records.manifest import DATA
from etendue.archive.records.names import aside_of
from etendue.archive.write.compact import check_in_order, locked
from etendue.archive.write.rewriting import Anew, Compacted
from etendue.errors import ArchiveError, MachineError

AT_HERE, EXCHANGE = -100, 2  # AT_FDCWD; RENAME_EXCHANGE of Linux, and RENAME_SWAP of macOS


def compact_in_place(folder: Path) -> Compacted:
    """Compact an archive in place. If interrupted by a signal, it leaves no files beside the archive.

    Raises
    ------
    ArchiveError
        The folder is not an archive, the archive is unfinished or damaged, or its file system cannot exchange two
        folders.
    ArchiveInUse
        A run is writing to the archive.
    MachineError
        The disk has too little free space.
    """
    open_archive(folder)
    with interrupts.held():
        return _exchanged(folder.resolve())


def _exchanged(folder: Path) -> Compacted:
    aside = aside_of(folder)
    locks = [locked(folder, fcntl.LOCK_EX)]
    try:
        archive = open_archive(folder)
        check_in_order(folder, archive)
        # through a link, the new archive would be written somewhere else, perhaps on another file system
        if aside.is_symlink():
            raise link_at(aside.parent, aside.name)
        anew = Anew(archive, aside, shares=True)
        needed = anew.needed()
        if not needed and not anew.changed():
            shutil.rmtree(aside, ignore_errors=True)
            size = sum(chunk.written.size for cell in archive.cells.values() for chunk in cell.chunks)
            return Compacted(folder, len(archive.cells), len(anew.shards), size, {})
        try:
            _clear(aside, set(anew.shards))
            free = shutil.disk_usage(folder).free
            if needed > free:
                raise MachineError(
                    f"{folder}: compacting needs {needed / 1e9:.2g} GB on the same disk, but only {free / 1e9:.2g} GB "
                    "are free"
                )
            done = anew.write()
            # the lock moves with the folder: a run that starts right after the exchange finds it in use
            locks.append(locked(aside, fcntl.LOCK_EX))
            _sync(aside)
            interrupts.check()
            exchange(folder, aside)
            # Without this, a power cut could undo the exchange after the old archive has been removed.
            disk.sync_folder(folder.parent)
        finally:  # also on interruption: what is aside is either the unfinished new archive or the replaced old one
            shutil.rmtree(aside, ignore_errors=True)
    finally:
        for lock in locks:
            os.close(lock)
    return replace(done, folder=folder)


def _clear(aside: Path, shards: set[str]) -> None:
    """Remove everything that an interrupted attempt has left, except shards that can be reused."""
    aside.mkdir(exist_ok=True)
    for entry in list(aside.iterdir()):
        if entry.name == DATA and entry.is_dir() and not entry.is_symlink():
            for path in [path for path in entry.rglob("*") if not path.is_dir() or path.is_symlink()]:
                if path.relative_to(aside).as_posix() not in shards:
                    path.unlink()
        elif entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def _sync(folder: Path) -> None:
    """Sync all folders, so that the names in them survive a power cut."""
    for place, _, _ in os.walk(folder):
        disk.sync_folder(Path(place))


def exchange(one: Path, other: Path) -> None:
    """Exchange two folders atomically.

    Raises
    ------
    ArchiveError
        The system or the file system does not support it.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(one), os.fsencode(other)
    if sys.platform == "darwin":
        failed = libc.renamex_np(*names, EXCHANGE)
    elif hasattr(libc, "renameat2"):
        failed = libc.renameat2(AT_HERE, names[0], AT_HERE, names[1], EXCHANGE)
    else:
        failed = -1
    if failed:
        why = os.strerror(ctypes.get_errno())
        raise ArchiveError(
            f"{one}: its file system cannot exchange two folders ({why}); compact it to another folder: "
            f"etendue compact {one} NEW"
        )
