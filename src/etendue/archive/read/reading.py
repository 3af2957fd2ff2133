"""An archive read without its plan: every cell that the journal calls done, and where each of its chunks lies.

In:  the folder of an archive, finished, interrupted or being written.
Out: cells with their chunks; arrays; what is damaged. Nothing is written.

What is known stands in the journal: which part or shard holds the bytes of a chunk, its size and digest, how the
variables of a group are cut and encoded. Metadata of the store is asked only in archives that have a file for every
chunk.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from etendue.archive.journaling.entries import Entry
from etendue.archive.journaling.journal import NAME, Read, read
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.sharding.chunks import CODEC, decode
from etendue.archive.sharding.finding import Finder
from etendue.archive.sharding.partition import Window, counts_of, joined, known_chunk, pieces_of, window_of
from etendue.archive.sharding.shards import ChunkPlace, ShardFiles, fits, part_path, read_bytes
from etendue.contract.ports import WrittenChunk
from etendue.errors import ArchiveError, EtendueError

FINISHED = ("done", "left_out")
ELSEWHERE = "the index of its shard names another place"  # which costs no cell: the journal knows the right one


@dataclass(frozen=True)
class StoredForm:
    """What the chunks of a variable are."""

    dtype: str
    shape: tuple[int, ...]  # of one cell
    codec: str
    block: tuple[int, ...]  # axis values that share a shard
    chunk: tuple[int, ...]  # of its bands, where they are stored one by one

    @cached_property
    def pieces(self) -> int:
        """Chunks of one cell."""
        return pieces_of(self.shape, self.chunk)

    @cached_property
    def stored(self) -> tuple[int, ...]:
        """The shape of a chunk as it is decoded."""
        return self.chunk if self.pieces > 1 else self.shape

    @cached_property
    def most_bytes(self) -> int:
        """What a chunk may take: its numbers, and a little that a codec writes around what it cannot make smaller."""
        try:
            size = np.dtype(self.dtype).itemsize
        except TypeError:
            size = 16
        return prod(self.stored) * size * 17 // 16 + 4096

    @cached_property
    def slots(self) -> int:
        """Chunks of a shard; 0 for a file that is the chunk itself."""
        return prod(self.block) * self.pieces if self.block or self.shape else 0


@dataclass(frozen=True)
class StoredChunk:
    """One chunk of a cell: which variable, and where the journal says its bytes were put."""

    group: str
    variable: str
    form: StoredForm
    written: WrittenChunk

    @property
    def position(self) -> tuple[int, ...]:
        """Of the cell along the stored axes of its group."""
        slot, local = self.written.slot // self.form.pieces, []
        for size in reversed(self.form.block):
            slot, at = divmod(slot, size)
            local.append(at)
        shard = self.written.path.rpartition("/")[2].split(".")[1 : 1 + len(self.form.block)]
        return tuple(int(n) * size + at for n, size, at in zip(shard, self.form.block, reversed(local), strict=True))

    @property
    def window(self) -> Window | None:
        """Which part of the cell it is; None: all of it."""
        shape, chunk = self.form.shape, self.form.chunk
        counts = counts_of(shape, chunk)
        if prod(counts) == 1:
            return None
        return window_of(shape, chunk, [int(i) for i in np.unravel_index(self.written.slot % prod(counts), counts)])


@dataclass(frozen=True)
class StoredCell:
    """A cell that the journal calls done."""

    name: str  # "sharpen gain=2.0 pitch=3.0"
    entry: Entry
    chunks: tuple[StoredChunk, ...]

    @property
    def stage(self) -> str:
        return self.name.split(" ")[0]


@dataclass(frozen=True)
class DamageFound:
    """Something that is not as it was written."""

    path: str  # below the archive
    what: str
    cell: str = ""  # whose chunk it is; '': the index of a shard, which costs no cell
    variable: str = ""
    slot: int | None = None


class StoredArchive:
    """The cells of an archive. ``open_archive`` makes one.

    Attributes
    ----------
    journal : everything that it says
    cells : by name, those that are done
    held : by name, also those that a run was about to replace: their chunks are there until it does
    """

    def __init__(self, folder: Path, journal: Read | None = None, linked: frozenset[str] = frozenset()) -> None:
        self.folder = folder
        self.journal: Read = read(folder / NAME) if journal is None else journal
        self.finder = Finder(folder, self.journal, linked)
        self._forms: dict[str, tuple[str, str, StoredForm]] = {}  # by folder of an array
        self.files: set[str] = set()  # in which the chunks lie that ``check`` has looked at

    @cached_property
    def cells(self) -> Mapping[str, StoredCell]:
        outdated = self.journal.outdated
        return {name: cell for name, cell in self.held.items() if name not in outdated} if outdated else self.held

    @cached_property
    def held(self) -> Mapping[str, StoredCell]:
        done = {name: self.journal.entries[name] for name in self.journal.said.done()}
        return {name: StoredCell(name, entry, tuple(map(self.chunk, entry.files))) for name, entry in done.items()}

    def place(self, chunk: StoredChunk, fresh: bool = False) -> ChunkPlace | None:
        """Where the bytes of a chunk lie now; None where they are lost. ``fresh``: they are read and held against
        their digest.
        """
        if self.journal.files_a_cell:
            return (
                ChunkPlace(chunk.written.path, 0, chunk.written.size, 0)
                if (self.folder / chunk.written.path).is_file()
                else None
            )
        return self.finder.find(chunk.written, chunk.form.slots, fresh)

    def read(self, cell: StoredCell, variable: str) -> Any:
        """The array of one variable of a cell.

        Raises
        ------
        ArchiveError
            It was not kept, or it is damaged.
        """
        own = [chunk for chunk in cell.chunks if chunk.variable == variable]
        if not own:
            raise ArchiveError(f"{self.folder}: of {cell.name} no {variable} is kept")
        return joined(((chunk.window, self._array(chunk)) for chunk in own), [chunk.window for chunk in own])

    def check(self, cells: Iterable[StoredCell] | None = None) -> Iterator[DamageFound]:
        """Read every chunk of some cells (all), in the order of the files, and every index beside them; gives what
        is damaged.
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
                    else "its size is another",
                )

    def _lies(self, chunk: StoredChunk) -> ChunkPlace:
        """Where a chunk lies, or would lie."""
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
            return f"it is said to be {place.size} bytes long, more than its numbers are"
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
            return "cut off" if len(data) < place.size else "its bytes do not fit their checksum"
        state = self.finder.state(chunk.written.path, chunk.form.slots)
        if (
            place.file == chunk.written.path
            and state
            and state.index
            and state.index.get(chunk.written.slot) != (place.offset, place.size)
        ):
            return ELSEWHERE
        return ""

    def _array(self, chunk: StoredChunk) -> Any:
        place = self.place(chunk)
        path, slot = chunk.written.path, chunk.written.slot
        if place is None:
            raise ArchiveError(f"{self.folder / path}: chunk {slot} is missing")
        data = read_bytes(self.folder, place)
        if not self.journal.files_a_cell and not fits(data, place):
            raise ArchiveError(f"{self.folder / path}: the bytes of chunk {slot} do not fit their checksum")
        return decode(data, chunk.form.dtype, chunk.form.stored, chunk.form.codec)

    def slots_of(self, paths: Iterable[str]) -> dict[str, int]:
        """How many chunks each of some shards has room for; of arrays of which the journal says it."""
        found = {}
        for path in paths:
            group, _, variable = path.removeprefix(f"{DATA}/").rpartition("/")[0].rpartition("/")
            if variable in self.journal.blocks.get(group, {}):
                found[path] = self._form(group, variable).slots
        return found

    # -- what the chunks are ------------------------------------------------------------------------------------------

    def chunk(self, written: WrittenChunk) -> StoredChunk:
        """A chunk that the journal names, with the form of its variable."""
        folder = written.path.rpartition("/")[0]
        known = self._forms.get(folder)
        if known is None:
            group, _, variable = folder.removeprefix(f"{DATA}/").rpartition("/")
            known = self._forms[folder] = group, variable, self._form(group, variable)
        return StoredChunk(*known, written)

    def _form(self, group: str, variable: str) -> StoredForm:
        known = self.journal.blocks.get(group, {}).get(variable)
        if known is None:
            return self._form_of_files(f"{group}/{variable}")
        dtype, _, shape = known["form"].partition(" ")
        sizes = tuple(int(n) for n in shape.split("x") if n)
        return StoredForm(dtype, sizes, known["codec"], tuple(known["block"]), known_chunk(sizes, known))

    def _form_of_files(self, path: str) -> StoredForm:
        """Of an archive with a file for every chunk: as its metadata says."""
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
            raise ArchiveError(f"{self.folder / DATA / path}: nothing readable says what its chunks are") from None


@contextmanager
def metadata_of(folder: Path) -> Iterator[None]:
    """Around a library that reads the metadata of a store: where it breaks off, somebody has written what no run
    writes.

    Raises
    ------
    ArchiveError
        It breaks off.
    """
    try:
        yield
    except (EtendueError, OSError, MemoryError):
        raise
    except Exception as error:
        text = " ".join(str(error).split())[:200] or type(error).__name__
        raise ArchiveError(
            f"{folder / DATA}: its metadata says what no run writes ({text}). What is changed is found by etendue "
            f"verify {folder}, "
            f"and by etendue reproduce {folder} where digests were made anew"
        ) from error


def open_archive(folder: Path) -> StoredArchive:
    """An archive for reading.

    Raises
    ------
    ArchiveError
        There is none, or something in it is a link.
    """
    if not (folder / DATA).is_dir() or not (folder / NAME).is_file():
        raise ArchiveError(f"{folder} is not an archive of etendue (no {DATA} with a {NAME} beside it)")
    disk.Listing(folder)
    return StoredArchive(folder)
