"""Check that every byte of an archive is as its runs wrote it. Everything is read, nothing is changed, and no stage is
loaded.

In:  the folder of an archive.
Out: ``Verified``: the damage by file, array and cell; foreign files; bytes and seconds.
"""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

from etendue import plain_files
from etendue.archive.checks.left_out import left_out_damage
from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.journaling.journal import Read
from etendue.archive.read.inspection import Damage, Inspection, Told, Verified
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.manifest import NAME as MANIFEST
from etendue.archive.records.names import left_by_compact
from etendue.archive.records.owner import is_running, is_written, owner_of
from etendue.errors import ArchiveError, ArchiveInUse
from etendue.types.documents import Document

STRAYS = "strays"  # folder into which a repair moves files that do not belong to an archive


def verify(folder: Path, told: Told = lambda done, total: None, journal: Read | None = None) -> Verified:
    """Read an archive and report everything that differs from what was written.

    ``told``: called with the number of bytes read and the total; ``journal``: the journal, if it has been read already.

    Raises
    ------
    ArchiveError
        The folder is not an archive.
    ArchiveInUse
        A run is writing to it.
    """
    began, found = time.perf_counter(), Verified(folder)
    if not any((folder / name).exists() for name in (DATA, JOURNAL, MANIFEST)) or not folder.is_dir():
        raise ArchiveError(f"{folder} is not an archive of etendue ({disk.lacks(folder, DATA + ' and no ' + JOURNAL)})")
    if is_running(folder):
        raise ArchiveInUse(f"{folder}: a run is writing to it; verify it after the run has ended")
    before, odd = owner_of(folder), dict[str, str]()
    listing = disk.Listing(folder, odd)
    found.damages += [Damage("odd", path, what) for path, what in odd.items()]
    if DATA in odd or not (folder / DATA).is_dir():
        found.damages += [Damage("missing", DATA, "missing")] if DATA not in odd else []
        return found
    if not (folder / JOURNAL).is_file():
        found.damages += (
            [Damage("missing", JOURNAL, "missing: the cells it named must be recomputed")] if JOURNAL not in odd else []
        )
    look = Inspection(folder, listing, found, told, set(odd), journal)
    parts = (look.manifest, look.journal, look.metadata, look.chunks, lambda: left_out_damage(look.stored))
    for part in (*parts, look.inputs, look.records, look.small_files, look.added, look.beside):
        found.damages += [damage for damage in part() if damage.cell or damage.path not in odd]
    found.damages = list(dict.fromkeys(found.damages))
    if found.damages and is_written(folder, before):
        raise ArchiveInUse(f"{folder} is being written by a run that just started; verify it after the run has ended")
    found.partial = left_by_compact(folder)
    found.seconds = time.perf_counter() - began
    return found


def sha256_of(folder: Path) -> str:
    """Return one digest over the paths and contents of all files of an archive except ``lock`` and ``run.id``. A copy
    has the same digest.

    Raises
    ------
    ArchiveError
        The archive contains something other than regular files.
    """
    listing, found = disk.Listing(folder), hashlib.sha256()
    beside = [name for name in disk.FILES if name not in ("lock", "run.id") and (folder / name).is_file()]
    for path in sorted([*beside, *(path for name in disk.FOLDERS for path in listing.below(name))]):
        found.update(f"{path} {plain_files.sha256(folder / path, None, links=False)}\n".encode())
    return found.hexdigest()


def document(found: Verified) -> Document:
    """Return the result as the document that ``--json`` prints."""
    return {
        "archive": str(found.folder),
        "whole": found.whole,
        "damages": [{name: value or None for name, value in vars(damage).items()} for damage in found.damages],
        "cells_lost": list(found.lost),
        "beside": found.beside,
        "partial": found.partial or None,
        "cells": found.cells,
        "chunks": found.chunks,
        "bytes": found.bytes,
        "seconds": found.seconds,
        "bytes_per_second": found.bytes / found.seconds if found.seconds else None,
    }
