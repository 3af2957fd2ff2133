"""Cells that are damaged are forgotten: the next run computes them, and nothing else.

In:  the folder of an archive, names of cells.
Out: lines in its journal. Their bytes stay where they are until the shards that hold them are made anew.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterable
from pathlib import Path

from etendue.archive.journal import Journal
from etendue.errors import ArchiveInUse


def forget(folder: Path, cells: Iterable[str], durable: bool = False) -> int:
    """Say of cells that they may be overwritten; gives how many of them were called done.

    Raises
    ------
    ArchiveInUse
        A run is writing to the archive.
    """
    lock = os.open(folder / "lock", os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ArchiveInUse(f"{folder} is in use by a run; mend it when that has ended") from None
        journal = Journal(folder, durable)
        done = [
            (cell, journal.entries[cell].key)
            for cell in cells
            if cell in journal.entries and journal.entries[cell].event == "done"
        ]
        if done:
            journal.open()
            try:
                journal.start(done)
            finally:
                journal.close()
        return len(done)
    finally:
        os.close(lock)
