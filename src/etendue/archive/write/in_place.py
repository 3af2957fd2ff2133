"""An archive written anew in its own place, so that at every instant one of the two is there, whole.

In:  the folder of an archive whose last run has ended in order.
Out: the same cells, axes sorted, shards as of a fresh sweep; nothing is written where nothing would change.

The new one is made beside the old one, shard by shard; what is right already is no more than a second name. Then the
system exchanges the two folders in one step, and what was the old one is removed. Killed at any instant, the same
command goes on with what is there.
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
from etendue.archive.records.manifest import DATA
from etendue.archive.write.compact import aside_of, check_in_order, locked
from etendue.archive.write.rewriting import Anew, Compacted
from etendue.errors import ArchiveError, MachineError

AT_HERE, EXCHANGE = -100, 2  # AT_FDCWD; RENAME_EXCHANGE of Linux, and RENAME_SWAP of macOS


def compact_in_place(folder: Path) -> Compacted:
    """Write an archive anew where it is. Interrupted by a signal it leaves nothing beside it.

    Raises
    ------
    ArchiveError
        It is none, is unfinished or damaged; its file system cannot exchange two folders.
    ArchiveInUse
        Somebody is writing to it.
    MachineError
        The disk has no room for what is to be written.
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
        if aside.is_symlink():
            raise disk.link_at(aside.parent, aside.name)
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
                    f"{folder}: {needed / 1e9:.2g} GB are written anew beside it, and {free / 1e9:.2g} GB are free"
                )
            done = anew.write()
            locks.append(locked(aside, fcntl.LOCK_EX))  # whoever comes between finds it in use
            _sync(aside)
            interrupts.check()
            exchange(folder, aside)
            disk.sync_folder(folder.parent)
        finally:  # also where somebody interrupts it: what stands aside is not yet the new one, or no more the old one
            shutil.rmtree(aside, ignore_errors=True)
    finally:
        for lock in locks:
            os.close(lock)
    return replace(done, folder=folder)


def _clear(aside: Path, shards: set[str]) -> None:
    """Leave of an attempt that was broken off, or of the archive that was here before, the shards that may be of
    use.
    """
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
    """The names in all folders survive the loss of power."""
    for place, _, _ in os.walk(folder):
        disk.sync_folder(Path(place))


def exchange(one: Path, other: Path) -> None:
    """Two folders change places, in one step.

    Raises
    ------
    ArchiveError
        The system or the file system cannot.
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
            f"{one}: its file system cannot exchange two folders ({why}); write it elsewhere: etendue compact {one} NEW"
        )
