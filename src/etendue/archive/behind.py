"""What stands behind the folder of an archive: nothing, or an object store that is told what becomes of the folder.

In:  the folder.
Out: whoever is to be told; nobody where the folder is the archive.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


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
