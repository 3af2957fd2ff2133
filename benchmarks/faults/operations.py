"""Number the file operations of a process in one folder, so that one of them can fail or be the last.

In:  a folder, the number of an operation, the fault.
Out: a process that meets this fault; for a power loss, a folder that holds only what had been synced.
"""

from __future__ import annotations

import builtins
import contextlib
import errno
import io
import os
import random
import shutil
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

CHANGES = (
    "write",
    "pwrite",
    "pread",
    "writev",
    "pwritev",
    "replace",
    "rename",
    "unlink",
    "remove",
    "mkdir",
    "rmdir",
    "ftruncate",
    "truncate",
    "fsync",
    "fdatasync",
    "copy_file_range",
    "sendfile",
    "link",
    "posix_fallocate",
)
ERRORS = {
    "disk full": errno.ENOSPC,
    "quota used up": errno.EDQUOT,
    "input/output error": errno.EIO,
    "too many open files": errno.EMFILE,
}
KINDS = ("killed before", "killed after", "power lost", *ERRORS)
ENDED = 77


class Shadow:
    """The state of a folder that would survive a power loss: contents by file, and names by folder, as of the last
    fsync of each.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.contents: dict[int, bytes] = {}
        self.names: dict[int, dict[str, tuple[int, bool]]] = {}
        self.held: list[int] = []  # files stay open, so that their inode numbers are not reused
        self.known: set[int] = set()

    def hold(self, handle: int) -> None:
        number = os.fstat(handle).st_ino
        if number not in self.known:
            self.known.add(number)
            self.held.append(os.dup(handle))

    def synced(self, handle: int) -> None:
        state = os.fstat(handle)
        if stat.S_ISDIR(state.st_mode):
            with os.scandir(handle) as entries:
                self.names[state.st_ino] = {e.name: (e.inode(), e.is_dir(follow_symlinks=False)) for e in entries}
        else:
            with open(f"/proc/self/fd/{handle}", "rb") as file:
                self.contents[state.st_ino] = file.read()

    def lose_power(self, lot: random.Random) -> None:
        """Leave in the folder only what would survive."""
        now: dict[int, bytes] = {}
        for folder, _, files in os.walk(self.root):
            for name in files:
                path = Path(folder) / name
                now[path.stat().st_ino] = path.read_bytes()
        for handle in self.held:  # removed files too
            state = os.fstat(handle)
            if stat.S_ISREG(state.st_mode) and state.st_ino not in now:
                with contextlib.suppress(OSError), open(f"/proc/self/fd/{handle}", "rb") as file:
                    now[state.st_ino] = file.read()
        top = self.root.stat().st_ino
        aside = self.root.with_name(self.root.name + ".left")
        self.put(aside, top, now, lot)
        shutil.rmtree(self.root)
        aside.rename(self.root)

    def put(self, place: Path, number: int, now: dict[int, bytes], lot: random.Random) -> None:
        place.mkdir()
        for name, (inode, folder) in self.names.get(number, {}).items():
            if folder:
                self.put(place / name, inode, now, lot)
                continue
            safe, newest = self.contents.get(inode), now.get(inode, b"")
            if safe is None or safe != newest:
                start = safe or b""
                more = newest if newest.startswith(start) else b""
                cut = lot.choice(
                    (len(start), lot.randrange(len(start), max(len(more), len(start)) + 1), max(len(more), len(start)))
                )
                newest = more[:cut] if more else start
            (place / name).write_bytes(newest)


class Watched:
    """The numbered operations of this process below a folder, one of which may fail."""

    def __init__(self, root: Path, at: int, kind: str, lot: random.Random) -> None:
        self.root, self.at, self.kind, self.lot = root, at, kind, lot
        self.count = 0
        self.names: list[str] = []
        self.shadow = Shadow(root) if kind == "power lost" else None
        self.real = {name: getattr(os, name) for name in (*CHANGES, "open")}

    def below(self, target: Any, folder: Any) -> bool:
        try:
            if isinstance(target, int):
                path = os.readlink(f"/proc/self/fd/{target}")
            elif folder is not None:
                path = os.path.join(os.readlink(f"/proc/self/fd/{folder}"), os.fspath(target))
            else:
                path = os.path.abspath(os.fspath(target))
        except (OSError, TypeError):
            return False
        return f"{path}/".startswith(f"{self.root}/")

    def end(self) -> None:
        if self.shadow is not None:
            for name, real in self.real.items():
                setattr(os, name, real)
            self.shadow.lose_power(self.lot)
        os._exit(ENDED)

    def meet(self, name: str, work: Callable[[], Any]) -> Any:
        self.count += 1
        self.names.append(name)
        if self.count != self.at:
            return work()
        if self.kind in ERRORS:
            raise OSError(ERRORS[self.kind], os.strerror(ERRORS[self.kind]))
        if self.kind != "killed before":
            work()
        self.end()
        return None

    def wrapped(self, name: str) -> Callable[..., Any]:
        real = self.real[name]

        def call(*given: Any, **named: Any) -> Any:
            folder = named.get("dir_fd", named.get("src_dir_fd"))
            if not given or not self.below(given[1] if name in ("copy_file_range",) else given[0], folder):
                return real(*given, **named)
            if name == "open":
                flags = given[1] if len(given) > 1 else named.get("flags", 0)
                if not flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                    return real(*given, **named)
                handle = self.meet(name, lambda: real(*given, **named))
                if self.shadow is not None:
                    self.shadow.hold(handle)
                return handle
            found = self.meet(name, lambda: real(*given, **named))
            if self.shadow is not None and name in ("fsync", "fdatasync"):
                self.shadow.synced(given[0])
            return found

        return call

    def install(self) -> None:
        for name in (*CHANGES, "open"):
            setattr(os, name, self.wrapped(name))
        opened = builtins.open

        def open_(file: Any, mode: str = "r", *given: Any, **named: Any) -> Any:
            if set(mode) & set("wax+") and not isinstance(file, int) and self.below(file, None):
                found = self.meet("open", lambda: opened(file, mode, *given, **named))
                if self.shadow is not None:
                    self.shadow.hold(found.fileno())
                return found
            return opened(file, mode, *given, **named)

        builtins.open = io.open = open_  # type: ignore[assignment]
