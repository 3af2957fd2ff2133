"""The finished cells of an archive by key, which a session may read.

In:  the folder of an archive.
Out: the results stored under a key; arrays are read on demand and checked against the journal.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.archive.read.stored import Stored, StoredArrays
from etendue.archive.records.past_runs import latest_record
from etendue.archive.records.provenance import platform_record
from etendue.contract.ports import CellReport
from etendue.errors import ArchiveError

if TYPE_CHECKING:
    from etendue.types.arrays import Array


class ArchivedArrays(Mapping[str, "Array"]):
    """The arrays of one cell of an archive, each read once."""

    def __init__(self, cell: StoredArrays) -> None:
        self.cell, self.names, self.there = cell, tuple(cell.variables), dict[str, "Array"]()

    def __getitem__(self, name: str) -> Array:
        if name not in self.names:
            raise KeyError(name)
        if name not in self.there:
            array = self.cell.read(name)
            array.setflags(write=False)
            self.there[name] = array
        return self.there[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)


class ArchivedResults:
    """The cells that an archive had when it was opened.

    Raises
    ------
    ArchiveError
        There is no archive, or its cells were computed on another platform and may have other bits.
    """

    def __init__(self, folder: Path) -> None:
        self.stored = Stored(folder)
        record = latest_record(folder, self.stored.manifest)
        if record is None or record["platform"] != dict(platform_record()):
            raise ArchiveError(
                f"{folder} was computed on another platform, so bits may differ; a session reads only results "
                "of this platform. Omit archive="
            )
        # A left-out cell has the key of its input, which may be in the archive, too.
        self.names = {one.key: name for name, one in self.stored.finished.items() if one.status == "done"}

    def of(self, key: str) -> tuple[CellReport, ArchivedArrays] | None:
        """Return the report of a cell and its arrays; None if the archive has no cell with this key."""
        name = self.names.get(key)
        if name is None:
            return None
        entry = self.stored.finished[name]
        report = CellReport(
            name.split(" ")[0],
            (),
            entry.status,
            entry.seconds,
            clipped=entry.clipped,
            clipped_flux=entry.clipped_flux,
            floored=entry.floored,
        )
        return report, ArchivedArrays(self.stored.cell(name))
