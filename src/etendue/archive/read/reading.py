"""Read an archive without its plan: every cell that is done according to the journal, and the place of each chunk.

In:  the folder of an archive, finished, interrupted or being written.
Out: cells with their chunks; arrays; the damage. Nothing is written.

The journal records the part or shard that holds the bytes of a chunk, the chunk's size and digest, and how the
variables of a group are split and encoded. Metadata of the store is consulted only for archives with one file per
chunk.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.archive.journaling.entries import Entry
from etendue.archive.journaling.journal import NAME, Read, read
from etendue.archive.read.following import Followed, follow
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.sharding.chunks import CODEC, decode
from etendue.archive.sharding.finding import Finder
from etendue.archive.sharding.partition import Window, counts_of, joined, known_chunk, pieces_of, window_of
from etendue.archive.sharding.shards import ChunkPlace, ShardFiles, fits, part_path, read_bytes
from etendue.contract.ports import WrittenChunk
from etendue.errors import ArchiveError, EtendueError

if TYPE_CHECKING:
    from etendue.types.arrays import Array

FINISHED = ("done", "left_out")
ELSEWHERE = "the index of its shard names another place"  # no cell is lost: the journal has the right place


@dataclass(frozen=True)
class StoredForm:
    """The form of the chunks of a variable."""

    dtype: str
    shape: tuple[int, ...]  # of one cell
    codec: str
    block: tuple[int, ...]  # axis values that share a shard
    chunk: tuple[int, ...]  # of one chunk, if a cell is stored in several

    @cached_property
    def pieces(self) -> int:
        """Number of chunks in one cell."""
        return pieces_of(self.shape, self.chunk)

    @cached_property
    def stored(self) -> tuple[int, ...]:
        """The shape of a decoded chunk."""
        return self.chunk if self.pieces > 1 else self.shape

    @cached_property
    def most_bytes(self) -> int:
        """Largest plausible size of a chunk in bytes: its numbers plus the overhead of a codec for
        incompressible data.
        """
        try:
            size = np.dtype(self.dtype).itemsize
        except TypeError:
            size = 16
        return prod(self.stored) * size * 17 // 16 + 4096

    @cached_property
    def slots(self) -> int:
        """Number of chunks in a shard; 0 if the file is the chunk itself."""
        return prod(self.block) * self.pieces if self.block or self.shape else 0


@dataclass(frozen=True)
class StoredChunk:
    """One chunk of a cell: its variable, and the place of its bytes according to the journal."""

    group: str
    variable: str
    form: StoredForm
    written: WrittenChunk

    @property
    def position(self) -> tuple[int, ...]:
        """The position of the cell along the stored axes of its group."""
        slot, local = self.written.slot // self.form.pieces, []
        for size in reversed(self.form.block):
            slot, at = divmod(slot, size)
            local.append(at)
        shard = self.written.path.rpartition("/")[2].split(".")[1 : 1 + len(self.form.block)]
        return tuple(int(n) * size + at for n, size, at in zip(shard, self.form.block, reversed(local), strict=True))

    @property
    def window(self) -> Window | None:
        """The part of the cell that the chunk covers; None for the whole cell."""
        shape, chunk = self.form.shape, self.form.chunk
        counts = counts_of(shape, chunk)
        if prod(counts) == 1:
            return None
        return window_of(shape, chunk, [int(i) for i in np.unravel_index(self.written.slot % prod(counts), counts)])


@dataclass(frozen=True)
class StoredCell:
    """A cell that is done according to the journal."""

    name: str  # "sharpen gain=2.0 pitch=3.0"
    entry: Entry
    chunks: tuple[StoredChunk, ...]

    @property
    def stage(self) -> str:
        return self.name.split(" ")[0]


@dataclass(frozen=True)
class DamageFound:
    """A deviation from what was written."""

    path: str  # below the archive
    what: str
    cell: str = ""  # cell of the chunk; '' for the index of a shard, which costs no cell
    variable: str = ""
    slot: int | None = None


class StoredArchive:
    """The cells of an archive; created by ``open_archive``.

    Attributes
    ----------
    journal : the content of its journal
    cells : the cells that are done, by name
    held : the cells in ``cells``, plus the cells that a run was about to replace; the chunks of such a cell remain
        until it is replaced
    """

    def __init__(self, folder: Path, journal: Read | None = None, linked: frozenset[str] = frozenset()) -> None:
        self.folder = folder
        self.journal: Read = read(folder / NAME) if journal is None else journal
        self.finder = Finder(folder, self.journal, linked)
        self._forms: dict[str, tuple[str, str, StoredForm]] = {}  # by folder of an array
        self.files: set[str] = set()  # the files that hold the chunks ``check`` has examined

    @cached_property
    def cells(self) -> Mapping[str, StoredCell]:
        outdated = self.journal.outdated
        return {name: cell for name, cell in self.held.items() if name not in outdated} if outdated else self.held

    @cached_property
    def held(self) -> Mapping[str, StoredCell]:
        done = {name: self.journal.entries[name] for name in self.journal.said.done()}
        return {name: self._cell(name, entry) for name, entry in done.items()}

    def _cell(self, name: str, entry: Entry) -> StoredCell:
        return StoredCell(name, entry, tuple(map(self.chunk, self._own(entry))))

    def cell(self, name: str) -> StoredCell:
        """Return one of ``cells`` without building the others."""
        entry = self.journal.entries[name]
        if entry.event != "done" or name in self.journal.outdated:
            raise KeyError(name)
        return self._cell(name, entry)

    @cached_property
    def by_shard(self) -> dict[str, Array]:
        """Map each shard to the numbers of the chunks in it that belong to ``cells``."""
        found = self.journal.said.by_shard(self.journal.outdated)
        return {path: numbers for path, numbers in found.items() if path.rpartition("/")[0] not in self._gone}

    def positions(self, path: str) -> tuple[Array, ...]:
        """Return the positions of the cells that have the chunks of ``by_shard[path]``, along each stored axis."""
        form, name = self._known(path.rpartition("/")[0])[2], path.rpartition("/")[2]
        slots = np.asarray(self.journal.said.files.slot)[np.asarray(self.by_shard[path])] // form.pieces
        shard = name.split(".")[1 : 1 + len(form.block)]
        local = np.unravel_index(slots, form.block) if form.block else ()
        return tuple(int(n) * size + at for n, size, at in zip(shard, form.block, local, strict=True))

    @cached_property
    def _gone(self) -> set[str]:
        """The folders of arrays that the last run removed because they were copies of other arrays."""
        return {f"{DATA}/{group}/{name}" for group, names in self.journal.same.items() for name in names}

    def _own(self, entry: Entry) -> Iterable[WrittenChunk]:
        """Return the chunks of a cell, except chunks in arrays that the last run removed as copies."""
        gone = self._gone
        return [file for file in entry.files if file.path.rpartition("/")[0] not in gone] if gone else entry.files

    @cached_property
    def followed(self) -> list[Followed]:
        """The variables without an array, with the chunks that have the values of their cells."""
        return follow(self.journal, self.cells) if self.journal.same else []

    @cached_property
    def _elsewhere(self) -> dict[str, tuple[StoredChunk, ...]]:
        """For each cell, by name, the chunks of other cells that have its values."""
        found: dict[str, tuple[StoredChunk, ...]] = {}
        for one in self.followed:
            for cell, chunks in one.cells.values():
                found[cell.name] = (*found.get(cell.name, ()), *chunks)
        return found

    def chunks_of(self, cell: StoredCell) -> tuple[StoredChunk, ...]:
        """Return the chunks of all variables of a cell: its own chunks, and chunks of other cells that hold the same
        values.
        """
        return (*cell.chunks, *self._elsewhere.get(cell.name, ())) if self.journal.same else cell.chunks

    def place(self, chunk: StoredChunk, fresh: bool = False) -> ChunkPlace | None:
        """Return the present place of the bytes of a chunk; None if they are lost. ``fresh``: also read the bytes and
        check their digest.
        """
        if self.journal.files_a_cell:
            return (
                ChunkPlace(chunk.written.path, 0, chunk.written.size, 0)
                if (self.folder / chunk.written.path).is_file()
                else None
            )
        return self.finder.find(chunk.written, chunk.form.slots, fresh)

    def read(self, cell: StoredCell, variable: str) -> Any:
        """Return the array of one variable of a cell.

        Raises
        ------
        ArchiveError
            The variable was not kept, or it is damaged.
        """
        own = [chunk for chunk in self.chunks_of(cell) if chunk.variable == variable]
        if not own:
            raise ArchiveError(f"{self.folder}: {variable} of {cell.name} was not kept")
        return joined(((chunk.window, self._array(chunk)) for chunk in own), [chunk.window for chunk in own])

    def check(self, cells: Iterable[StoredCell] | None = None) -> Iterator[DamageFound]:
        """Read every chunk of the given cells (default: all) in file order, and the indexes of their shards; yield
        the damage.
        """
        chunks = [
            (cell, chunk, self._lies(chunk))
            for cell in (self.cells.values() if cells is None else cells)
            for chunk in cell.chunks
        ]
        chunks.sort(key=lambda one: (one[2].file, one[2].offset))
        with ShardFiles(self.folder) as files:
            for cell, chunk, place in chunks:
                what = self._damage(chunk, place, files)
                if what:
                    yield DamageFound(place.file, what, cell.name, chunk.variable, chunk.written.slot)
        if not self.journal.files_a_cell:
            yield from self._indexes({chunk.written.path: chunk.form.slots for _, chunk, _ in chunks})

    def _indexes(self, slots: Mapping[str, int]) -> Iterator[DamageFound]:
        for path, count in sorted(slots.items()):
            if self.finder.odd(path, count):
                state = self.finder.state(path, count)
                yield DamageFound(
                    path,
                    "missing"
                    if state is None
                    else "its index is damaged"
                    if state.index is None
                    else "its size has changed",
                )

    def _lies(self, chunk: StoredChunk) -> ChunkPlace:
        """Return the place where a chunk is, or should be."""
        written, place = chunk.written, self.place(chunk)
        if place is not None:
            self.files.add(place.file)
            return place
        return ChunkPlace(
            written.path if written.path in self.journal.shards else part_path(written),
            written.offset,
            written.size,
            written.digest,
        )

    def _damage(self, chunk: StoredChunk, place: ChunkPlace, files: ShardFiles) -> str:
        if self.finder.behind_link(place.file):
            return "missing"
        if place.size > chunk.form.most_bytes:
            return f"its recorded size of {place.size} bytes exceeds the size that its numbers can take"
        try:
            data = files.read(place)
        except OSError:
            return "missing"
        if self.journal.files_a_cell:
            try:
                decode(data, chunk.form.dtype, chunk.form.stored, chunk.form.codec)
            except ArchiveError as error:
                return str(error)
            return ""
        if not fits(data, place):
            return "truncated" if len(data) < place.size else "its bytes do not match their checksum"
        state = self.finder.state(chunk.written.path, chunk.form.slots)
        if (
            place.file == chunk.written.path
            and state
            and state.index
            and state.index.get(chunk.written.slot) != (place.offset, place.size)
        ):
            return ELSEWHERE
        return ""

    def _array(self, chunk: StoredChunk) -> Array:
        place = self.place(chunk)
        path, slot = chunk.written.path, chunk.written.slot
        if place is None:
            raise ArchiveError(f"{self.folder / path}: chunk {slot} is missing")
        data = read_bytes(self.folder, place)
        if not self.journal.files_a_cell and not fits(data, place):
            raise ArchiveError(f"{self.folder / path}: the bytes of chunk {slot} do not match their checksum")
        return decode(data, chunk.form.dtype, chunk.form.stored, chunk.form.codec)

    def slots_of(self, paths: Iterable[str]) -> dict[str, int]:
        """Return the number of chunks for which each shard has room; shards of arrays that the journal does not
        describe are omitted.
        """
        found = {}
        for path in paths:
            group, _, variable = path.removeprefix(f"{DATA}/").rpartition("/")[0].rpartition("/")
            if variable in self.journal.blocks.get(group, {}):
                found[path] = self.form(group, variable).slots
        return found

    # -- the form of chunks -------------------------------------------------------------------------------------------

    def chunk(self, written: WrittenChunk) -> StoredChunk:
        """Return a chunk that the journal names, with the form of its variable."""
        return StoredChunk(*self._known(written.path.rpartition("/")[0]), written)

    def _known(self, folder: str) -> tuple[str, str, StoredForm]:
        """Return group, variable and form of the chunks in the folder of an array."""
        known = self._forms.get(folder)
        if known is None:
            group, _, variable = folder.removeprefix(f"{DATA}/").rpartition("/")
            known = self._forms[folder] = group, variable, self.form(group, variable)
        return known

    def form(self, group: str, variable: str) -> StoredForm:
        known = self.journal.blocks.get(group, {}).get(variable)
        if known is None:
            return self._form_of_files(f"{group}/{variable}")
        dtype, _, shape = known["form"].partition(" ")
        sizes = tuple(int(n) for n in shape.split("x") if n)
        return StoredForm(dtype, sizes, known["codec"], tuple(known["block"]), known_chunk(sizes, known))

    def _form_of_files(self, path: str) -> StoredForm:
        """Return the form from the metadata, for an archive with one file per chunk."""
        document = disk.read_document(self.folder / DATA / path / "zarr.json")
        try:
            assert document is not None
            shape, dims = document["shape"], document["dimension_names"]
            chunks = document["chunk_grid"]["configuration"]["chunk_shape"]
            axes = len(self.journal.axes[path.rpartition("/")[0]])
            assert len(shape) == len(dims) == len(chunks) >= axes
            own, cut = tuple(shape[axes:]), tuple(chunks[axes:])
            return StoredForm(str(document["data_type"]), own, CODEC, (1,) * axes, tuple(max(n, 1) for n in cut))
        except (AssertionError, KeyError, TypeError, IndexError):
            raise ArchiveError(f"{self.folder / DATA / path}: no readable metadata describes its chunks") from None


@contextmanager
def metadata_of(folder: Path) -> Iterator[None]:
    """Wrap calls of a library that reads metadata of a store. If the library fails, no run can have written the
    metadata.

    Raises
    ------
    ArchiveError
        The library failed.
    """
    try:
        yield
    except (EtendueError, OSError, MemoryError):
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise ArchiveError(
            f"{folder / DATA}: its metadata differs from the metadata that a run writes ({text}). Find changes "
            "with: etendue "
            f"verify {folder}; "
            f"if digests were recomputed after the change, with: etendue reproduce {folder}"
        ) from error


def open_archive(folder: Path, journal: Read | None = None) -> StoredArchive:
    """Open an archive for reading. ``journal``: the journal, if it has been read already.

    Raises
    ------
    ArchiveError
        There is no archive, or it holds a link.
    """
    if not (folder / DATA).is_dir() or not (folder / NAME).is_file():
        raise ArchiveError(f"{folder} is not an archive of etendue ({disk.lacks(folder, DATA + ' with a ' + NAME)})")
    disk.Listing(folder)
    return StoredArchive(folder, journal)
