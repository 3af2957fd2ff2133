"""Read files that may come from anywhere: open them without blocking and read them within a size limit.

In:  a path.
Out: its content, or an ``OSError`` with the reason: it is a pipe, a device or a link, or larger than the limit.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import zipfile
from pathlib import Path
from typing import BinaryIO

LARGEST = 1 << 30  # bytes; limit for a file that is read whole
LARGEST_TABLE = 4 << 20  # bytes; limit for a text table, about a hundred thousand rows
SMALL = 32 << 20  # bytes; anything may decompress to this much
UNFOLDED = 256 << 20  # bytes; any file may take this much memory
_BLOCK = 1 << 20


def open_plain(path: str | Path, links: bool = True) -> BinaryIO:
    """Open a plain file for reading. ``links``: whether the path may be a link to a plain file.

    Raises
    ------
    OSError
        If it does not exist or is not a plain file.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if links else os.O_NOFOLLOW)
    handle = os.open(path, flags)
    if not stat.S_ISREG(kind := os.fstat(handle).st_mode):
        os.close(handle)
        if stat.S_ISDIR(kind):
            raise IsADirectoryError(errno.EISDIR, "is a folder", str(path))
        raise OSError(errno.EINVAL, "is not a plain file", str(path))
    return os.fdopen(handle, "rb")


def check_plain(path: str | Path) -> None:
    """Check that a file is plain, for a library that opens it itself; also refuse a sparse file that is
    mostly holes.
    """
    with open_plain(path) as file:
        _refuse_hollow(os.fstat(file.fileno()), path)


def _refuse_hollow(state: os.stat_result, path: str | Path) -> None:
    held = 512 * state.st_blocks
    if state.st_size > LARGEST and held < state.st_size // 8:
        raise OSError(
            errno.EFBIG,
            f"is {state.st_size} bytes long, but only {held} are on disk: the remaining bytes were never written",
            str(path),
        )


def refuse_unfolding(size: int, stored: int, what: str) -> None:
    """Refuse arrays that decompress to far more bytes than they take in their file, because measured data does not
    compress so well.

    Raises
    ------
    ValueError
        If the arrays decompress to that much.
    """
    if size > UNFOLDED and size > 200 * max(stored, 1):
        raise ValueError(
            f"{what} takes {size} bytes of memory but {stored} in the file; if that is intended, store it without "
            f"compression"
        )


def table(path: str | Path, most: int = LARGEST_TABLE) -> bytes:
    """Return the content of a table file, of at most ``most`` bytes.

    Raises
    ------
    ValueError
        If it is larger.
    OSError
        If it does not exist or is not a plain file.
    """
    with open_plain(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(f"{path} is too large for a table: more than {most} bytes")
    return data


def unfolds_to(head: bytes, tail: bytes, length: int) -> int | None:
    """Return the size that compressed data states for its decompressed content, from its first 18 and last 8 bytes.

    Return 0 if the format is unknown, None if Zstandard data does not state the size. A chunk may be followed by a
    checksum; gzip has its own checksum before the size, so for gzip the smaller of the two possible values is returned.
    """
    if length < 18:
        return 0
    if head[:4] == b"\x28\xb5\x2f\xfd":  # RFC 8878, 3.1.1.1
        flag, single = head[4] >> 6, head[4] >> 5 & 1
        at, width = 5 + (not single) + (0, 1, 2, 4)[head[4] & 3], (single, 2, 4, 8)[flag]
        return int.from_bytes(head[at : at + width], "little") + 256 * (width == 2) if width else None
    if head[0] in (1, 2) and int.from_bytes(head[12:16], "little") in (length, length - 4):
        return int.from_bytes(head[4:8], "little")
    return min(int.from_bytes(part, "little") for part in (tail[4:], tail[:4])) if head[:3] == b"\x1f\x8b\x08" else 0


def size_unfolded(path: str | Path) -> tuple[int | None, int]:
    """Return the decompressed size that a file states (see ``unfolds_to``), and its length, in bytes."""
    with open_plain(path, links=False) as file:
        length, head = os.fstat(file.fileno()).st_size, file.read(18)
        file.seek(max(length - 8, 0))
        return unfolds_to(head, file.read(8), length), length


def check_entries(path: str | Path) -> None:
    """Refuse a zip file (of arrays) whose entries together take far more bytes in memory than in the file.

    Raises
    ------
    ValueError, zipfile.BadZipFile
        If the entries take that much memory, or if the file is not a zip file.
    """
    with zipfile.ZipFile(path) as whole:
        parts = whole.infolist()
    refuse_unfolding(sum(part.file_size for part in parts), sum(part.compress_size for part in parts), "it")


def content(path: str | Path, most: int = LARGEST, links: bool = True) -> bytes:
    """Return the content of a file of at most ``most`` bytes."""
    with open_plain(path, links) as file:
        if os.fstat(file.fileno()).st_size > most:  # before memory is allocated
            raise OSError(errno.EFBIG, f"is larger than {most} bytes", str(path))
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"is larger than {most} bytes", str(path))
    return data


def sha256(path: str | Path, most: int | None = LARGEST, links: bool = True) -> str:
    """Return the SHA-256 of a file of at most ``most`` bytes (None: no limit), read block by block."""
    found = hashlib.sha256()
    with open_plain(path, links) as file:
        state = os.fstat(file.fileno())
        if most is not None and state.st_size > most:
            raise OSError(errno.EFBIG, f"is larger than {most} bytes", str(path))
        _refuse_hollow(state, path)
        while block := file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()
