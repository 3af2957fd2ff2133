"""The folders of an archive on the way to its files, opened one after the other and never through a link.

In:  the folder of an archive (itself not a link), paths below it as text.
Out: open handles of folders, kept for the next path; the errors about content that an archive must not hold.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from etendue.errors import ArchiveError

FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC
_LINKED = (errno.ELOOP, errno.ENOTDIR)  # the error codes for a link or a file in the place of a folder


class Folders:
    """Open handles of the folders on the way to a file. In a sorted list of paths, each path shares most handles with
    the previous path.

    ``make``: create missing folders, after a call of ``change``; with ``durable`` the new folders survive a power cut.
    Use as a context manager.
    """

    def __init__(
        self, root: str | Path, make: bool = False, durable: bool = False, change: Callable[[], None] | None = None
    ) -> None:
        self.root, self.make, self.durable, self.change = root, make, durable, change
        self.parts: list[str] = []
        self.handles = [os.open(root, FOLDER)]

    def __enter__(self) -> Folders:
        return self

    def __exit__(self, *_: object) -> None:
        self._close(0)
        os.close(self.handles.pop())

    def of(self, path: str) -> tuple[int, str]:
        """Return the handle of a file's folder, valid until the next path, and the file's name in it."""
        *parts, name = path.split("/")
        shared = 0
        for own, part in zip(self.parts, parts, strict=False):
            if own != part:
                break
            shared += 1
        self._close(shared)
        for part in parts[shared:]:
            try:
                self.handles.append(self._below(part))
            except OSError as error:
                if error.errno in _LINKED:
                    raise in_place_of_folder(Path(self.root), "/".join([*self.parts, part])) from None
                raise
            self.parts.append(part)
        return self.handles[-1], name

    def _below(self, part: str) -> int:
        here = self.handles[-1]
        try:
            return os.open(part, FOLDER, dir_fd=here)
        except FileNotFoundError:
            if not self.make:
                raise
            if self.change is not None:
                self.change()
            with suppress(FileExistsError):  # another worker has created it
                os.mkdir(part, dir_fd=here)
                if self.durable:
                    os.fsync(here)
            return os.open(part, FOLDER, dir_fd=here)

    def _close(self, kept: int) -> None:
        """Close all handles except the handles of the leading folders that the next path shares."""
        while len(self.parts) > kept:
            self.parts.pop()
            os.close(self.handles.pop())


def link_at(root: Path, path: str) -> ArchiveError:
    """Return the error about a link inside an archive."""
    try:
        target = os.readlink(root / path)
    except OSError:
        target = "?"
    short = target if len(target) <= 60 else f"...{target[-57:]}"
    return ArchiveError(
        f"{root / path} is a link (to {short}); an archive must not contain links, because runs write and remove "
        f"files in it. "
        f"Replace it by the files themselves, or use another archive with --archive DIR"
    )


def in_place_of_folder(root: Path, path: str) -> ArchiveError:
    """Return the error about a link or file where an archive has a folder."""
    if (root / path).is_symlink():
        return link_at(root, path)
    return ArchiveError(
        f"{root / path} is not a folder, although an archive has a folder at this place; move it elsewhere"
    )


def in_place_of_file(root: Path, path: str) -> ArchiveError:
    """Return the error about a folder or special file where an archive has a file."""
    return ArchiveError(
        f"{root / path} is not a regular file, although an archive has a file at this place; move it elsewhere"
    )
