"""Files that somebody else may have made: opened without waiting, read within a bound.

In:  a path.
Out: its content, or an ``OSError`` that says why not: what stands there is a pipe, a device or a link, or has no end.
"""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from pathlib import Path
from typing import BinaryIO

LARGEST = 1 << 30  # bytes of a file that is read whole
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
            errno.EFBIG, f"it is {state.st_size} bytes long, of which {held} are on the disk: the rest was never written", str(path)
        )


def refuse_unfolding(size: int, stored: int, what: str) -> None:
    """Refuse numbers that take far more memory than room in their file: nobody measures so many that are alike.

    Raises
    ------
    ValueError
        They do.
    """
    if size > UNFOLDED and size > 200 * max(stored, 1):
        raise ValueError(f"{what} takes {size} bytes of memory, from {stored} in the file; if that is meant, store it without compression")


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
