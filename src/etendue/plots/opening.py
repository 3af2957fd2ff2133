"""The folder of an archive as a tree, held against what vouches for it.

In:  a folder.
Out: an ``xarray.DataTree``, lazy.
"""

from __future__ import annotations

from pathlib import Path

import xarray

from etendue.archive.describe import describe_archive
from etendue.errors import ArchiveInUse


def opened(folder: Path) -> xarray.DataTree:
    """Open an archive for reading.

    Raises
    ------
    ArchiveError
        It is none, or it is damaged.
    ArchiveInUse
        A run is writing to it.
    """
    if describe_archive(folder)["running"]:
        raise ArchiveInUse(f"{folder}: a run is writing to it; draw when it has ended (how far it is: etendue show {folder})")
    return xarray.open_datatree(folder / "data.zarr", engine="zarr")
