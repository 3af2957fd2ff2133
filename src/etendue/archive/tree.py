"""The store as it must be: every file of it that is no chunk of a cell, made in memory.

In:  groups, arrays, coordinates, tables.
Out: bytes by path. What a file on disk should hold is known before it is read or written, so a damaged one is found and
written again, and nothing on disk has to be removed to make place for it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from etendue.archive.chunks import CODEC, encode
from etendue.archive.cutting import chunk_shapes
from etendue.archive.metadata import TEXT, array_node, consolidated, document, text_chunk
from etendue.archive.reading import Form
from etendue.process import unwarned
from etendue.types.documents import DocumentView

ROOT = "zarr.json"


class Tree:
    """A store in memory: metadata, coordinates, status and tables, not the variables of cells."""

    def __init__(self) -> None:
        self.held: dict[str, bytes] = {}
        self.nodes: dict[str, DocumentView] = {}  # of ``held`` what is metadata, and was made here

    def files(self, below: str = "") -> dict[str, bytes]:
        """Every file by path; of one group only, where it is named."""
        return {path: data for path, data in self.held.items() if not below or path.startswith(f"{below}/")}

    def take(self, files: Mapping[str, bytes]) -> None:
        """Files that are on disk already."""
        self.held.update(files)
        for path in files:
            self.nodes.pop(path, None)

    def put_group(self, path: str, attrs: DocumentView) -> None:
        self._put(path, {"attributes": dict(attrs), "zarr_format": 3, "node_type": "group"})

    def _put(self, path: str, node: DocumentView) -> None:
        file = f"{path}/{ROOT}" if path else ROOT
        self.held[file], self.nodes[file] = document(node), node

    def put_array(self, group: str, name: str, values: Any, dims: tuple[str, ...], attrs: DocumentView) -> None:
        """One whole small array (a coordinate, a status, a column of a table)."""
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
        self, path: str, shape: tuple[int, ...], form: Form, dims: tuple[str, ...], attrs: DocumentView
    ) -> None:
        """A variable whose chunks are cells, in shards: its metadata alone. Shards have flat names: a folder an axis
        costs 0.2 ms.
        """
        chunks = chunk_shapes(form.shape, form.block, form.chunk)
        self._put(path, array_node(form.dtype, shape, *chunks, form.codec, dims, ".", attrs))

    def consolidated(self, others: Mapping[str, bytes]) -> bytes:
        """The root's metadata with that of all nodes in it; ``others``: metadata of groups that are not ours, left
        out where unfit.
        """
        if others:
            try:
                return _consolidated({**self.held, **others})
            except Exception:  # whatever zarr says of metadata that somebody else has written
                pass
        nodes = {
            path: self.nodes.get(path) or json.loads(data) for path, data in self.held.items() if path.endswith(ROOT)
        }
        return document(consolidated({path[: -len(ROOT)].rstrip("/"): node for path, node in nodes.items()}))


def _consolidated(files: Mapping[str, bytes]) -> bytes:
    """By zarr, which knows what to make of metadata that others have written; its import is not paid for without
    them.
    """
    import zarr
    from zarr.core.buffer import default_buffer_prototype
    from zarr.storage import MemoryStore

    make = default_buffer_prototype().buffer.from_bytes
    held = {path: make(data) for path, data in files.items() if path.endswith(ROOT)}
    with unwarned("consolidated metadata"):
        zarr.consolidate_metadata(MemoryStore(store_dict=held))
    whole: bytes = held[ROOT].to_bytes()
    return whole


def incompatible(old: DocumentView | None, new: DocumentView) -> bool:
    """Whether chunks written for the old metadata of an array cannot be read by the new: of unknown metadata they
    may not be.
    """
    if old is None:
        return True
    words = ("data_type", "codecs", "chunk_key_encoding", "chunk_grid")
    return any(old.get(word) != new.get(word) for word in words)
