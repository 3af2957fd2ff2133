"""How large a chunk becomes, from its first bytes: asked before memory for it is.

In:  the bytes of a chunk as they are stored; the metadata of a node.
Out: nothing, or an ``ArchiveError``: it unfolds beyond all measure, or by a codec that no run uses.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from etendue.errors import ArchiveError

MOST = 32 << 20  # bytes of a coordinate or a table that may be as small in its file as one likes
FOLD = 200  # times that a larger one may be larger than in its file
OURS = frozenset({"bytes", "blosc", "crc32c", "vlen-utf8", "zstd", "sharding_indexed"})
_ZSTD = b"\x28\xb5\x2f\xfd"
_HEADER = 16  # bytes of Blosc's


def refuse_unfolding(data: bytes | memoryview) -> None:
    """Refuse a chunk of a coordinate or a table that unfolds to far more than it is."""
    size = zstd_size(data) if data[:4] == _ZSTD else blosc_size(data) if _is_blosc(data) else 0
    if size is None:
        raise ArchiveError("the stored bytes do not say how many they unfold to")
    if size > MOST and size > FOLD * len(data):
        raise ArchiveError(f"the stored bytes say that they unfold to {size}, from {len(data)}")


def refuse_other_size(body: bytes, size: int) -> None:
    """Refuse what Blosc has written, unless it unfolds to so many bytes and is all that its header says."""
    if len(body) < _HEADER or blosc_size(body) != size or _word(body, 12) != len(body):
        told = f"{blosc_size(body)} from {_word(body, 12)}, not {size} from {len(body)}" if len(body) >= _HEADER else "nothing"
        raise ArchiveError(f"the stored bytes say that they unfold to {told}")


def blosc_size(data: bytes | memoryview) -> int:
    """Bytes that Blosc says a chunk unfolds to."""
    return _word(data, 4)


def zstd_size(data: bytes | memoryview) -> int | None:
    """Bytes that a frame of Zstandard says it unfolds to; None where it does not (RFC 8878, 3.1.1.1)."""
    if len(data) < 18:
        return 0  # too short to unfold to anything large; what it is, is found where it is read
    descriptor = data[4]
    flag, single = descriptor >> 6, descriptor >> 5 & 1
    at = 5 + (not single) + (0, 1, 2, 4)[descriptor & 3]
    width = (single, 2, 4, 8)[flag]
    return int.from_bytes(data[at : at + width], "little") + 256 * (width == 2) if width else None


def refuse_codecs(node: Mapping[str, Any]) -> None:
    """Refuse an array that is to be read by a codec that no run uses."""
    found = node.get("codecs", [])
    for one in found if isinstance(found, list) else [found]:
        name = one.get("name") if isinstance(one, dict) else one
        if not isinstance(name, str) or name not in OURS:
            raise ArchiveError(f"its metadata names the codec {str(name)[:40]!r}, which no run uses")


def _is_blosc(data: bytes | memoryview) -> bool:
    return len(data) > _HEADER and data[0] in (1, 2) and _word(data, 12) in (len(data), len(data) - 4)


def _word(data: bytes | memoryview, at: int) -> int:
    return int.from_bytes(data[at : at + 4], "little")
