"""A process that ends at an operation on files, without a process: from there on nothing below a folder changes any
more.

In:  a folder, the number of an operation below it.
Out: ``Died`` is raised there, and again by whatever tries to change something on the way out, as if nobody had lived to
     do it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

CHANGES = (
    "write",
    "pwrite",
    "pwritev",
    "replace",
    "rename",
    "unlink",
    "remove",
    "mkdir",
    "rmdir",
    "ftruncate",
    "copy_file_range",
    "link",
)


class Died(BaseException):
    """Nothing may catch it."""


class Operations:
    """The changes of files below a folder, counted."""

    def __init__(self, root: Path, at: int) -> None:
        self.root, self.at, self.names = str(root), at, list[str]()

    def __len__(self) -> int:
        return len(self.names)

    def meet(self, name: str, real: Any) -> Any:
        def attempt(*given: Any, **named: Any) -> Any:
            target = given[1] if name == "copy_file_range" else given[0]
            reads = name == "open" and not given[1] & (os.O_CREAT | os.O_TRUNC)
            if not reads and self._below(target, named.get("dir_fd", named.get("src_dir_fd"))):
                self.names.append(name)
                if self.at and len(self.names) >= self.at:
                    raise Died
            return real(*given, **named)

        return attempt

    def _below(self, target: Any, folder: int | None) -> bool:
        try:
            if isinstance(target, int):
                path = os.readlink(f"/proc/self/fd/{target}")
            else:
                path = os.path.join(
                    os.readlink(f"/proc/self/fd/{folder}") if folder is not None else os.getcwd(), os.fspath(target)
                )
        except OSError:
            return False
        return path.startswith(self.root)


@contextmanager
def dying(root: Path, at: int = 0) -> Iterator[Operations]:
    """Die at an operation below a folder, or beside it under a name that begins like it; 0: count them."""
    operations = Operations(root, at)
    with mock.patch.multiple(os, **{name: operations.meet(name, getattr(os, name)) for name in (*CHANGES, "open")}):
        yield operations
