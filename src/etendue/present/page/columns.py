"""Packed columns of numbers for a page: one blob for all, a hundredth of the size of JSON.

In:  arrays.
Out: the location of each; the blob as text: base64 of deflated bytes, with the n-th bytes of all numbers of a column
     grouped together, which compresses better.
"""

from __future__ import annotations

import base64
import zlib
from typing import TYPE_CHECKING

import numpy as np

from etendue.types.arrays import Array
from etendue.types.documents import Document

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

KINDS: dict[str, np.dtype[np.generic]] = {
    "f4": np.dtype("<f4"),
    "f8": np.dtype("<f8"),
    "u1": np.dtype("u1"),
    "u2": np.dtype("<u2"),
    "u4": np.dtype("<u4"),
}


class Columns:
    """Arrays in the order in which they were added."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def put(self, values: ArrayLike, kind: str = "f4") -> Document:
        """Add an array, flattened in C order; return ``{"at": byte, "count": numbers, "kind": "f4"}``."""
        flat = np.ascontiguousarray(values).ravel().astype(KINDS[kind])
        shuffled = flat.view("u1").reshape(-1, KINDS[kind].itemsize).T.tobytes()
        place = {"at": self._size, "count": int(flat.size), "kind": kind}
        self._parts.append(shuffled)
        self._size += len(shuffled)
        return place

    def words(self, texts: Array) -> Document:
        """Add texts that repeat: store each distinct text once, and an index into them for every entry."""
        known, which = np.unique(np.asarray(texts, dtype=object).astype(str), return_inverse=True)
        kind = "u1" if len(known) <= 256 else "u2" if len(known) <= 65536 else "u4"
        return {**self.put(which, kind), "words": [str(word) for word in known]}

    def text(self) -> str:
        return base64.b64encode(zlib.compress(b"".join(self._parts), 6)).decode()
