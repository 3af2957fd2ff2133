"""A shard as it is read from the verified store: only the chunks of finished cells, from any file.

In:  chunks by slot.
Out: the chunks in the order of their slots, the end of each chunk (bytes), and the index after them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate

from etendue.archive.read.reading import StoredChunk
from etendue.archive.sharding.shards import index_bytes


@dataclass(frozen=True)
class Assembled:
    """A shard that contains only the chunks of finished cells, in the order of their slots; ``ends``: end of each
    chunk, bytes.
    """

    slots: int
    chunks: list[StoredChunk]
    ends: list[int]
    index: bytes

    @classmethod
    def of(cls, slots: int, by_slot: Mapping[int, StoredChunk]) -> Assembled:
        chunks = [by_slot[slot] for slot in sorted(by_slot)]
        ends = list(accumulate(chunk.written.size for chunk in chunks))
        sizes = ((end, chunk.written.size) for end, chunk in zip(ends, chunks, strict=True))
        places = {slot: (end - size, size) for slot, (end, size) in zip(sorted(by_slot), sizes, strict=True)}
        return cls(slots, chunks, ends, index_bytes(slots, places) if slots else b"")
