"""Files that somebody else may have made: opened without waiting, read within a bound.

In:  a path.
Out: its content, or an ``OSError`` that says why not: what stands there is a pipe, a device or a link, or has no end.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
import zipfile
from pathlib import Path
from typing import BinaryIO

LARGEST = 1 << 30  # bytes of a file that is read whole
LARGEST_TABLE = 4 << 20  # bytes of a table as text: a hundred thousand rows
SMALL = 32 << 20  # bytes that anything may unfold to
UNFOLDED = 256 << 20  # bytes of memory that any file may ask for
_BLOCK = 1 << 20


def open_plain(path: str | Path, links: bool = True) -> BinaryIO:
    """A plain file, to read; ``links``: whether its name may be a link to one.

    Raises
    ------
    OSError
        There is none, or what stands there is none.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if links else os.O_NOFOLLOW)
    handle = os.open(path, flags)
    if not stat.S_ISREG(kind := os.fstat(handle).st_mode):
        os.close(handle)
        if stat.S_ISDIR(kind):
            raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
        raise OSError(errno.EINVAL, "it is no plain file", str(path))
    return os.fdopen(handle, "rb")


def check_plain(path: str | Path) -> None:
    """The same, for a library that opens the file itself; a file that is nearly all holes is refused too."""
    with open_plain(path) as file:
        _refuse_hollow(os.fstat(file.fileno()), path)


def _refuse_hollow(state: os.stat_result, path: str | Path) -> None:
    held = 512 * state.st_blocks
    if state.st_size > LARGEST and held < state.st_size // 8:
        raise OSError(
            errno.EFBIG,
            f"it is {state.st_size} bytes long, of which {held} are on the disk: the rest was never written",
            str(path),
        )


def refuse_unfolding(size: int, stored: int, what: str) -> None:
    """Refuse numbers that take far more memory than room in their file: nobody measures so many that are alike.

    Raises
    ------
    ValueError
        They do.
    """
    if size > UNFOLDED and size > 200 * max(stored, 1):
        raise ValueError(
            f"{what} takes {size} bytes of memory, from {stored} in the file; if that is meant, store it without "
            f"compression"
        )


def table(path: str | Path, most: int = LARGEST_TABLE) -> bytes:
    """All of a file of a table, which people write and read: of at most so many bytes.

    Raises
    ------
    ValueError
        It is larger.
    OSError
        There is none, or what stands there is none.
    """
    with open_plain(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(f"{path} is larger than {most} bytes; no table is")
    return data


def unfolds_to(head: bytes, tail: bytes, length: int) -> int | None:
    """Bytes that something compressed says it unfolds to, from its first 18 bytes and its last 8; 0 of what is not
    known.

    None: Zstandard that does not say it. The checksum of a chunk may stand behind it; of gzip, whose own stands in
    front of the size, the smaller of the two is taken.
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
    """What a file says it unfolds to (see ``unfolds_to``), and its length."""
    with open_plain(path, links=False) as file:
        length, head = os.fstat(file.fileno()).st_size, file.read(18)
        file.seek(max(length - 8, 0))
        return unfolds_to(head, file.read(8), length), length


def check_entries(path: str | Path) -> None:
    """Refuse a zip file (of arrays) whose parts together take far more memory than room in it.

    Raises
    ------
    ValueError, zipfile.BadZipFile
        They do; it is none.
    """
    with zipfile.ZipFile(path) as whole:
        parts = whole.infolist()
    refuse_unfolding(sum(part.file_size for part in parts), sum(part.compress_size for part in parts), "it")


def content(path: str | Path, most: int = LARGEST, links: bool = True) -> bytes:
    """All of a file of at most so many bytes."""
    with open_plain(path, links) as file:
        if os.fstat(file.fileno()).st_size > most:  # before memory is asked for
            raise OSError(errno.EFBIG, f"it is larger than {most} bytes", str(path))
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"it is larger than {most} bytes", str(path))
    return data


def sha256(path: str | Path, most: int | None = LARGEST, links: bool = True) -> str:
    """SHA-256 of a file of at most so many bytes (None: however many), block by block."""
    found = hashlib.sha256()
    with open_plain(path, links) as file:
        state = os.fstat(file.fileno())
        if most is not None and state.st_size > most:
            raise OSError(errno.EFBIG, f"it is larger than {most} bytes", str(path))
        _refuse_hollow(state, path)
        while block := file.read(_BLOCK):
            found.update(block)
    return found.hexdigest()
