"""The expected store: every file of the store except chunks of cells, built in memory.

In:  groups, arrays, coordinates, tables.
Out: bytes by path. The expected content of a file is known before the file is read or written, so damaged files are
found and rewritten, and nothing on disk has to be deleted to make room.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from etendue.archive.read.reading import StoredForm
from etendue.archive.records.names import ROOT
from etendue.archive.sharding.chunks import CODEC, encode
from etendue.archive.structure.cutting import chunk_shapes
from etendue.archive.structure.metadata import TEXT, array_node, consolidated, document, text_chunk
from etendue.process import unwarned
from etendue.types.documents import DocumentView

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


class Tree:
    """A store in memory: metadata, coordinates, status and tables, without the variables of cells."""

    def __init__(self) -> None:
        self.held: dict[str, bytes] = {}
        self.nodes: dict[str, DocumentView] = {}  # the metadata among ``held`` that was built here

    def files(self, below: str = "") -> dict[str, bytes]:
        """Return the bytes of every file by path, or only of the files of one group."""
        return {path: data for path, data in self.held.items() if not below or path.startswith(f"{below}/")}

    def take(self, files: Mapping[str, bytes]) -> None:
        """Add files (bytes by path) that already exist on disk."""
        self.held.update(files)
        for path in files:
            self.nodes.pop(path, None)

    def put_group(self, path: str, attrs: DocumentView) -> None:
        self._put(path, {"attributes": dict(attrs), "zarr_format": 3, "node_type": "group"})

    def _put(self, path: str, node: DocumentView) -> None:
        file = f"{path}/{ROOT}" if path else ROOT
        self.held[file], self.nodes[file] = document(node), node

    def put_array(self, group: str, name: str, values: ArrayLike, dims: tuple[str, ...], attrs: DocumentView) -> None:
        """Add one small array as a whole (a coordinate, a status, a column of a table)."""
        values, path = np.asarray(values), f"{group}/{name}"
        text = values.dtype.kind in "UO"
        chunks = tuple(max(s, 1) for s in values.shape)
        self._put(
            path, array_node(TEXT if text else values.dtype.str, values.shape, chunks, None, CODEC, dims, "/", attrs)
        )
        if values.size:
            data = text_chunk(list(map(str, values.ravel().tolist()))) if text else encode(values)
            self.held["/".join([path, "c", *["0"] * values.ndim])] = data

    def put_cells(
        self, path: str, shape: tuple[int, ...], form: StoredForm, dims: tuple[str, ...], attrs: DocumentView
    ) -> None:
        """Add the metadata of a variable whose chunks are cells, in shards. Shards have flat names, because creating
        a folder per axis costs 0.2 ms.
        """
        chunks = chunk_shapes(form.shape, form.block, form.chunk)
        self._put(path, array_node(form.dtype, shape, *chunks, form.codec, dims, ".", attrs))

    def consolidated(self, others: Mapping[str, bytes]) -> bytes:
        """Return the metadata of the root, including the metadata of all nodes; ``others``: metadata of foreign groups,
        omitted if zarr cannot read it.
        """
        if others:
            try:
                return _consolidated({**self.held, **others})
            except Exception:  # whatever zarr raises for foreign metadata
                pass
        nodes = {
            path: self.nodes.get(path) or json.loads(data) for path, data in self.held.items() if path.endswith(ROOT)
        }
        return document(consolidated({path[: -len(ROOT)].rstrip("/"): node for path, node in nodes.items()}))


def _consolidated(files: Mapping[str, bytes]) -> bytes:
    """Consolidate with zarr, which can read foreign metadata; without foreign metadata its slow import is avoided."""
    import zarr
    from zarr.core.buffer import default_buffer_prototype
    from zarr.storage import MemoryStore

    make = default_buffer_prototype().buffer.from_bytes
    held = {path: make(data) for path, data in files.items() if path.endswith(ROOT)}
    with unwarned("consolidated metadata"):
        zarr.consolidate_metadata(MemoryStore(store_dict=held))
    whole: bytes = held[ROOT].to_bytes()
    return whole


def content_first(path: str) -> list[str]:
    """Return a key that sorts files of the store folder by folder, the metadata of a group or array after everything
    below it, because readers find an array through its metadata.
    """
    *folders, name = path.split("/")
    return [*folders, f"\U0010ffff{name}"]


def incompatible(old: DocumentView | None, new: DocumentView) -> bool:
    """Return True if chunks written for the old metadata of an array cannot be read with the new metadata. Metadata
    that cannot be interpreted counts as incompatible.
    """
    if old is None:
        return True
    words = ("data_type", "codecs", "chunk_key_encoding", "chunk_grid")
    return any(old.get(word) != new.get(word) for word in words)
