"""The folder of an archive as a tree, held against what vouches for it.

In:  a folder: of a run that has ended, was broken off, or goes on.
Out: an ``xarray.DataTree``, lazy; what is lost is an error when it is read, and no fill value.
"""

from __future__ import annotations

from pathlib import Path

import xarray

from etendue.archive.checks.describe import describe_archive
from etendue.archive.read.verified_store import open_archive


def opened(folder: Path) -> xarray.DataTree:
    """Open an archive for reading.

    Raises
    ------
    ArchiveError
        It is none, nothing of it can be read yet, or it is damaged: what is, and what to do.
    """
    describe_archive(folder)
    return open_archive(folder)
