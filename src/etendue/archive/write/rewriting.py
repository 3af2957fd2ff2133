"""Rewrite an archive from one folder to another: axes sorted, shards cut as for a new sweep, every chunk with the same
bytes.

In:  an archive open for reading, and the target folder.
Out: its shards, metadata and journal. Each chunk is checked against its checksum on the way.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np

from etendue import interrupts
from etendue.archive.journaling.entries import Entry
from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.journaling.journal import Journal
from etendue.archive.read.reading import StoredArchive, StoredCell, StoredChunk, StoredForm
from etendue.archive.read.tree import Tree
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA, read_manifest, write_manifest
from etendue.archive.records.manifest import NAME as MANIFEST
from etendue.archive.records.names import ROOT
from etendue.archive.records.owner import fresh_id
from etendue.archive.sharding.shards import ChunkPlace, Shard, holds, index_bytes, index_size, read_bytes, read_index
from etendue.archive.structure.cutting import blocks_of
from etendue.archive.write.clearing import nodes_on_disk
from etendue.contract.ports import WrittenChunk
from etendue.errors import ArchiveError
from etendue.types.documents import Document

WASTE = 8  # a shard is rewritten if unused bytes exceed one eighth of its chunks
BESIDE = ("contact_sheet.png", "ro-crate-metadata.json", "CITATION.cff", "measured.json")
Chunks = Mapping[int, tuple[StoredCell, StoredChunk]]  # of a shard, by slot


@dataclass(frozen=True)
class Compacted:
    """The result: number of cells, number of shards, bytes of their chunks; the sorted axes by group; all bytes
    written.
    """

    folder: Path
    cells: int
    shards: int
    bytes: int
    sorted: Mapping[str, list[str]]
    written: int = 0

    @property
    def amplification(self) -> float:
        """Return the number of bytes written per byte of cells."""
        return self.written / self.bytes if self.bytes else 0.0


class Anew:
    """The rewriting of an archive from one folder to another.

    ``shares``: files that need no change are hard-linked into the new folder, and everything written survives a power
    cut.
    """

    def __init__(self, archive: StoredArchive, target: Path, shares: bool = False) -> None:
        self.archive, self.old, self.target, self.shares = archive, archive.folder, target, shares
        self.written = 0
        self.listing = disk.Listing(self.old)
        self.tree = Tree()
        self.order = {
            group: {dim: _order(values) for dim, values in axes.items()} for group, axes in archive.journal.axes.items()
        }
        self.axes = {
            group: {dim: [values[i] for i in self.order[group][dim]] for dim, values in axes.items()}
            for group, axes in archive.journal.axes.items()
        }
        chunks = [(cell, chunk) for cell in archive.cells.values() for chunk in cell.chunks]
        self.by_variable: dict[tuple[str, str], list[tuple[StoredCell, StoredChunk]]] = {}
        for cell, chunk in chunks:
            self.by_variable.setdefault((chunk.group, chunk.variable), []).append((cell, chunk))
        self.forms = self._cut()

    def _cut(self) -> dict[tuple[str, str], StoredForm]:
        """Return the form of every variable in the new archive."""
        forms = {key: own[0][1].form for key, own in self.by_variable.items()}
        given = []
        for (group, _), form in forms.items():
            sizes = tuple(len(values) for values in self.axes[group].values())
            given.append((sizes, prod(form.shape) * int(np.dtype(form.dtype).itemsize), form.pieces))
        return {
            key: replace(form, block=block) for (key, form), block in zip(forms.items(), blocks_of(given), strict=True)
        }

    def write(self) -> Compacted:
        entries, shards, size = self._chunks()
        self._metadata()
        for folder in ("inputs", "runs"):
            if (self.old / folder).is_dir():
                shutil.copytree(self.old / folder, self.target / folder, copy_function=self._copied)
        for name in BESIDE:
            if (self.old / name).is_file():
                self._copied(self.old / name, self.target / name)
        self._put("lock", b"")
        self._put("run.id", fresh_id().encode())
        self._journal(entries, shards)
        write_manifest(self.target, {f"{DATA}/{path}": data for path, data in self._ours().items()}, self.shares)
        self.written += sum((self.target / name).stat().st_size for name in (JOURNAL, MANIFEST))
        return Compacted(self.target, len(self.archive.cells), len(shards), size, self.changed(), self.written)

    def _ours(self) -> dict[str, bytes]:
        """Return the files of the store that runs have written; foreign groups are not in the manifest."""
        known = read_manifest(self.old)
        tops = {node.split("/")[0] for node in known.nodes()} if known else set(self.listing.folders[DATA])
        return {path: data for path, data in self.tree.held.items() if path == ROOT or path.split("/")[0] in tops}

    def changed(self) -> dict[str, list[str]]:
        """Return the axes that must be sorted, by group."""
        own = {
            group: [dim for dim, order in dims.items() if order != list(range(len(order)))]
            for group, dims in self.order.items()
        }
        return {group: dims for group, dims in own.items() if dims}

    def needed(self) -> int:
        """Return the bytes of the shards that must be written; 0 if no shard must be written."""
        return sum(
            chunk.written.size
            for path, own in self.shards.items()
            if not self._stays(path, own)
            for _, chunk in own.values()
        )

    def _put(self, path: str, data: bytes) -> None:
        disk.write(self.target, path, data, self.shares)
        self.written += len(data)

    def _copied(self, source: str | Path, target: str | Path) -> None:
        """Copy a file unchanged; with ``shares``, link it if the file system allows this."""
        if self.shares:
            with suppress(OSError):
                os.link(source, target)
                return
        shutil.copy2(source, target)
        self.written += os.stat(target).st_size

    # -- chunks -------------------------------------------------------------------------------------------------------

    def _chunks(self) -> tuple[dict[str, list[WrittenChunk]], dict[str, Shard], int]:
        """Put every chunk into its new shard; return chunk positions by cell, the shards and the total bytes."""
        placed: dict[str, list[WrittenChunk]] = {name: [] for name in self.archive.cells}
        shards: dict[str, Shard] = {}
        for path, own in self.shards.items():
            interrupts.check()
            if self.shares and self._stays(path, own) and self._shared(path):
                shards[path] = self.archive.journal.shards[path]
                for cell, chunk in own.values():
                    placed[cell.name].append(chunk.written)
            else:
                shards[path] = self._shard(path, own, placed)
        return placed, shards, sum(one.size for own in placed.values() for one in own)

    @cached_property
    def shards(self) -> dict[str, dict[int, tuple[StoredCell, StoredChunk]]]:
        """Map every new shard to its chunks by slot."""
        found: dict[str, dict[int, tuple[StoredCell, StoredChunk]]] = {}
        for key, own in self.by_variable.items():
            for cell, chunk in own:
                path, slot = self._place(key, chunk)
                found.setdefault(path, {})[slot] = cell, chunk
        return found

    def _stays(self, path: str, own: Chunks) -> bool:
        """Return True if a shard can be kept: its chunks are in their slots, with few unused bytes."""
        slots, archive = self._slots(own), self.archive
        if archive.journal.files_a_cell or archive.finder.odd(path, slots) or path not in archive.journal.shards:
            return False
        if any((chunk.written.path, chunk.written.slot) != (path, slot) for slot, (_, chunk) in own.items()):
            return False
        places = {slot: archive.place(chunk) for slot, (_, chunk) in own.items()}
        index = {slot: (place.offset, place.size) for slot, place in places.items() if place and place.file == path}
        state, held = archive.finder.state(path, slots), sum(size for _, size in index.values())
        if state is None or state.index != index or len(index) != len(own):
            return False
        return state.size - held - index_size(slots) <= held // WASTE

    def _slots(self, own: Chunks) -> int:
        _, chunk = next(iter(own.values()))
        return self.forms[chunk.group, chunk.variable].slots

    def _shared(self, path: str) -> bool:
        """Link a shard into the new folder; return whether that succeeded."""
        (self.target / path).parent.mkdir(parents=True, exist_ok=True)
        with suppress(OSError):
            if (self.target / path).exists():
                if os.path.samefile(self.old / path, self.target / path):
                    return True
                disk.remove(self.target, path)
            os.link(self.old / path, self.target / path)
            return True
        return False

    def _place(self, key: tuple[str, str], chunk: StoredChunk) -> tuple[str, int]:
        """Return the new shard and slot of a chunk."""
        form, slot, shard = self.forms[key], 0, []
        axes = self.order[key[0]].values()
        for at, order, size in zip(chunk.position, axes, form.block, strict=True):
            index, local = divmod(order.index(at), size)
            shard.append(str(index))
            slot = slot * size + local
        name = ".".join(["c", *shard, *("0" for _ in form.shape)])
        return f"{DATA}/{key[0]}/{key[1]}/{name}", slot * form.pieces + chunk.written.slot % form.pieces

    def _shard(self, path: str, own: Chunks, placed: dict[str, list[WrittenChunk]]) -> Shard:
        part, slots, places = os.urandom(6).hex(), self._slots(own), dict[int, tuple[int, int]]()

        def pieces() -> Iterator[bytes]:
            end = 0
            for slot in sorted(own):
                data = self._read(*own[slot])
                places[slot] = end, len(data)
                end += len(data)
                yield data
            if slots:
                yield index_bytes(slots, places)

        if not self._is_there(path, slots, own):
            disk.write(self.target, path, pieces(), self.shares)
            self.written += (self.target / path).stat().st_size
        end = 0
        for slot in sorted(own):
            cell, chunk = own[slot]
            size, digest = self._known(chunk)
            placed[cell.name].append(WrittenChunk(path, slot, part, end, size, digest))
            end += size
        return Shard((self.target / path).stat().st_size, ((part, 0, 0, end),))

    def _known(self, chunk: StoredChunk) -> tuple[int, int]:
        """Return size and checksum of a chunk that has been read."""
        if not self.archive.journal.files_a_cell:
            return chunk.written.size, chunk.written.digest
        data = (self.old / chunk.written.path).read_bytes()
        return len(data), int.from_bytes(data[-4:], "little")

    def _is_there(self, path: str, slots: int, own: Chunks) -> bool:
        """Return True if an interrupted attempt has already written this shard; all its chunks are checked."""
        if not self.shares or self.archive.journal.files_a_cell:
            return False
        places, end = dict[int, tuple[int, int]](), 0
        for slot in sorted(own):
            places[slot] = end, own[slot][1].written.size
            end += places[slot][1]
        try:
            if read_index(self.target / path, slots) != (end + index_size(slots), places if slots else {0: (0, end)}):
                return False
        except OSError:
            return False
        return all(
            holds(self.target, ChunkPlace(path, *places[slot], chunk.written.digest))
            for slot, (_, chunk) in own.items()
        )

    def _read(self, cell: StoredCell, chunk: StoredChunk) -> bytes:
        place: ChunkPlace | None = self.archive.place(chunk)
        data = read_bytes(self.old, place) if place else b""
        if (
            place is None
            or len(data) != place.size
            or int(google_crc32c.value(data[:-4])).to_bytes(4, "little") != data[-4:]
        ):
            raise ArchiveError(
                f"{self.old / chunk.written.path}: {chunk.variable} of {cell.name} is missing or damaged; recompute it "
                f"first by "
                f"running its pipeline on the archive with --recompute"
            )
        return data

    # -- metadata and journal -----------------------------------------------------------------------------------------

    def _metadata(self) -> None:
        """Write arrays along the reordered axes; copy everything else unchanged."""
        nodes = sorted(node for folder in self.listing.folders[DATA] for node in nodes_on_disk(self.listing, folder))
        root = disk.read_document(self.old / DATA / ROOT) or {}
        attributes = dict(root.get("attributes", {}))
        self.tree.put_group("", attributes | {"etendue": {**attributes.get("etendue", {}), "format": 2}})
        for node in nodes:
            self._node(node)
        self.tree.take({ROOT: self.tree.consolidated({})})
        for path, data in self.tree.held.items():
            self._put(f"{DATA}/{path}", data)

    def _node(self, node: str) -> None:
        document = disk.read_document(self.old / DATA / node / ROOT) or {}
        group, _, name = node.rpartition("/")
        dims, order = document.get("dimension_names") or [], self.order.get(group, {})
        attrs = dict(document.get("attributes", {}))
        if (group, name) in self.forms:
            self.tree.put_cells(node, tuple(document["shape"]), self.forms[group, name], tuple(dims), attrs)
        elif set(dims) & {dim for dim, own in order.items() if own != list(range(len(own)))}:
            import zarr

            values = np.asarray(zarr.open_array(str(self.old / DATA / node), mode="r")[...])
            for number, dim in enumerate(dims):
                values = np.take(values, order[dim], axis=number) if dim in order else values
            if dims == [name]:
                attrs.pop("order", None)
            self.tree.put_array(group, name, values, tuple(dims), attrs)
        else:
            # The node's metadata, chunks and any foreign files beside them; nodes below it are handled on their own.
            place = f"{DATA}/{node}"
            chunks = (path for path in self.listing.below(place) if path.startswith(f"{place}/c/"))
            own = (*(f"{place}/{file}" for file in self.listing.files.get(place, ())), *chunks)
            self.tree.take({path.removeprefix(f"{DATA}/"): (self.old / path).read_bytes() for path in own})

    def _journal(self, placed: Mapping[str, list[WrittenChunk]], shards: Mapping[str, Shard]) -> None:
        before, journal = self.archive.journal, Journal(self.target, self.shares)
        journal.open()
        try:
            journal.set_axes(self.axes)
            journal.set_arrays(before.arrays)
            for path, text in before.records.items():
                journal.record(path, text)
            blocks: dict[str, dict[str, Document]] = {}
            for (group, name), form in self.forms.items():
                words = {"block": list(form.block), "codec": form.codec, "pieces": form.pieces}
                words |= {"chunk": list(form.chunk)} if form.pieces > 1 else {}
                blocks.setdefault(group, {})[name] = {**words, "form": f"{form.dtype} {'x'.join(map(str, form.shape))}"}
            journal.set_blocks(blocks)
            journal.set_same(before.same)
            journal.put(shards)
            kept: list[tuple[str, Entry]] = [
                (name, replace(entry, files=tuple(placed.get(name, ()))))
                for name, entry in before.entries.items()
                if entry.event != "start"
            ]
            journal.end(kept)
            if before.run is not None:
                journal.begin_run(before.run.planned, {})
            journal.closed()
        finally:
            journal.close()


def _order(values: list[Any]) -> list[int]:
    """Return the positions of axis values in sorted order; texts and descending values keep their order."""
    plain = not any(isinstance(value, str) for value in values)
    if plain and values not in (sorted(values), sorted(values, reverse=True)):
        return sorted(range(len(values)), key=values.__getitem__)
    return list(range(len(values)))
