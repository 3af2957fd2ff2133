"""Examine an archive: check every file against its recorded digest.

In:  the folder of an archive, and a listing of it.
Out: the damage, part by part.

Chunks are checked against the journal; the journal, metadata, coordinates, status, tables, pictures and records against
the manifest; the manifest against itself; inputs against the digests in their names. Only the bytes between the chunks
of a shard have no digest; they contain no data.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from etendue import plain_files
from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.journaling.journal import Read
from etendue.archive.read.reading import ELSEWHERE, StoredChunk
from etendue.archive.read.stored import Stored
from etendue.archive.records import disk, remembered
from etendue.archive.records.inputs import digest_now
from etendue.archive.records.manifest import DATA, digest_of
from etendue.archive.records.manifest import NAME as MANIFEST
from etendue.archive.records.owner import is_id
from etendue.archive.records.rerun import every_record
from etendue.contract.values.names import TABLES

Told = Callable[[int, int], None]


@dataclass(frozen=True)
class Damage:
    """One deviation from what was written.

    Attributes
    ----------
    kind : changed | missing | added | odd (a link, or a folder in the place of a file) | unfinished
    path : path of the file below the archive
    array : the array that the file belongs to, as a path below the store; '' for other files
    cell : the cell that the chunk belongs to; '' if no cell is lost
    """

    kind: str
    path: str
    what: str
    array: str = ""
    cell: str = ""


@dataclass
class Verified:
    """The result of an examination.

    Attributes
    ----------
    beside : files and groups that no run has written and that may stay where they are
    partial : the folder that a killed ``compact`` left beside the archive; '' if there is none
    """

    folder: Path
    damages: list[Damage] = field(default_factory=list)
    beside: list[str] = field(default_factory=list)
    partial: str = ""
    cells: int = 0
    chunks: int = 0
    bytes: int = 0
    seconds: float = 0.0

    @property
    def whole(self) -> bool:
        return not self.damages

    @property
    def lost(self) -> dict[str, None]:
        """The cells that are damaged, in order."""
        return dict.fromkeys(damage.cell for damage in self.damages if damage.cell)


class Inspection:
    """The examination of one archive: each public method yields the damage of one part."""

    def __init__(
        self, folder: Path, listing: disk.Listing, found: Verified, told: Told, odd: set[str], journal: Read | None
    ) -> None:
        self.folder, self.listing, self.found, self.told, self.odd = folder, listing, found, told, odd
        self.stored = Stored(folder, journal, frozenset(odd))
        self.known = self.stored.manifest
        self.expected: set[str] = set()  # files of the store that the journal or manifest names
        self.lines_lost = False
        own = [
            c
            for cell in self.stored.archive.held.values()
            for c in cell.chunks
            if self.stored.keeps(c.group, c.variable)
        ]
        files = {**self.known.metadata, **self.known.files} if self.known else {}
        self.sizes = {path: _size(f"{folder}/{path}") for path in files}
        self.total = sum(c.written.size for c in own) + sum(filter(None, self.sizes.values()))

    def _read(self, count: int) -> None:
        self.found.bytes += count
        self.told(self.found.bytes, self.total)

    # -- journal and manifest -----------------------------------------------------------------------------------------

    def manifest(self) -> Iterator[Damage]:
        if self.known is None and (self.folder / MANIFEST).exists():
            yield Damage("changed", MANIFEST, "differs from what was written; its digests of other files are ignored")
        elif self.known is None:
            yield Damage("unfinished", MANIFEST, "missing: a run was interrupted, or the file was removed")

    def journal(self) -> Iterator[Damage]:
        journal, lost = self.stored.journal, []
        if not (self.folder / JOURNAL).is_file():
            self.lines_lost = True
            yield from self._forgotten()
            return
        self._read(_size(self.folder / JOURNAL) or 0)
        if journal.damaged:
            lost.append(f"{journal.damaged} of its lines differ from what was written")
        if journal.torn:
            lost.append("its last line is incomplete")
        changed = bool(self.known and self.known.journal and digest_of(self.folder / JOURNAL) != self.known.journal)
        self.lines_lost = changed or bool(lost)
        if changed and not lost:
            lost.append("lines were removed, added, moved or edited")
        if lost:
            yield Damage("changed", JOURNAL, "; ".join(lost))
            yield from self._forgotten()

    def _forgotten(self) -> Iterator[Damage]:
        """Yield cells that are finished according to ``status`` but not according to the journal, and cells for which
        journal and ledger disagree.
        """
        ledger = self.stored.by_ledger()
        for name, cell in self.stored.archive.held.items() if ledger is not None else ():
            said = (cell.stage, cell.entry.key, cell.entry.status, cell.entry.clipped, cell.entry.clipped_flux)
            if said not in (ledger or ()):
                yield Damage("changed", JOURNAL, "its line disagrees with the ledger", cell.stage, name)
        for group, name in self.stored.by_status():
            if name not in self.stored.archive.held:
                yield Damage("changed", JOURNAL, "its line is lost", group, name)

    def metadata(self) -> Iterator[Damage]:
        for path, known in (self.known.metadata if self.known else {}).items():
            self.expected.add(path)
            yield from self._held(path, known, _array(path))

    def _held(self, path: str, known: str, array: str = "") -> Iterator[Damage]:
        """Check a file against its digest."""
        size = self.sizes[path]
        if size is None or self.stored.archive.finder.behind_link(path):
            yield Damage("missing", path, "missing", array)
            return
        self._read(size)
        if digest_of(self.folder / path) == known:
            return
        if (self.folder / path).is_dir():
            yield Damage("odd", path, "a folder is in its place", array)
        else:
            yield Damage("changed", path, "differs from what was written", array)

    # -- cells --------------------------------------------------------------------------------------------------------

    def chunks(self) -> Iterator[Damage]:
        archive, journal = self.stored.archive, self.stored.journal
        shards: dict[str, dict[int, StoredChunk]] = {}
        named: set[str] = set()  # shards whose damage has been reported
        for cell in archive.held.values():
            own = [chunk for chunk in cell.chunks if self.stored.keeps(chunk.group, chunk.variable)]
            self.found.cells += bool(own or self.stored.archive.chunks_of(cell))
            for chunk in own:
                self.expected.add(chunk.written.path)
                shards.setdefault(chunk.written.path, {})[chunk.written.slot] = chunk
        for damage in archive.check(archive.held.values()):
            array = _array(damage.path)
            group, _, variable = array.rpartition("/")
            if not self.stored.keeps(group, variable):
                continue
            if damage.cell and damage.what == ELSEWHERE:
                yield Damage("changed", damage.path, f"{damage.what} for {damage.cell}, whose bytes are intact", array)
            elif damage.cell:
                named.add(damage.path)
                known = "missing" if damage.what == "missing" else "changed"
                kind = "odd" if (self.folder / damage.path).is_dir() else known
                yield Damage(kind, damage.path, damage.what, array, damage.cell)
            elif damage.path not in named:
                yield Damage("changed", damage.path, damage.what, array)
        for own_chunks in shards.values():
            self.found.chunks += len(own_chunks)
            self._read(sum([chunk.written.size for chunk in own_chunks.values()]))
        if not journal.files_a_cell:
            yield from self._strange_slots(shards)

    def _strange_slots(self, shards: dict[str, dict[int, StoredChunk]]) -> Iterator[Damage]:
        """Yield chunks in the index of a shard that the journal does not name: a plain reader would return them."""
        for path, own in shards.items():
            one = next(iter(own.values()))
            state = self.stored.archive.finder.state(path, one.form.slots)
            for slot in sorted(set((state.index if state else None) or ()) - set(own)):
                yield Damage(
                    "changed", path, f"its index names a chunk ({slot}) that the journal does not name", _array(path)
                )

    # -- files beside the store ---------------------------------------------------------------------------------------

    def inputs(self) -> Iterator[Damage]:
        ours = self.known.files if self.known else None  # ignore records that no run has written
        runs = every_record(self.folder, ours) if "runs" not in self.odd else ()
        wanted = {name for run in runs for name in run.inputs}
        wanted |= {
            name
            for text in self.stored.journal.records.values()
            for name in re.findall(r"\.\./inputs/([0-9a-f]{64}[\w.]*)", text)
        }
        place = self.folder / "inputs"
        there = {path.name for path in place.iterdir()} if place.is_dir() and "inputs" not in self.odd else set()
        for name in sorted(wanted):
            path = f"inputs/{name}"
            if path in self.odd:
                continue
            if name in there:
                yield from self._input(path, name)
            elif f"{name}.json" not in there:
                yield Damage("missing", path, "missing: only its owner can supply its content")
        for name in sorted(there - wanted - {f"{name}.json" for name in wanted}):
            if f"inputs/{name}" not in self.odd:
                yield Damage("added", f"inputs/{name}", "no run of the archive reads it")

    def _input(self, path: str, name: str) -> Iterator[Damage]:
        whole = self.folder / path
        if any(own.startswith(f"{path}/") for own in self.odd):
            return  # reported as odd already
        self._read(sum(_size(p) or 0 for p in ([whole, *whole.rglob("*")] if whole.is_dir() else [whole])))
        try:
            same = digest_now(whole) == name[:64]
        except OSError:
            same = False
        if not same:
            yield Damage("changed", path, "its SHA-256 differs from its name: only its owner can supply its content")

    def records(self) -> Iterator[Damage]:
        kept, place = self.stored.journal.records, self.folder / "runs"
        files = self.known.files if self.known else {}
        there = (
            {f"runs/{path.name}" for path in place.iterdir()} if place.is_dir() and "runs" not in self.odd else set()
        )
        for path, text in kept.items():
            if path not in files and _content(self.folder / path) != text.encode():
                yield Damage("changed" if path in there else "missing", path, "differs from the copy in the journal")
        if self.known:
            for path in sorted(there - files.keys() - self.odd):
                yield Damage("added", path, "no run has written it")

    def small_files(self) -> Iterator[Damage]:
        for path, known in (self.known.files if self.known else {}).items():
            yield from self._held(path, known)
        if not remembered.whole(self.folder):
            yield Damage("changed", remembered.NAME, "differs from what was written: its cached results are ignored")
        if _size(self.folder / "lock"):
            yield Damage("changed", "lock", "it is no longer empty")
        owner = _content(self.folder / "run.id")
        if owner is None or not is_id(owner):
            yield Damage("missing" if owner is None else "changed", "run.id", "it does not name the last run")
        if not (self.folder / "lock").is_file() and "lock" not in self.odd:
            yield Damage("missing", "lock", "missing")

    def added(self) -> Iterator[Damage]:
        """Yield files that neither journal nor manifest names."""
        ours = {node.split("/")[0] for node in self.stored.nodes} | {
            group.split("/")[0] for group in self.stored.journal.arrays
        }
        ours |= set(TABLES)
        unfinished = self.stored.archive.files
        foreign: dict[str, None] = {}  # each folder is reported once, whatever is in it
        for path in sorted(self.listing.below(DATA)):
            top = path.split("/")[1]
            if path in self.expected or path in unfinished or path in self.odd:
                continue
            if path.endswith((disk.PARTIAL, disk.PART)):
                yield Damage("unfinished", path, "left by an interrupted run")
            elif "/" in path.removeprefix(f"{DATA}/") and top not in ours:
                foreign[f"{DATA}/{top}"] = None
            elif self.known or not path.endswith("zarr.json"):
                yield from self._stranger(path)
        self.found.beside += foreign

    def beside(self) -> Iterator[Damage]:
        """Yield unexpected files beside the store."""
        for entry in sorted(self.folder.iterdir()):
            if entry.name.endswith((disk.PARTIAL, ".partial.png")):
                yield Damage("unfinished", entry.name, "left by an interrupted run")
            elif entry.name not in (*disk.FILES, *disk.FOLDERS) and entry.name not in self.odd:
                self.found.beside.append(entry.name)
        for name in ("contact_sheet.png", "CITATION.cff", "ro-crate-metadata.json"):
            if self.known and name not in self.known.files and (self.folder / name).is_file():
                yield Damage("added", name, "no run has written it")

    def _stranger(self, path: str) -> Iterator[Damage]:
        """Report an unknown file at a place where runs write files: it is foreign, or its journal lines are lost."""
        array = _array(path)
        if self.known is None and (
            path.startswith(tuple(f"{DATA}/{t}/" for t in TABLES)) or re.search("/c(/|$)", path)
        ):
            return  # of a table or coordinate: cannot be judged without a manifest
        group = array.rpartition("/")[0]
        chunk = re.fullmatch(r"c(\.\d+)*", path.rpartition("/")[2]) and array in self.stored.nodes
        if self.lines_lost and chunk and group in self.stored.journal.blocks:
            yield Damage("changed", path, "the journal no longer names its chunks", array)
        else:
            yield Damage("added", path, "no run has written it", array if array in self.stored.nodes else "")


def _array(path: str) -> str:
    """Return the path of the array or group that a file of the store belongs to."""
    return re.sub(r"/(zarr\.json|c([/.][\d./]*)?|\.c\..*)$", "", path.removeprefix(f"{DATA}/"))


def _size(path: str | Path) -> int | None:
    """Return the size of a file (bytes); 0 for a folder; None if it does not exist."""
    try:
        state = os.lstat(path)
    except OSError:
        return None
    return 0 if stat.S_ISDIR(state.st_mode) else state.st_size


def _content(path: Path) -> bytes | None:
    try:
        return plain_files.content(path, links=False)
    except OSError:
        return None
