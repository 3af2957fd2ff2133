"""The store as it must be: every file of it that is no chunk of a cell, made in memory by zarr's own API.

In:  groups, arrays, coordinates, tables.
Out: bytes by path. What a file on disk should hold is known before it is read or written, so a damaged one is found and
written again, and nothing on disk has to be removed to make place for it.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.core.buffer import default_buffer_prototype
from zarr.storage import MemoryStore

from etendue.archive.chunks import CODEC, LEVEL

FILL: dict[str, Any] = {"float32": float("nan"), "float64": float("nan"), "uint8": 0, "uint16": 0, "uint32": 0}
ROOT = "zarr.json"


def codecs() -> list[Any]:
    return [BloscCodec(cname=CODEC, clevel=LEVEL, shuffle="bitshuffle"), Crc32cCodec()]  # type: ignore[arg-type]


class Tree:
    """A store in memory: metadata, coordinates, status and tables, not the variables of cells."""

    def __init__(self) -> None:
        self.held: dict[str, Any] = {}
        self.root = zarr.open_group(MemoryStore(store_dict=self.held), mode="w", zarr_format=3)

    def files(self, below: str = "") -> dict[str, bytes]:
        """Every file by path; of one group only, where it is named."""
        return {path: held.to_bytes() for path, held in self.held.items() if not below or path.startswith(f"{below}/")}

    def take(self, files: Mapping[str, bytes]) -> None:
        """Files that are on disk already."""
        make = default_buffer_prototype().buffer.from_bytes
        self.held.update({path: make(data) for path, data in files.items()})

    def drop(self, below: str) -> None:
        for path in [path for path in self.held if path.startswith(f"{below}/")]:
            del self.held[path]

    def put_group(self, path: str, attrs: Mapping[str, Any]) -> Any:
        return self.root.create_group(path, attributes=dict(attrs), overwrite=True)

    def put_array(self, group: str, name: str, values: Any, dims: tuple[str, ...], attrs: Mapping[str, Any]) -> None:
        """One whole small array (a coordinate, a status, a column of a table)."""
        values = np.asarray(values)
        text = values.dtype.kind in "UO"
        own: dict[str, Any] = {"dtype": str} if text else {
            "dtype": values.dtype, "fill_value": float("nan") if values.dtype.kind == "f" else 0, "compressors": codecs(),
            "config": {"write_empty_chunks": True},
        }  # fmt: skip
        array = self.root.create_array(
            f"{group}/{name}", shape=values.shape, chunks=tuple(max(s, 1) for s in values.shape), dimension_names=dims,
            attributes=dict(attrs), overwrite=True, **own,
        )  # fmt: skip
        if values.size:
            array[...] = values.astype(object) if text else values

    def put_cells(
        self, group: str, name: str, shape: tuple[int, ...], chunks: tuple[int, ...], dtype: str, dims: tuple[str, ...],
        attrs: Mapping[str, Any],
    ) -> None:  # fmt: skip
        """A variable whose chunks are cells: its metadata alone."""
        self.root.create_array(
            f"{group}/{name}", shape=shape, chunks=chunks, dtype=dtype, fill_value=FILL[dtype], compressors=codecs(),
            dimension_names=dims, config={"write_empty_chunks": True}, overwrite=True, attributes=dict(attrs),
            chunk_key_encoding={"name": "default", "separator": "."},  # no folder per axis: 0.2 ms each
        )  # fmt: skip

    def consolidated(self, others: Mapping[str, bytes]) -> bytes:
        """The root's metadata with that of all nodes in it; ``others``: metadata of groups that are not ours, left out where unfit."""
        before = dict(self.held)
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message=".*[Cc]onsolidated metadata.*")
                self.take(others)
                try:
                    zarr.consolidate_metadata(self.root.store)
                except Exception:
                    if not others:
                        raise
                    self.held.clear()
                    self.held.update(before)
                    zarr.consolidate_metadata(self.root.store)
            whole: bytes = self.held[ROOT].to_bytes()
        finally:
            self.held.clear()
            self.held.update(before)
        return whole


def incompatible(old: Mapping[str, Any] | None, new: Mapping[str, Any]) -> bool:
    """Whether chunks written for the old metadata of an array cannot be read by the new: of unknown metadata they may not be."""
    if old is None:
        return True
    words = ("data_type", "codecs", "chunk_key_encoding", "chunk_grid")
    return any(old.get(word) != new.get(word) for word in words)
