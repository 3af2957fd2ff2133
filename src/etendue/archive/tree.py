"""The store as it must be: every file of it that is no chunk of a cell, made in memory by zarr's own API.

In:  groups, arrays, coordinates, tables.
Out: bytes by path. What a file on disk should hold is known before it is read or written, so a damaged one is found and
written again, and nothing on disk has to be removed to make place for it.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import MemoryStore

from etendue.archive.chunks import CODEC, LEVEL, encode

ROOT = "zarr.json"


def codecs() -> list[Any]:
    return [BloscCodec(cname=CODEC, clevel=LEVEL, shuffle="bitshuffle"), Crc32cCodec()]  # type: ignore[arg-type]


@lru_cache(maxsize=4096)
def _made(path: str, attrs: str, array: tuple[Any, ...] | None = None, texts: tuple[str, ...] = ()) -> dict[str, bytes]:
    """The files of one group, or array, in a store of its own. The same are asked for at every run."""
    held: dict[str, Any] = {}
    root = zarr.open_group(MemoryStore(store_dict=held), mode="w", zarr_format=3)
    if array is None:
        root.update_attributes(json.loads(attrs))
        return {f"{path}/{ROOT}" if path else ROOT: held[ROOT].to_bytes()}
    dtype, shape, chunks, dims, separator = array
    own: dict[str, Any] = {"dtype": str} if dtype == "text" else {
        "dtype": dtype, "fill_value": float("nan") if np.dtype(dtype).kind == "f" else 0, "compressors": codecs(),
        "chunk_key_encoding": {"name": "default", "separator": separator},
    }  # fmt: skip
    made = root.create_array(  # also texts that are all empty have a chunk: it takes the place of an earlier one
        "a", shape=shape, chunks=chunks, dimension_names=dims, attributes=json.loads(attrs), config={"write_empty_chunks": True}, **own
    )
    if texts:
        made[...] = np.array(texts, dtype=object).reshape(shape)
    return {path + name[1:]: data.to_bytes() for name, data in held.items() if name != ROOT}


class Tree:
    """A store in memory: metadata, coordinates, status and tables, not the variables of cells."""

    def __init__(self) -> None:
        self.held: dict[str, bytes] = {}

    def files(self, below: str = "") -> dict[str, bytes]:
        """Every file by path; of one group only, where it is named."""
        return {path: data for path, data in self.held.items() if not below or path.startswith(f"{below}/")}

    def take(self, files: Mapping[str, bytes]) -> None:
        """Files that are on disk already."""
        self.held.update(files)

    def put_group(self, path: str, attrs: Mapping[str, Any]) -> None:
        self.held.update(_made(path, json.dumps(attrs)))

    def put_array(self, group: str, name: str, values: Any, dims: tuple[str, ...], attrs: Mapping[str, Any]) -> None:
        """One whole small array (a coordinate, a status, a column of a table)."""
        values = np.asarray(values)
        text = values.dtype.kind in "UO"
        chunks = tuple(max(s, 1) for s in values.shape)
        array = ("text" if text else values.dtype.str, values.shape, chunks, dims, "/")
        texts = tuple(map(str, values.ravel().tolist())) if text else ()
        self.held.update(_made(f"{group}/{name}", json.dumps(attrs), array, texts))
        if values.size and not text:
            self.held["/".join([group, name, "c", *["0"] * values.ndim])] = encode(values)

    def put_cells(
        self, group: str, name: str, shape: tuple[int, ...], chunks: tuple[int, ...], dtype: str, dims: tuple[str, ...],
        attrs: Mapping[str, Any],
    ) -> None:  # fmt: skip
        """A variable whose chunks are cells: its metadata alone. Chunks have flat names: a folder an axis costs 0.2 ms."""
        self.held.update(_made(f"{group}/{name}", json.dumps(attrs), (dtype, shape, chunks, dims, ".")))

    def consolidated(self, others: Mapping[str, bytes]) -> bytes:
        """The root's metadata with that of all nodes in it; ``others``: metadata of groups that are not ours, left out where unfit."""
        try:
            return _consolidated({**self.held, **others})
        except Exception:  # whatever zarr says of metadata that somebody else has written
            if not others:
                raise
            return _consolidated(self.held)


def _consolidated(files: Mapping[str, bytes]) -> bytes:
    make = default_buffer_prototype().buffer.from_bytes
    held = {path: make(data) for path, data in files.items() if path.endswith(ROOT)}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*[Cc]onsolidated metadata.*")
        zarr.consolidate_metadata(MemoryStore(store_dict=held))
    whole: bytes = held[ROOT].to_bytes()
    return whole


def incompatible(old: Mapping[str, Any] | None, new: Mapping[str, Any]) -> bool:
    """Whether chunks written for the old metadata of an array cannot be read by the new: of unknown metadata they may not be."""
    if old is None:
        return True
    words = ("data_type", "codecs", "chunk_key_encoding", "chunk_grid")
    return any(old.get(word) != new.get(word) for word in words)
