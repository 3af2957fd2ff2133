"""The finished cells of an archive by name, with all data needed to read them in another process, such as a worker.

In:  the folder of an archive.
Out: names, and arrays checked against the digests in the journal: data that differs is refused, never replaced by fill
     values.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from etendue.archive.journaling.entries import Entry
from etendue.archive.journaling.journal import Read
from etendue.archive.read.reading import FINISHED, StoredArchive, StoredChunk, open_archive
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA, Manifest, digest_of, read_manifest
from etendue.archive.records.names import STATUS, cell_label
from etendue.archive.records.owner import is_running
from etendue.archive.sharding.chunks import decode
from etendue.archive.sharding.partition import Window, joined
from etendue.archive.sharding.shards import ChunkPlace, fits, read_bytes
from etendue.archive.sharding.unfolding import check_array
from etendue.errors import ArchiveError
from etendue.types.arrays import Array

LEDGER = "ledger"
LARGEST_TABLE = 128 << 20  # bytes of one column; enough for 16 million cells


@dataclass(frozen=True)
class StoredArrays:
    """The arrays of one finished cell. Picklable, so that it can be sent to workers."""

    root: str
    chunks: tuple[tuple[StoredChunk, ChunkPlace | None], ...]
    digested: bool  # whether the journal has digests; archives with one file per chunk had none

    @property
    def variables(self) -> list[str]:
        return list(dict.fromkeys(chunk.variable for chunk, _ in self.chunks))

    def read(self, variable: str) -> Any:
        """Return the array of a variable, checked against the journal.

        Raises
        ------
        ArchiveError
            Part of the array is missing or differs from what was written.
        """
        own = [one for one in self.chunks if one[0].variable == variable]
        return joined(
            ((chunk.window, self._array(chunk, place)) for chunk, place in own), [chunk.window for chunk, _ in own]
        )

    def read_band(self, variable: str, band: int) -> Any:
        """Return one band of a variable that is stored by band."""
        own = [
            (c, place)
            for c, place in self.chunks
            if c.variable == variable and c.window and c.window[0] == (band, band + 1)
        ]
        return joined(
            ((chunk.window, self._array(chunk, place)) for chunk, place in own), [chunk.window for chunk, _ in own]
        )[0]

    def parts(self, variable: str) -> Iterator[tuple[Window | None, Any]]:
        """Yield the stored parts of a variable one by one, each as its window in the cell and its array."""
        for chunk, place in self.chunks:
            if chunk.variable == variable:
                yield chunk.window, joined([(chunk.window, self._array(chunk, place))], [chunk.window])

    def windows(self, variable: str) -> list[Window | None]:
        """Return the window of each stored part in its cell; None for a whole cell."""
        return [chunk.window for chunk, _ in self.chunks if chunk.variable == variable]

    def _bytes(self, place: ChunkPlace | None) -> bytes | None:
        try:
            return read_bytes(Path(self.root), place) if place else None
        except OSError:
            return None

    def _array(self, chunk: StoredChunk, place: ChunkPlace | None) -> Array:
        path = chunk.written.path
        data = self._bytes(place)
        if (data is None or place is None or (self.digested and not fits(data, place))) and is_running(Path(self.root)):
            place = StoredArchive(Path(self.root)).place(chunk)  # the part may have become a shard meanwhile
            data = self._bytes(place)
        if data is None or place is None:
            raise ArchiveError(f"{path}: chunk {chunk.written.slot} is missing")
        if self.digested and not fits(data, place):
            raise ArchiveError(f"{path}: the bytes of chunk {chunk.written.slot} differ from what was written")
        try:
            return decode(data, chunk.form.dtype, chunk.form.stored, chunk.form.codec)
        except ArchiveError as error:
            raise ArchiveError(f"{path}: {error}") from None


def _whole(path: Path) -> Any:
    """Return all values of a coordinate, status or table column; refuse an array whose metadata claims an implausible
    size.
    """
    import zarr

    check_array(path)
    array = zarr.open_array(str(path), mode="r")
    if array.nbytes > LARGEST_TABLE:
        raise ArchiveError(f"{array.name} has the shape {array.shape}, too large for an axis or table of an archive")
    return array[...]


class Stored:
    """An archive opened for reading only."""

    def __init__(self, folder: Path, journal: Read | None = None, linked: frozenset[str] | None = None) -> None:
        self.folder = folder
        alone = journal is None and linked is None  # else the caller has looked for links and passes them
        self.archive = open_archive(folder) if alone else StoredArchive(folder, journal, linked or frozenset())

    @property
    def journal(self) -> Read:
        return self.archive.journal

    @cached_property
    def finished(self) -> dict[str, Entry]:
        """Every finished cell, by name."""
        return {name: cell.entry for name, cell in self.archive.cells.items()}

    def variables(self) -> set[tuple[str, str]]:
        """Return the (stage, variable) pairs that are stored for at least one finished cell."""
        cells = self.archive.cells.values()
        return {(cell.stage, chunk.variable) for cell in cells for chunk in self.archive.chunks_of(cell)}

    def cell(self, name: str) -> StoredArrays:
        """Return the arrays of a finished cell, except arrays that a later run removed because of its ``keep``."""
        chunks = self.archive.chunks_of(self.archive.cell(name))
        there = tuple((chunk, self.archive.place(chunk)) for chunk in chunks if self.keeps(chunk.group, chunk.variable))
        return StoredArrays(str(self.folder), there, not self.journal.files_a_cell)

    def keeps(self, group: str, variable: str) -> bool:
        """Return True if the archive still has an array; journal lines of cells also name arrays that were removed
        since.
        """
        return self.manifest is None or f"{group}/{variable}" in self.nodes

    def axes(self) -> dict[str, dict[str, list[Any]]]:
        """Return the axis values by group from the coordinates in the store, for groups whose coordinates are
        intact.
        """
        found = {}
        for group in sorted({node.rpartition("/")[0] for node in self.nodes if node.endswith("/status")}):
            dims = [
                str(dim)
                for dim in (disk.read_document(self._path(group, "status", "zarr.json")) or {}).get("dimension_names")
                or []
            ]
            shown = {
                path
                for node in (*dims, "status")
                for path in self._files(group, node)
                if node != "status" or path.endswith("zarr.json")
            }
            if all(f"{group}/{dim}" in self.nodes for dim in dims) and self._hold(shown):
                arrays = {dim: _whole(self._path(group, dim)) for dim in dims}
                found[group] = {dim: np.asarray(array).tolist() for dim, array in arrays.items()}
        return found

    def by_status(self) -> Iterator[tuple[str, str]]:
        """Yield (group, name) of every cell that is finished according to ``status``, for groups whose status and
        coordinates are intact.
        """
        for group, axes in self.axes().items():
            if not self._hold(self._files(group, "status")):
                continue
            status = np.asarray(_whole(self._path(group, "status")))
            for place in np.argwhere(np.isin(status, [STATUS.index(one) for one in FINISHED])):
                labels = {dim: values[at] for at, (dim, values) in zip(place, axes.items(), strict=True)}
                yield group, cell_label(group.split("/")[0], labels)

    def by_ledger(self) -> set[tuple[Any, ...]] | None:
        """Return (stage, key, status, clipped, clipped_flux) of every cell of the last run; None if the table of that
        run is not intact.
        """
        columns = ("stage", "key", "status", "clipped", "clipped_flux")
        if any(f"{LEDGER}/{name}" not in self.nodes or not self._hold(self._files(LEDGER, name)) for name in columns):
            return None
        rows = [np.asarray(_whole(self._path(LEDGER, name))).tolist() for name in columns]
        return set(zip(*rows, strict=True))

    def _path(self, *parts: str) -> Path:
        return self.folder.joinpath(DATA, *parts)

    def _files(self, group: str, name: str) -> list[str]:
        return [
            path
            for path in (self.manifest.metadata if self.manifest else ())
            if path.startswith(f"{DATA}/{group}/{name}/")
        ]

    def _hold(self, paths: Iterable[str]) -> bool:
        return self.manifest is not None and all(
            self.manifest.metadata[path] == digest_of(self.folder / path) and not self.archive.finder.behind_link(path)
            for path in paths
        )

    def odd(self) -> list[str]:
        """Return files of chunks that are missing or have a wrong size or index; no chunk is read."""
        if self.journal.files_a_cell:
            return []
        said = self.journal.said
        # one per shard
        chunks = [self.archive.chunk(said.files[number]) for number in said.shards(self.journal.outdated).values()]
        kept = [chunk for chunk in chunks if self.keeps(chunk.group, chunk.variable)]
        return [c.written.path for c in kept if self.archive.finder.odd(c.written.path, c.form.slots)]

    @cached_property
    def manifest(self) -> Manifest | None:
        return read_manifest(self.folder)

    @cached_property
    def nodes(self) -> set[str]:
        """Every group and array that the manifest names."""
        return self.manifest.nodes() if self.manifest else set()
