"""An archive written anew: axes sorted, shards cut as for a fresh sweep, every chunk with the bytes it has.

In:  the folder of an archive whose last run has ended in order, of this form or with a file for every chunk.
Out: another archive beside it, whole or not at all. The old one is only read.

Each chunk is held against its checksum on the way. What somebody else has put into the store is copied as it is.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np

from etendue.archive import disk
from etendue.archive.clearing import nodes_on_disk
from etendue.archive.cutting import blocks_of
from etendue.archive.entries import Entry
from etendue.archive.journal import Journal
from etendue.archive.manifest import DATA, read_manifest, write_manifest
from etendue.archive.owner import fresh_id
from etendue.archive.reading import Form, StoredArchive, StoredCell, StoredChunk, open_archive
from etendue.archive.shards import Place, Shard, index_bytes, read_bytes
from etendue.archive.tree import ROOT, Tree
from etendue.errors import ArchiveError, ArchiveInUse
from etendue.spec.ports import Written

ASIDE = ".compact.partial"
BESIDE = ("contact_sheet.png", "ro-crate-metadata.json", "CITATION.cff", "measured.json")


@dataclass(frozen=True)
class Compacted:
    """What was written: shards, cells and bytes of their chunks; the axes that were sorted, by group."""

    folder: Path
    cells: int
    shards: int
    bytes: int
    sorted: Mapping[str, list[str]]


def compact(old: Path, new: Path) -> Compacted:
    """Write an archive anew.

    Raises
    ------
    ArchiveError
        The old one is none, is unfinished or damaged; something stands in the place of the new one.
    ArchiveInUse
        A run is writing to it.
    """
    old, aside = old.resolve(), new.parent.resolve() / f".{new.name}{ASIDE}"
    if new.exists() or new.is_symlink():
        raise ArchiveError(f"{new} exists; name a new folder for the archive that is to be written")
    archive = open_archive(old)
    lock = os.open(old / "lock", os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ArchiveInUse(f"{old} is in use by a run; write it anew when that has ended") from None
        _check(old, archive)
        if aside.is_symlink():
            raise disk.link_at(aside.parent, aside.name)
        shutil.rmtree(aside, ignore_errors=True)  # of an earlier attempt that was killed
        aside.mkdir()
        try:
            done = _Anew(archive, aside).write()
            aside.rename(new)
        except BaseException:
            shutil.rmtree(aside, ignore_errors=True)
            raise
    finally:
        os.close(lock)
    return replace(done, folder=new)


def _check(old: Path, archive: StoredArchive) -> None:
    manifest = read_manifest(old)
    changed = ["manifest.json"] if manifest is None else manifest.changed(old)
    if changed or archive.journal.damaged or archive.journal.torn:
        raise ArchiveError(
            f"{old / (changed or ['journal.jsonl'])[0]} is missing or not as a run left it: only an archive in order is written anew. "
            f"Run its pipeline on it first"
        )


class _Anew:
    """An archive on its way from one folder to another."""

    def __init__(self, archive: StoredArchive, target: Path) -> None:
        self.archive, self.old, self.target = archive, archive.folder, target
        self.listing = disk.Listing(self.old)
        self.tree = Tree()
        self.order = {group: {dim: _order(values) for dim, values in axes.items()} for group, axes in archive.journal.axes.items()}
        self.axes = {
            group: {dim: [values[i] for i in self.order[group][dim]] for dim, values in axes.items()}
            for group, axes in archive.journal.axes.items()
        }
        chunks = [(cell, chunk) for cell in archive.cells.values() for chunk in cell.chunks]
        self.by_variable: dict[tuple[str, str], list[tuple[StoredCell, StoredChunk]]] = {}
        for cell, chunk in chunks:
            self.by_variable.setdefault((chunk.group, chunk.variable), []).append((cell, chunk))
        self.forms = self._cut()

    def _cut(self) -> dict[tuple[str, str], Form]:
        """How every variable is cut now."""
        forms = {key: own[0][1].form for key, own in self.by_variable.items()}
        given = []
        for (group, _), form in forms.items():
            sizes = tuple(len(values) for values in self.axes[group].values())
            given.append((sizes, prod(form.shape) * int(np.dtype(form.dtype).itemsize), form.pieces))
        return {key: replace(form, block=block) for (key, form), block in zip(forms.items(), blocks_of(given), strict=True)}

    def write(self) -> Compacted:
        entries, shards, size = self._chunks()
        self._metadata()
        for folder in ("inputs", "runs"):
            if (self.old / folder).is_dir():
                shutil.copytree(self.old / folder, self.target / folder)
        for name in BESIDE:
            if (self.old / name).is_file():
                shutil.copy2(self.old / name, self.target / name)
        disk.write(self.target, "lock", b"")
        disk.write(self.target, "run.id", fresh_id().encode())
        self._journal(entries, shards)
        write_manifest(self.target, {f"{DATA}/{path}": data for path, data in self.tree.held.items()})
        changed = {group: [dim for dim, order in own.items() if order != list(range(len(order)))] for group, own in self.order.items()}
        return Compacted(self.target, len(self.archive.cells), len(shards), size, {g: dims for g, dims in changed.items() if dims})

    # -- chunks -------------------------------------------------------------------------------------------------------

    def _chunks(self) -> tuple[dict[str, list[Written]], dict[str, Shard], int]:
        """Every chunk into its new shard; where it stands there, by cell."""
        placed: dict[str, list[Written]] = {name: [] for name in self.archive.cells}
        shards: dict[str, Shard] = {}
        for key, own in self.by_variable.items():
            by_shard: dict[str, dict[int, tuple[StoredCell, StoredChunk]]] = {}
            for cell, chunk in own:
                path, slot = self._place(key, chunk)
                by_shard.setdefault(path, {})[slot] = cell, chunk
            for path, slots in by_shard.items():
                shards[path] = self._shard(path, self.forms[key].slots, slots, placed)
        return placed, shards, sum(one.size for own in placed.values() for one in own)

    def _place(self, key: tuple[str, str], chunk: StoredChunk) -> tuple[str, int]:
        """Shard and slot of a chunk."""
        form, slot, shard = self.forms[key], 0, []
        axes = self.order[key[0]].values()
        for at, order, size in zip(chunk.position, axes, form.block, strict=True):
            index, local = divmod(order.index(at), size)
            shard.append(str(index))
            slot = slot * size + local
        name = ".".join(["c", *shard, *("0" for _ in form.shape)])
        return f"{DATA}/{key[0]}/{key[1]}/{name}", slot * form.pieces + (chunk.band or 0)

    def _shard(
        self, path: str, slots: int, own: Mapping[int, tuple[StoredCell, StoredChunk]], placed: dict[str, list[Written]]
    ) -> Shard:  # fmt: skip
        part, end, places = os.urandom(6).hex(), 0, {}

        def pieces() -> Iterator[bytes]:
            nonlocal end
            for slot in sorted(own):
                cell, chunk = own[slot]
                data = self._read(cell, chunk)
                placed[cell.name].append(Written(path, slot, part, end, len(data), int.from_bytes(data[-4:], "little")))
                places[slot] = end, len(data)
                end += len(data)
                yield data
            if slots:
                yield index_bytes(slots, places)

        disk.write(self.target, path, pieces())
        return Shard((self.target / path).stat().st_size, ((part, 0, 0, end),))

    def _read(self, cell: StoredCell, chunk: StoredChunk) -> bytes:
        place: Place | None = self.archive.place(chunk)
        data = read_bytes(self.old, place) if place else b""
        if place is None or len(data) != place.size or int(google_crc32c.value(data[:-4])).to_bytes(4, "little") != data[-4:]:
            raise ArchiveError(
                f"{self.old / chunk.written.path}: {chunk.variable} of {cell.name} is missing or damaged; compute it again first, by "
                f"running its pipeline on the archive with --recompute"
            )
        return data

    # -- what stands around them --------------------------------------------------------------------------------------

    def _metadata(self) -> None:
        """Arrays along axes in their new order; everything else as it is."""
        nodes = sorted(node for folder in self.listing.folders[DATA] for node in nodes_on_disk(self.listing, folder))
        root = disk.read_document(self.old / DATA / ROOT) or {}
        attributes = dict(root.get("attributes", {}))
        self.tree.put_group("", attributes | {"etendue": {**attributes.get("etendue", {}), "format": 2}})
        for node in nodes:
            self._node(node)
        self.tree.take({ROOT: self.tree.consolidated({})})
        for path, data in self.tree.held.items():
            disk.write(self.target, f"{DATA}/{path}", data)

    def _node(self, node: str) -> None:
        document = disk.read_document(self.old / DATA / node / ROOT) or {}
        group, _, name = node.rpartition("/")
        dims, order = document.get("dimension_names") or [], self.order.get(group, {})
        attrs = dict(document.get("attributes", {}))
        if (group, name) in self.forms:
            form = self.forms[group, name]
            own = (1, *form.shape[1:]) if form.pieces > 1 else tuple(max(n, 1) for n in form.shape)
            whole = tuple(max(n, 1) for n in form.shape)
            chunks = (*(1 for _ in form.block), *own), (*form.block, *whole) if form.block or whole else None
            self.tree.put_cells(group, name, tuple(document["shape"]), chunks, form.dtype, form.codec, tuple(dims), attrs)
        elif set(dims) & {dim for dim, own in order.items() if own != list(range(len(own)))}:
            values = self._values(node)
            for number, dim in enumerate(dims):
                values = np.take(values, order[dim], axis=number) if dim in order else values
            if dims == [name]:
                attrs.pop("order", None)
            self.tree.put_array(group, name, values, tuple(dims), attrs)
        else:
            own_files = [path for path in self.listing.below(f"{DATA}/{node}") if self._belongs(path, node)]
            self.tree.take({path.removeprefix(f"{DATA}/"): (self.old / path).read_bytes() for path in own_files})

    def _belongs(self, path: str, node: str) -> bool:
        """Whether a file is of a node itself: its metadata, its chunks, what somebody has put beside them."""
        folder = path.rpartition("/")[0].removeprefix(f"{DATA}/")
        return folder == node or folder.startswith(f"{node}/c/") or folder == f"{node}/c"

    def _values(self, node: str) -> Any:
        import zarr

        return np.asarray(zarr.open_array(str(self.old / DATA / node), mode="r")[...])

    def _journal(self, placed: Mapping[str, list[Written]], shards: Mapping[str, Shard]) -> None:
        before, journal = self.archive.journal, Journal(self.target)
        journal.open()
        try:
            journal.set_axes(self.axes)
            journal.set_arrays(before.arrays)
            for path, text in before.records.items():
                journal.record(path, text)
            blocks: dict[str, dict[str, dict[str, Any]]] = {}
            for (group, name), form in self.forms.items():
                words = {"block": list(form.block), "codec": form.codec, "pieces": form.pieces}
                blocks.setdefault(group, {})[name] = {**words, "form": f"{form.dtype} {'x'.join(map(str, form.shape))}"}
            journal.set_blocks(blocks)
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
    """The positions of axis values in sorted order; texts, and values in falling order, stay as they are."""
    plain = not any(isinstance(value, str) for value in values)
    if plain and values not in (sorted(values), sorted(values, reverse=True)):
        return sorted(range(len(values)), key=values.__getitem__)
    return list(range(len(values)))
