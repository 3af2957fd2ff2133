"""The verified store of an archive: only data that its journal confirms, also of unfinished and active runs.

In:  the folder of an archive, finished, interrupted or being written.
Out: a read-only Zarr store and its tree. Nothing is written.

On reading, a shard is assembled from the chunks that the journal records as done, in whichever files they are stored;
``status`` is also derived from the journal. A missing or altered chunk raises an error instead of giving the fill
value. Coordinates and tables that differ from the manifest also raise an error. If a run was interrupted while arrays
grew, the axes are taken from the journal. Tables are shown only once the run that wrote them has ended.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
from bisect import bisect_left, bisect_right
from collections.abc import AsyncGenerator, AsyncIterator, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype
from zarr.storage import LocalStore, WrapperStore

from etendue.archive.journaling.journal import Read
from etendue.archive.read import reading
from etendue.archive.read.left_out_arrays import LeftOutArrays
from etendue.archive.read.reading import StoredArchive, StoredChunk
from etendue.archive.read.tree import Tree
from etendue.archive.read.vouched.assembled import Assembled
from etendue.archive.read.vouched.columns import with_columns
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA, damaged, digest_of, read_manifest
from etendue.archive.records.names import ROOT, STATUS, cell_label
from etendue.archive.records.owner import is_running
from etendue.archive.sharding.chunks import decode
from etendue.archive.sharding.shards import ShardFiles, fits, index_size
from etendue.archive.sharding.unfolding import refuse_codecs, refuse_unfolding
from etendue.contract.values.names import TABLES
from etendue.errors import ArchiveError
from etendue.types.arrays import Array
from etendue.types.documents import DocumentView

LOOKS = 4  # attempts at a chunk while a run is writing: its part may become a shard between two attempts


def open_archive(folder: str | Path, journal: Read | None = None) -> xarray.DataTree:
    """Open an archive as a lazy ``xarray.DataTree``, also during its run and after an interrupted one.

    Every finished cell can be read, wherever it is stored at the moment, and ``status`` says which cells are finished.
    Plain ``xarray.open_datatree(folder / "data.zarr")`` sees only published results. ``journal``: the journal, if it
    has been read already.

    Raises
    ------
    ArchiveError
        There is no archive, or nothing in it can be read yet. Reading an array with lost chunks raises it too.
    """
    folder = Path(folder)
    store = VouchedStore.of(reading.open_archive(folder, journal))
    if store.root is None:
        store.hold(f"{DATA}/{ROOT}", None)
        raise ArchiveError(f"{folder}: nothing can be read yet; its run has only just started")
    with reading.metadata_of(folder):
        store.refuse_codecs()
        tree = xarray.open_datatree(store, engine="zarr", consolidated=store.whole)  # type: ignore[arg-type]
    tree = with_columns(tree, store)
    tree.encoding["source"] = str(folder.absolute() / DATA)  # as xarray sets it for a path
    return tree


class VouchedStore(WrapperStore[LocalStore]):
    """A Zarr store that reads the files of an archive; files that are not complete on disk are assembled as the journal
    says.

    Attributes
    ----------
    root : the metadata of the whole store; None if no run has written it yet
    whole : whether the last run ended normally
    """

    def __init__(self, store: LocalStore, folder: Path, archive: StoredArchive) -> None:
        super().__init__(store)
        self.folder, self.archive = folder, archive
        self.root = disk.read_document(folder / DATA / ROOT)
        self.manifest = read_manifest(folder)
        self.whole = self.manifest is not None and "consolidated_metadata" in (self.root or {})
        self.small: dict[str, Mapping[str, bytes]] = {}
        self.left_out = LeftOutArrays(archive)
        self.assembled: dict[str, Assembled] = {}

    @classmethod
    def of(cls, archive: StoredArchive) -> VouchedStore:
        """Return the store of an archive that is open for reading."""
        return cls(LocalStore(archive.folder / DATA, read_only=True), archive.folder, archive)

    def _with_store(self, store: LocalStore) -> VouchedStore:
        return VouchedStore(store, self.folder, self.archive)

    # -- the Zarr store interface -------------------------------------------------------------------------------------

    async def get(
        self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        prototype = prototype or default_buffer_prototype()
        group, _, file = key.rpartition("/")
        if self._hidden(key):
            return None
        if self._is_of_cells(group, file):
            data = await asyncio.to_thread(self._cells, f"{DATA}/{key}", byte_range)
        else:
            own = await asyncio.to_thread(self._made, key)
            if own is None:
                read = await self._store.get(key, prototype, byte_range)
                await asyncio.to_thread(self.hold, f"{DATA}/{key}", read, byte_range is None)
                self._refuse_unfolding(key, read)
                if key == ROOT and self.left_out.by_node and read is not None and byte_range is None:
                    return prototype.buffer.from_bytes(
                        await asyncio.to_thread(self.left_out.consolidated, read.to_bytes())
                    )
                return read
            data = _cut(own, byte_range)
        return None if data is None else prototype.buffer.from_bytes(data)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    # Zarr 3.4 and later can bypass ``get`` through these methods and reach the files unchecked, so they are overridden:

    async def get_ranges(
        self, key: str, byte_ranges: Sequence[ByteRequest | None], *, prototype: BufferPrototype, **_: Any
    ) -> AsyncIterator[Sequence[tuple[int, Buffer | None]]]:
        for number, byte_range in enumerate(byte_ranges):
            yield [(number, await self.get(key, prototype, byte_range))]

    async def _get_many(
        self, requests: Iterable[tuple[str, BufferPrototype, ByteRequest | None]]
    ) -> AsyncGenerator[tuple[str, Buffer | None], None]:
        for key, prototype, byte_range in requests:
            yield key, await self.get(key, prototype, byte_range)

    @property
    def _supports_sync_io(self) -> bool:
        return False

    async def exists(self, key: str) -> bool:
        if self._hidden(key):
            return False
        group, _, file = key.rpartition("/")
        if self._is_of_cells(group, file):
            return self._has(f"{DATA}/{key}")
        return (group in self.left_out.by_node and file == ROOT) or await self._store.exists(key)

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        found = set()
        async for name in self._store.list_dir(prefix):
            if prefix or not self._hidden(name):
                found.add(name.rstrip("/"))
                yield name
        for one in self.archive.followed:
            if one.group == prefix.strip("/") and one.variable not in found:
                yield one.variable

    @cached_property
    def ours(self) -> set[str]:
        """Return the groups of the store that runs have written."""
        return {*TABLES, *(group.partition("/")[0] for group in self.archive.journal.axes)}

    def _refuse_unfolding(self, key: str, read: Buffer | None) -> None:
        """Refuse a coordinate or table whose decompressed size is implausible, or that names a codec that no
        run uses.
        """
        if read is None or key.partition("/")[0] not in self.ours:
            return
        try:
            if not key.endswith(ROOT):
                refuse_unfolding(read.to_bytes())
            else:
                refuse_codecs(disk.read_document(self.folder / DATA / key) or {})
        except ArchiveError as error:
            raise ArchiveError(f"{self.folder / DATA / key}: {error}") from None

    def refuse_codecs(self) -> None:
        """Check the codecs of all nodes in the consolidated metadata of the root."""
        nodes = (self.root or {}).get("consolidated_metadata", {}).get("metadata", {}) if self.whole else {}
        for path, node in nodes.items():
            if path.partition("/")[0] in self.ours and isinstance(node, dict):
                refuse_codecs(node)

    def _hidden(self, key: str) -> bool:
        return not self.whole and key.split("/")[0] in TABLES

    def hold(self, path: str, read: Buffer | None, entire: bool = True) -> None:
        """Check a file of metadata, a coordinate or a table of a finished run against the manifest; raise an error if
        it differs.
        """
        known = self.manifest.metadata.get(path) if self.manifest else None
        if known is None or (read is not None and (not entire or hashlib.sha256(read.to_bytes()).hexdigest() == known)):
            return
        now = read_manifest(self.folder)  # None: another run has begun and may change these files
        if now is not None and digest_of(self.folder / path) != now.metadata.get(path, ""):
            raise damaged(self.folder, [path])

    # -- chunks of cells ----------------------------------------------------------------------------------------------

    @cached_property
    def _elsewhere(self) -> dict[str, dict[int, StoredChunk]]:
        """The chunks, by slot, of each file that a variable without an array would have."""
        return dict(self.left_out.files())

    def _has(self, path: str) -> bool:
        """Return whether a shard holds any chunk of a finished cell."""
        return path in self.archive.by_shard or path in self._elsewhere

    def _assembled(self, path: str) -> Assembled:
        """Return a shard as it is assembled from the chunks of finished cells."""
        known = self.assembled.get(path)
        if known is None:
            files = self.archive.journal.said.files
            chunks = [self.archive.chunk(files[number]) for number in self.archive.by_shard.get(path, ())]
            by_slot = self._elsewhere.get(path) or {chunk.written.slot: chunk for chunk in chunks}
            node = path.removeprefix(f"{DATA}/").rpartition("/")[0]
            form = self.left_out.form(node) if node in self.left_out.by_node else chunks[0].form if chunks else None
            slots = form.slots if form and not self.archive.journal.files_a_cell else 0
            known = self.assembled[path] = Assembled.of(slots, by_slot)
        return known

    def _is_of_cells(self, node: str, file: str) -> bool:
        group, _, name = node.rpartition("/")
        journal = self.archive.journal
        if journal.files_a_cell:
            return self._has(f"{DATA}/{node}/{file}")
        return file.startswith("c") and (name in journal.blocks.get(group, ()) or node in self.left_out.by_node)

    def _cells(self, path: str, asked: ByteRequest | None) -> bytes | None:
        """Return a byte range of a shard assembled from the chunks of finished cells only, in the order of their
        slots.
        """
        shard = self._assembled(path)
        if not shard.chunks:
            return None
        with ShardFiles(self.folder) as files:
            if not shard.slots:
                return _cut(self.chunk(shard.chunks[0], files), asked)
            size = shard.ends[-1]
            begin, end = _range(asked, size + index_size(shard.slots))
            first, last = bisect_right(shard.ends, begin), min(bisect_left(shard.ends, end) + 1, len(shard.ends))
            data = b"".join(self.chunk(chunk, files) for chunk in shard.chunks[first:last])
        start = shard.ends[first - 1] if first else 0
        return (data + shard.index if end > size else data)[begin - start : end - start]

    def chunk(self, chunk: StoredChunk, files: ShardFiles) -> bytes:
        """Return the bytes of a chunk, checked against the journal.

        Raises
        ------
        ArchiveError
            The bytes are missing or damaged.
        """
        archive = self.archive
        for look in range(LOOKS):
            place = archive.place(chunk)
            try:
                data = files.read(place) if place else b""
            except OSError:
                data = b""
            if place and (archive.journal.files_a_cell or fits(data, place)):
                return data
            if not look and not is_running(self.folder):
                break
            archive = StoredArchive(self.folder)
        said, numbers = self.archive.journal.said, self.archive.by_shard.get(chunk.written.path, ())
        cell = next((said.cell_of(n) for n in reversed(numbers) if said.files[n] == chunk.written), "")
        raise ArchiveError(
            f"{self.folder}: {chunk.variable} of {cell or 'a cell'} is missing or damaged; "
            f"repair it with: etendue verify --repair {self.folder}"
        )

    # -- metadata, coordinates and status -----------------------------------------------------------------------------

    def _made(self, key: str) -> bytes | None:
        """Return the bytes of a file as the journal describes it, if the file on disk may be older; None to use the
        file on disk.
        """
        node = key.removesuffix(f"/{ROOT}") if key.endswith(f"/{ROOT}") else key.partition("/c/")[0].removesuffix("/c")
        if node in self.left_out.by_node:
            return self.left_out.metadata.get(key)
        group, _, name = node.rpartition("/")
        axes = self.archive.journal.axes.get(group)
        if axes is None or self.archive.journal.files_a_cell or (self.whole and name != "status"):
            return None
        if node not in self.small:
            self.small[node] = self._array(group, name, axes)
        return self.small[node].get(key)

    def _array(self, group: str, name: str, axes: Mapping[str, list[Any]]) -> Mapping[str, bytes]:
        """Return, by path, the files of an array whose axes may have grown since it was written."""
        document = disk.read_document(self.folder / DATA / group / name / ROOT)
        if document is None or document.get("node_type") != "array":
            return {}
        dims = tuple(document.get("dimension_names") or ())
        shape = tuple(
            len(axes[dim]) if dim in axes else size for dim, size in zip(dims, document["shape"], strict=True)
        )
        tree, attrs = Tree(), document.get("attributes", {})
        if name == "status":
            tree.put_array(group, name, self._status(group, axes), dims, attrs)
        elif dims == (name,) and name in axes:
            tree.put_array(group, name, axes[name], dims, attrs)
        elif shape == tuple(document["shape"]):
            return {}
        elif name in self.archive.journal.blocks.get(group, ()):
            return {f"{group}/{name}/{ROOT}": json.dumps({**document, "shape": shape}).encode()}
        else:
            tree.put_array(group, name, self._grown(f"{group}/{name}", document, shape), dims, attrs)
        return tree.files()

    def _grown(self, node: str, document: DocumentView, shape: tuple[int, ...]) -> Array:
        """Return a coordinate along grown axes: the values on disk, and NaN for values that are not written yet."""
        dtype, old = np.dtype(document["data_type"]), tuple(document["shape"])
        data = disk.content_of((self.folder / DATA / node).joinpath("c", *("0" for _ in shape))) or b""
        try:
            return decode(data, dtype.str, shape)
        except ArchiveError:
            whole = np.full(shape, np.nan, dtype)
            with suppress(ArchiveError):
                whole[tuple(slice(size) for size in old)] = decode(data, dtype.str, old)
            return whole

    def _status(self, group: str, axes: Mapping[str, list[Any]]) -> Array:
        """Return the status of every cell of a group according to the journal."""
        flags = np.full(tuple(map(len, axes.values())), STATUS.index("not_computed"), np.uint8)
        archive, folder = self.archive, f"{DATA}/{group}"
        flag = np.frombuffer(bytes(archive.journal.said.status), np.uint8)
        for path, numbers in archive.by_shard.items():
            if path.rpartition("/")[0].rpartition("/")[0] == folder:
                own = flag[self._rows[np.asarray(numbers)]]
                flags[archive.positions(path)] = own if axes else own[-1]
        for one in archive.followed:
            for position, (cell, _) in one.cells.items() if one.group == group else ():
                flags[position] = STATUS.index(cell.entry.status)
        for position, status in self._ended.get(group, {}).items():
            flags[position] = STATUS.index(status)
        return flags

    @cached_property
    def _rows(self) -> Array:
        """Return, by number of the chunk, the row of its cell in the journal."""
        return self.archive.journal.said.rows_of_chunks()

    @cached_property
    def _ended(self) -> dict[str, dict[tuple[int, ...], str]]:
        """Return, by group and position, the status of every cell that ended without a result. Such cells have no
        chunks, so their group follows only from their axis values.
        """
        entries = self.archive.journal.said
        left = {name: entries[name].status for name in entries.having("failed")}
        places: dict[str, list[tuple[str, tuple[int, ...]]]] = {}
        stages = {name.split(" ")[0] for name in left}
        for group, axes in self.archive.journal.axes.items():
            stage = group.split("/")[0]
            for at in product(*(range(len(values)) for values in axes.values())) if stage in stages else ():
                label = cell_label(stage, {dim: values[i] for i, (dim, values) in zip(at, axes.items(), strict=True)})
                if label in left:
                    places.setdefault(label, []).append((group, at))
        found: dict[str, dict[tuple[int, ...], str]] = {}
        for name, own in places.items():
            for group, at in own:
                if len(own) == 1 or self._said(group, at) == left[name]:
                    found.setdefault(group, {})[at] = left[name]
        return found

    def _said(self, group: str, at: tuple[int, ...]) -> str:
        """Return the status of a cell in the store on disk; '' if there is none."""
        path = self.folder / DATA / group / "status"
        try:
            shape = tuple((disk.read_document(path / ROOT) or {})["shape"])
            return STATUS[int(decode(path.joinpath("c", *("0" for _ in shape)).read_bytes(), "u1", shape)[at])]
        except (OSError, ArchiveError, KeyError, IndexError):
            return ""


def _range(asked: ByteRequest | None, size: int) -> tuple[int, int]:
    """Return the first byte and the end of a requested byte range."""
    if isinstance(asked, RangeByteRequest):
        return min(asked.start, size), min(asked.end, size)
    if isinstance(asked, OffsetByteRequest):
        return min(asked.offset, size), size
    if isinstance(asked, SuffixByteRequest):
        return max(size - asked.suffix, 0), size
    return 0, size


def _cut(data: bytes, asked: ByteRequest | None) -> bytes:
    begin, end = _range(asked, len(data))
    return data[begin:end]
