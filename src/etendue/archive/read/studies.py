"""Groups of a study in the store of an archive, next to the groups of stages: its results, and the cells from which
they were computed.

In:  the folder of an archive, its journal.
Out: the stored studies, and the number of their cells whose results have changed since.

A study has its own group, with a group for each result; these groups name the cells from which the result was computed,
and their keys. A run does not change these groups. A result may therefore describe earlier cells, which a comparison of
the keys shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from etendue.archive.journaling.journal import NAME, Read, read
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.names import ROOT
from etendue.archive.structure.metadata import texts_of
from etendue.contract.values.names import STUDY
from etendue.errors import ArchiveError
from etendue.types.documents import Document

CELLS, KEYS = "cell", "cell_key"


@dataclass(frozen=True)
class StoredStudy:
    """One stored result of a study."""

    path: str  # of its group
    command: str
    attributes: Document
    cells: int
    other: int  # number of its cells that now have other results, or none
    since: int  # number of cells of the same stage that were finished later

    @property
    def stale(self) -> str:
        """The reason why the result does not describe the archive's present cells; '' if it does."""
        parts = [f"{self.other} of its {self.cells} cells have changed"] if self.other else []
        parts += [f"{self.since} cells were finished since"] if self.since else []
        return " and ".join(parts)


def finished_cells(folder: Path, stage: str, journal: Read | None = None) -> dict[str, str]:
    """Return the keys of the finished cells of a stage, by name of the cell."""
    entries = (journal or read(folder / NAME)).said
    names = (name for name in entries.done() if name.partition(" ")[0] == stage)
    return {name: entries[name].key for name in names}


def is_study(document: Document | None) -> bool:
    """Return True if the metadata of a group says that a study wrote it."""
    attributes = (document or {}).get("attributes")
    return isinstance(attributes, dict) and isinstance(attributes.get(STUDY), str)


def stored_studies(folder: Path, journal: Read | None = None) -> Iterator[StoredStudy]:
    """Yield all stored results of studies."""
    for top in sorted(path for path in (folder / DATA).glob(f"*/{ROOT}") if path.is_file()):
        if not is_study(disk.read_document(top)):
            continue
        journal = journal or read(folder / NAME)
        for place in sorted(top.parent.glob(f"*/{ROOT}")):
            attributes = dict((disk.read_document(place) or {}).get("attributes", {}))
            names, keys = (_texts(place.parent / name) for name in (CELLS, KEYS))
            now = finished_cells(folder, str(attributes.get("stage", "")), journal)
            other = sum(now.get(name) != key for name, key in zip(names, keys, strict=False))
            path = place.parent.relative_to(folder / DATA).as_posix()
            since = len(now.keys() - set(names))
            yield StoredStudy(path, str(attributes.get(STUDY, "")), attributes, len(names), other, since)


def _texts(array: Path) -> list[str]:
    try:
        return texts_of((array / "c" / "0").read_bytes())
    except (OSError, ArchiveError):
        return []
