"""Metrics of all cells as columns: small variables of an archive are read shard by shard, not cell by cell.

In:  a tree that xarray has opened from the verified store of an archive.
Out: the same tree, in which each small variable is an array that reads all its cells at once, when it is first used.

Zarr decodes every chunk by itself, at about 0.1 ms each; a metric of 9,000 cells has 9,000 chunks of a few bytes. Every
chunk is still checked against the journal, and a missing cell has the fill value of its array.
"""

from __future__ import annotations

import threading
from functools import cached_property
from math import prod
from typing import Any, Protocol

import numpy as np
import xarray
from xarray.backends import BackendArray
from xarray.core import indexing

from etendue.archive.read.reading import StoredArchive, StoredChunk
from etendue.archive.read.shard_columns import shard_column
from etendue.archive.records.manifest import DATA
from etendue.archive.sharding.chunks import decode
from etendue.archive.sharding.shards import ShardFiles
from etendue.types.arrays import Array

LARGEST_CELL = 4096  # bytes; larger cells cost more to copy than to decode
LARGEST = 64 << 20  # bytes of a variable that is read as a whole
_READING = threading.Lock()  # of the module: a column can be pickled and copied


class Verified(Protocol):
    """The members of the verified store that this module uses."""

    archive: StoredArchive

    def chunk(self, chunk: StoredChunk, files: ShardFiles) -> bytes: ...


def with_columns(tree: xarray.DataTree, store: Verified) -> xarray.DataTree:
    """Return a tree in which every small variable is one lazy array that reads all its cells at once."""
    if store.archive.journal.files_a_cell:
        return tree
    for path, own in store.archive.journal.blocks.items():
        try:
            node: Any = tree[path]
        except KeyError:
            continue
        group = node.to_dataset(inherit=False)
        columns = {name: column for name in own if (column := _column(group, store, path, name)) is not None}
        if columns:
            node.dataset = group.assign(columns)
    return tree


def _column(group: xarray.Dataset, store: Verified, path: str, name: str) -> xarray.Variable | None:
    """Return a variable as a column; None if the variable is not small, or xarray has decoded it to other values."""
    if name not in group.data_vars:
        return None
    variable, form = group[name].variable, store.archive.form(path, name)
    size = variable.dtype.itemsize * prod(form.shape)
    plain = not {"_FillValue", "scale_factor", "add_offset"} & (variable.encoding.keys() | variable.attrs.keys())
    axes = len(form.block)
    fits = variable.dtype == np.dtype(form.dtype) and variable.shape[axes:] == form.shape and form.pieces == 1
    if not (plain and fits and axes) or size > LARGEST_CELL or size * prod(variable.shape[:axes]) > LARGEST:
        return None
    lazy = indexing.LazilyIndexedArray(_Column(store, f"{DATA}/{path}/{name}/", variable))
    return xarray.Variable(variable.dims, lazy, variable.attrs, variable.encoding)


class _Column(BackendArray):
    """A small variable; reading one cell reads all cells."""

    def __init__(self, store: Verified, folder: str, variable: xarray.Variable) -> None:
        self.store, self.folder = store, folder
        self.shape, self.dtype = variable.shape, variable.dtype
        self.fill = variable.encoding.get("fill_value")

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.BASIC, self._part)

    def _part(self, key: tuple[Any, ...]) -> Any:
        with _READING:
            whole = self.whole
        return whole[key].copy()

    @cached_property
    def whole(self) -> Array:
        nothing = np.nan if self.dtype.kind == "f" else 0
        found = np.full(self.shape, nothing if self.fill is None else self.fill, self.dtype)
        archive = self.store.archive
        written = archive.journal.said.files
        with ShardFiles(archive.folder) as files:
            for path, numbers in archive.by_shard.items():
                if not path.startswith(self.folder):
                    continue
                own: Any = shard_column(archive, path, files)
                if own is None:
                    chunks = [archive.chunk(written[number]) for number in numbers]
                    own = [
                        decode(self.store.chunk(chunk, files), chunk.form.dtype, chunk.form.shape, chunk.form.codec)
                        for chunk in chunks
                    ]
                found[archive.positions(path)] = own
        return found
