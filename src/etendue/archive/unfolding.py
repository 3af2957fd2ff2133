"""How large a chunk becomes, from its first bytes: asked before memory for it is.

In:  the bytes of a chunk as they are stored; the metadata of a node.
Out: nothing, or an ``ArchiveError``: it unfolds beyond all measure, or by a codec that no run uses.
"""

from __future__ import annotations

from pathlib import Path

from etendue import plain_files
from etendue.archive import disk
from etendue.errors import ArchiveError
from etendue.types.documents import DocumentView

MOST = 32 << 20  # bytes of a coordinate or a table that may be as small in its file as one likes
FOLD = 200  # times that a larger one may be larger than in its file
OURS = frozenset({"bytes", "blosc", "crc32c", "vlen-utf8", "zstd", "sharding_indexed"})
_HEADER = 18  # bytes that say it, of Blosc and of Zstandard


def refuse_unfolding(data: bytes | memoryview) -> None:
    """Refuse a chunk of a coordinate or a table that unfolds to far more than it is."""
    _refuse(plain_files.unfolds_to(bytes(data[:_HEADER]), bytes(data[-8:]), len(data)), len(data))


def _refuse(size: int | None, length: int) -> None:
    if size is None:
        raise ArchiveError("the stored bytes do not say how many they unfold to")
    if size > MOST and size > FOLD * length:
        raise ArchiveError(f"the stored bytes say that they unfold to {size}, from {length}")


def check_array(folder: Path) -> None:
    """Refuse an array of the store that a library would make far more of than it is; shards of cells are not looked
    at.
    """
    try:
        refuse_codecs(disk.read_document(folder / "zarr.json") or {})
        for chunk in (folder / "c").rglob("*"):
            if chunk.is_file() and not chunk.is_symlink():
                _refuse(*plain_files.size_unfolded(chunk))
    except ArchiveError as error:
        raise ArchiveError(f"{folder}: {error}") from None


def check_group(folder: Path) -> None:
    """The same of all arrays in a group."""
    for node in sorted(folder.glob("*/zarr.json")):
        check_array(node.parent)


def refuse_other_size(body: bytes, size: int) -> None:
    """Refuse what Blosc has written, unless it unfolds to so many bytes and is all that its header says."""
    said, own = (int.from_bytes(body[at : at + 4], "little") for at in (4, 12))
    if len(body) < 16 or (said, own) != (size, len(body)):
        raise ArchiveError(
            f"the stored bytes say that they unfold to {said} from {own}; they are {len(body)}, of {size}"
        )


def refuse_codecs(node: DocumentView) -> None:
    """Refuse an array that is to be read by a codec that no run uses."""
    found = node.get("codecs", [])
    for one in found if isinstance(found, list) else [found]:
        name = one.get("name") if isinstance(one, dict) else one
        if not isinstance(name, str) or name not in OURS:
            raise ArchiveError(f"its metadata names the codec {str(name)[:40]!r}, which no run uses")
