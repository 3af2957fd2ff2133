"""Check the decompressed size of a chunk, from its first bytes, before memory is allocated.

In:  the stored bytes of a chunk; the metadata of a node.
Out: nothing, or an ``ArchiveError`` if its decompressed size is implausible or it uses a codec that no run uses.
"""

from __future__ import annotations

from pathlib import Path

from etendue import plain_files
from etendue.archive.records import disk
from etendue.errors import ArchiveError
from etendue.types.documents import DocumentView

MOST = 32 << 20  # bytes; up to this size a coordinate or table may be compressed to any ratio
FOLD = 200  # largest compression ratio above that size
OURS = frozenset({"bytes", "blosc", "crc32c", "vlen-utf8", "zstd", "sharding_indexed"})
_HEADER = 18  # bytes of a Blosc or Zstandard header that give the size


def refuse_unfolding(data: bytes | memoryview) -> None:
    """Refuse a chunk of a coordinate or table that decompresses to an implausible size."""
    _refuse(plain_files.unfolds_to(bytes(data[:_HEADER]), bytes(data[-8:]), len(data)), len(data))


def _refuse(size: int | None, length: int) -> None:
    if size is None:
        raise ArchiveError("the stored bytes do not state their decompressed size")
    if size > MOST and size > FOLD * length:
        raise ArchiveError(f"the stored bytes claim to decompress from {length} to {size} bytes")


def check_array(folder: Path) -> None:
    """Refuse an array that a library would decompress to an implausible size; shards of cells are not checked."""
    try:
        refuse_codecs(disk.read_document(folder / "zarr.json") or {})
        for chunk in (folder / "c").rglob("*"):
            if chunk.is_file() and not chunk.is_symlink():
                _refuse(*plain_files.size_unfolded(chunk))
    except ArchiveError as error:
        raise ArchiveError(f"{folder}: {error}") from None


def check_group(folder: Path) -> None:
    """Apply ``check_array`` to all arrays in a group."""
    for node in sorted(folder.glob("*/zarr.json")):
        check_array(node.parent)


def refuse_other_size(body: bytes, size: int) -> None:
    """Refuse Blosc data unless it decompresses to ``size`` bytes and has the length that its header states."""
    said, own = (int.from_bytes(body[at : at + 4], "little") for at in (4, 12))
    if len(body) < 16 or (said, own) != (size, len(body)):
        raise ArchiveError(
            f"the stored bytes claim to decompress from {own} to {said} bytes; expected {len(body)} to {size}"
        )


def refuse_codecs(node: DocumentView) -> None:
    """Refuse an array with a codec that no run uses."""
    found = node.get("codecs", [])
    for one in found if isinstance(found, list) else [found]:
        name = one.get("name") if isinstance(one, dict) else one
        if not isinstance(name, str) or name not in OURS:
            raise ArchiveError(f"its metadata names the codec {str(name)[:40]!r}, which no run uses")
