"""The folder of an archive as a tree, verified against its checksums.

In:  the folder of a run that is finished, interrupted or in progress.
Out: an ``xarray.DataTree``, lazy, with the measured errors; reading lost data is an error, never a fill value.
"""

from __future__ import annotations

from pathlib import Path

import xarray

from etendue.archive.checks.describe import checked
from etendue.archive.read.vouched.verified_store import open_archive
from etendue.archive.records.remembered import ANSWER, latest
from etendue.present.plots.stated import stated


def opened(folder: Path) -> xarray.DataTree:
    """Open an archive for reading.

    Raises
    ------
    ArchiveError
        The folder is not an archive, nothing in it can be read yet, or it is damaged; the message states a remedy.
    """
    return stated(open_archive(folder, checked(folder).journal), latest(folder, ANSWER))
