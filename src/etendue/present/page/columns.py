"""Columns of numbers packed for a page: one blob for all of them, in a hundredth of the room that JSON would take.

In:  arrays.
Out: for each where it lies; the blob as text: base64 of deflated bytes, the n-th bytes of all numbers of a column
     beside each other.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

from etendue.types.arrays import Array
from etendue.types.documents import Document

KINDS: dict[str, np.dtype[Any]] = {
    "f4": np.dtype("<f4"),
    "f8": np.dtype("<f8"),
    "u1": np.dtype("u1"),
    "u2": np.dtype("<u2"),
    "u4": np.dtype("<u4"),
}


class Columns:
    """Arrays in the order in which they were put."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def put(self, values: Any, kind: str = "f4") -> Document:
        """Keep an array, flat in C order: ``{"at": byte, "count": numbers, "kind": "f4"}``."""
        flat = np.ascontiguousarray(values).ravel().astype(KINDS[kind])
        shuffled = flat.view("u1").reshape(-1, KINDS[kind].itemsize).T.tobytes()
        place = {"at": self._size, "count": int(flat.size), "kind": kind}
        self._parts.append(shuffled)
        self._size += len(shuffled)
        return place

    def words(self, texts: Array) -> Document:
        """Keep texts that come again and again: each once, and which one it is."""
        known, which = np.unique(np.asarray(texts, dtype=object).astype(str), return_inverse=True)
        kind = "u1" if len(known) <= 256 else "u2" if len(known) <= 65536 else "u4"
        return {**self.put(which, kind), "words": [str(word) for word in known]}

    def text(self) -> str:
        return base64.b64encode(zlib.compress(b"".join(self._parts), 6)).decode()
