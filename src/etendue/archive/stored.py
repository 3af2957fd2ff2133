"""The finished cells of an archive by name, with all that is needed to read them elsewhere, such as in a worker.

In:  the folder of an archive.
Out: names, and arrays held against the digests in the journal: what is not as it was written is refused, never filled
     in.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from etendue.archive import disk
from etendue.archive.chunks import decode
from etendue.archive.entries import Entry
from etendue.archive.journal import Read
from etendue.archive.layout import STATUS
from etendue.archive.manifest import DATA, Manifest, digest_of, read_manifest
from etendue.archive.naming import cell_label
from etendue.archive.owner import is_running
from etendue.archive.pieces import Window, joined
from etendue.archive.reading import FINISHED, StoredArchive, StoredChunk, open_archive
from etendue.archive.shards import Place, fits, read_bytes
from etendue.archive.unfolding import check_array
from etendue.errors import ArchiveError
from etendue.types.arrays import Array

LEDGER = "ledger"
LARGEST_TABLE = 128 << 20  # bytes of one column, of as many cells as 16 million


@dataclass(frozen=True)
class StoredArrays:
    """The arrays of one finished cell. Picklable: it may travel with the work."""

    root: str
    chunks: tuple[tuple[StoredChunk, Place | None], ...]
    digested: bool  # whether the journal has digests: it had others in archives with a file for every chunk

    @property
    def variables(self) -> list[str]:
        return list(dict.fromkeys(chunk.variable for chunk, _ in self.chunks))

    def read(self, variable: str) -> Any:
        """The array of a variable, held against the journal.

        Raises
        ------
        ArchiveError
            Something of it is missing, or not as it was written.
        """
        own = [one for one in self.chunks if one[0].variable == variable]
        return joined(
            ((chunk.window, self._array(chunk, place)) for chunk, place in own), [chunk.window for chunk, _ in own]
        )

    def read_band(self, variable: str, band: int) -> Any:
        """One band of a variable that is stored by band."""
        own = [
            (c, place)
            for c, place in self.chunks
            if c.variable == variable and c.window and c.window[0] == (band, band + 1)
        ]
        return joined(
            ((chunk.window, self._array(chunk, place)) for chunk, place in own), [chunk.window for chunk, _ in own]
        )[0]

    def parts(self, variable: str) -> Iterator[tuple[Window | None, Any]]:
        """The parts that a variable is stored in, one by one: which of the cell, and their arrays."""
        for chunk, place in self.chunks:
            if chunk.variable == variable:
                yield chunk.window, joined([(chunk.window, self._array(chunk, place))], [chunk.window])

    def windows(self, variable: str) -> list[Window | None]:
        """Which parts those are."""
        return [chunk.window for chunk, _ in self.chunks if chunk.variable == variable]

    def _bytes(self, place: Place | None) -> bytes | None:
        try:
            return read_bytes(Path(self.root), place) if place else None
        except OSError:
            return None

    def _array(self, chunk: StoredChunk, place: Place | None) -> Array:
        path = chunk.written.path
        data = self._bytes(place)
        if (data is None or place is None or (self.digested and not fits(data, place))) and is_running(Path(self.root)):
            place = StoredArchive(Path(self.root)).place(chunk)  # its part may have become a shard since
            data = self._bytes(place)
        if data is None or place is None:
            raise ArchiveError(f"{path}: chunk {chunk.written.slot} is missing")
        if self.digested and not fits(data, place):
            raise ArchiveError(f"{path}: the bytes of chunk {chunk.written.slot} are not as they were written")
        try:
            return decode(data, chunk.form.dtype, chunk.form.stored, chunk.form.codec)
        except ArchiveError as error:
            raise ArchiveError(f"{path}: {error}") from None


def _whole(path: Path) -> Any:
    """All of an array that stands for axes, status or a table: as large as what is read of it, whatever its metadata
    says.
    """
    import zarr

    check_array(path)
    array = zarr.open_array(str(path), mode="r")
    if array.nbytes > LARGEST_TABLE:
        raise ArchiveError(
            f"{array.name} is said to have the shape {array.shape}, more than an archive's axes and tables have"
        )
    return array[...]


class Stored:
    """An archive opened for reading alone. Nothing of it is changed."""

    def __init__(self, folder: Path, journal: Read | None = None, linked: frozenset[str] | None = None) -> None:
        self.folder = folder
        alone = journal is None and linked is None  # else who asks has looked for links, and says where they are
        self.archive = open_archive(folder) if alone else StoredArchive(folder, journal, linked or frozenset())

    @property
    def journal(self) -> Read:
        return self.archive.journal

    @cached_property
    def finished(self) -> dict[str, Entry]:
        """Every finished cell by name."""
        return {name: cell.entry for name, cell in self.archive.cells.items()}

    def variables(self) -> set[tuple[str, str]]:
        """The (stage, variable) pairs of which a finished cell is stored."""
        return {(cell.stage, chunk.variable) for cell in self.archive.cells.values() for chunk in cell.chunks}

    def cell(self, name: str) -> StoredArrays:
        """A finished cell. Arrays that were given up since (``keep``) are not in it."""
        chunks = self.archive.cells[name].chunks
        there = tuple((chunk, self.archive.place(chunk)) for chunk in chunks if self.keeps(chunk.group, chunk.variable))
        return StoredArrays(str(self.folder), there, not self.journal.files_a_cell)

    def keeps(self, group: str, variable: str) -> bool:
        """Whether the archive still has an array: one that was given up since stays in the lines of its cells."""
        return self.manifest is None or f"{group}/{variable}" in self.nodes

    def axes(self) -> dict[str, dict[str, list[Any]]]:
        """Axis values by group, from the coordinates in the store; of groups whose coordinates are as they were
        written.
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
        """(group, name) of every cell that is finished by its status, where status and coordinates are as they were
        written.
        """
        for group, axes in self.axes().items():
            if not self._hold(self._files(group, "status")):
                continue
            status = np.asarray(_whole(self._path(group, "status")))
            for place in np.argwhere(np.isin(status, [STATUS.index(one) for one in FINISHED])):
                labels = {dim: values[at] for at, (dim, values) in zip(place, axes.items(), strict=True)}
                yield group, cell_label(group.split("/")[0], labels)

    def by_ledger(self) -> set[tuple[Any, ...]] | None:
        """(stage, key, status, clipped, clipped_flux) of every cell of the last run; None where its table is not as
        it was written.
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
        """Files of chunks that are missing, or whose size or index is not as they were put in their places; no chunk
        is read.
        """
        if self.journal.files_a_cell:
            return []
        said = self.journal.said
        chunks = [
            self.archive.chunk(said.files[number]) for number in said.shards(self.journal.outdated).values()
        ]  # one of each shard
        kept = [chunk for chunk in chunks if self.keeps(chunk.group, chunk.variable)]
        return [c.written.path for c in kept if self.archive.finder.odd(c.written.path, c.form.slots)]

    @cached_property
    def manifest(self) -> Manifest | None:
        return read_manifest(self.folder)

    @cached_property
    def nodes(self) -> set[str]:
        """Every group and array that the manifest names."""
        return self.manifest.nodes() if self.manifest else set()
