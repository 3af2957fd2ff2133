"""All disk access of an archive: nothing outside its folder is ever written, truncated or removed.

In:  the folder of an archive (itself not a link), paths below it as text, bytes.
Out: files that appear complete in their place or not at all; a listing without links.

Folders are opened one after the other and never through a link, so that the system itself refuses a link that is put
there during a run. A file is written beside its place and renamed: a second (hard) link to the old file keeps the old
bytes. Files are removed by name, and folders only if they are empty.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from etendue import plain_files
from etendue.archive.records.folders import FOLDER, Folders, in_place_of_file, in_place_of_folder, link_at
from etendue.errors import ArchiveError
from etendue.types.documents import Document

PARTIAL = ".partial"
PART = ".part"  # an unfinished shard; parts that the journal names are kept
ELSEWHERE = 1_000_000_000  # mtime in ns that marks a file whose bytes lie on an object store
FILES = (
    "journal.jsonl",
    "manifest.json",
    "run.id",
    "lock",
    "ro-crate-metadata.json",
    "CITATION.cff",
    "contact_sheet.png",
    "measured.json",
)
FOLDERS = ("data.zarr", "inputs", "runs")


@contextmanager
def _place(root: str | Path, path: str, make: bool = False, durable: bool = False) -> Iterator[tuple[int, str]]:
    """Yield an open handle of a file's folder, and the file's name in it."""
    with Folders(root, make, durable) as folders:
        yield folders.of(path)


def write_all(handle: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(handle, view) :]


def _aside(name: str) -> str:
    """Return the name under which a file is written until it is complete."""
    return f".{name[:200]}.{os.getpid()}.{threading.get_ident()}{PARTIAL}"


def write(root: str | Path, path: str, data: bytes | Iterable[bytes], durable: bool = False) -> None:
    """Write a file atomically: it is written beside its place and renamed."""
    with Folders(root, True, durable) as folders:
        _write(folders, path, data)


def put(
    root: str | Path,
    files: Iterable[tuple[str, bytes]],
    durable: bool = False,
    change: Callable[[], None] | None = None,
) -> None:
    """Write the files whose content differs from the files on disk, one after the other; ``change`` is called first."""
    with Folders(root, True, durable, change) as folders:
        for path, data in files:
            if not _holds(folders, path, data):
                if change is not None:
                    change()
                _write(folders, path, data)


def _holds(folders: Folders, path: str, data: bytes) -> bool:
    """Return True if a file holds exactly these bytes."""
    folder, name = folders.of(path)
    try:
        handle = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
    except FileNotFoundError:
        return False
    try:
        state = os.fstat(handle)
        if not stat.S_ISREG(state.st_mode):
            raise in_place_of_file(Path(folders.root), path)
        return state.st_size == len(data) and os.pread(handle, len(data), 0) == data
    finally:
        os.close(handle)


def _write(folders: Folders, path: str, data: bytes | Iterable[bytes]) -> None:
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    folder, name = folders.of(path)
    temporary = _aside(name)
    try:
        handle = os.open(temporary, flags, 0o644, dir_fd=folder)
    except FileExistsError:  # left by a killed run whose process had the same ID
        os.unlink(temporary, dir_fd=folder)
        handle = os.open(temporary, flags, 0o644, dir_fd=folder)
    try:
        try:
            for part in [data] if isinstance(data, bytes) else data:
                write_all(handle, part)
            if folders.durable:
                os.fsync(handle)
        finally:
            os.close(handle)
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException as error:
        with suppress(OSError):
            os.unlink(temporary, dir_fd=folder)
        if isinstance(error, IsADirectoryError):
            raise in_place_of_file(Path(folders.root), path) from None
        raise
    if folders.durable:
        os.fsync(folder)


def write_stand_in(root: str | Path, path: str, size: int, tail: bytes) -> None:
    """Write a sparse file of this size that holds only its last bytes; its mtime ``ELSEWHERE`` marks it."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    with _place(root, path, make=True) as (folder, name):
        temporary = _aside(name)
        handle = os.open(temporary, flags, 0o644, dir_fd=folder)
        try:
            os.ftruncate(handle, size)
            write_at(handle, [tail], size - len(tail))
            os.utime(handle, ns=(ELSEWHERE, ELSEWHERE))
        finally:
            os.close(handle)
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)


def sync_folder(path: Path) -> None:
    """Sync a folder, so that the names in it survive a power cut."""
    handle = os.open(path, FOLDER & ~os.O_NOFOLLOW)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def create(root: str | Path, path: str, durable: bool = False) -> int:
    """Return a handle to a new file, for writing and reading."""
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    with _place(root, path, make=True, durable=durable) as (folder, name):
        handle = os.open(name, flags, 0o644, dir_fd=folder)
        if durable:
            os.fsync(folder)
    return handle


def open_own(root: str | Path, path: str) -> int:
    """Return a handle to an existing file, for writing and reading; never through a link."""
    with _place(root, path) as (folder, name):
        try:
            return os.open(name, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, dir_fd=folder)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise link_at(Path(root), path) from None
            raise


def rename(root: str | Path, path: str, new: str, durable: bool = False) -> None:
    """Move a complete file to another name in the same folder."""
    with _place(root, path) as (folder, name):
        try:
            os.replace(name, new.rpartition("/")[2], src_dir_fd=folder, dst_dir_fd=folder)
        except IsADirectoryError:
            raise in_place_of_file(Path(root), new) from None
        if durable:
            os.fsync(folder)


def link(root: str | Path, path: str, new: str, durable: bool = False) -> None:
    """Give a file a second name in another folder; copy it if the file system has no hard links."""
    with _place(root, path) as (here, name), _place(root, new, make=True, durable=durable) as (there, second):
        try:
            os.link(name, second, src_dir_fd=here, dst_dir_fd=there, follow_symlinks=False)
        except FileExistsError:  # a killed run has already done it
            return
        except OSError as error:
            if error.errno not in (errno.EPERM, errno.EOPNOTSUPP, errno.EMLINK, errno.ENOSYS):
                raise
            with open(os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=here), "rb") as file:
                write(root, new, iter(lambda: file.read(8 << 20), b""), durable)
        if durable:
            os.fsync(there)


def write_at(handle: int, pieces: Iterable[Any], offset: int) -> None:
    """Write pieces of bytes one after the other into an open file."""
    left = [view for view in (memoryview(piece).cast("B") for piece in pieces if len(piece)) if view]
    while left:
        done = os.pwritev(handle, left, offset)
        offset += done
        while left and done >= len(left[0]):
            done -= len(left.pop(0))
        if done:
            left[0] = left[0][done:]


def copy_range(source: int, start: int, target: int, at: int, length: int) -> None:
    """Copy bytes from one open file into another, in the kernel if possible."""
    while length:
        try:
            done = os.copy_file_range(source, target, length, start, at)
        except OSError as error:
            if error.errno not in (errno.EXDEV, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL):
                raise
            data = os.pread(source, min(length, 8 << 20), start)
            write_at(target, [data], at)
            done = len(data)
        if not done:
            raise OSError(errno.EIO, "the file ends before the range to copy")
        start, at, length = start + done, at + done, length - done


def remove(root: str | Path, path: str) -> bool:
    """Remove one file by name; return whether it existed."""
    try:
        with _place(root, path) as (folder, name):
            os.unlink(name, dir_fd=folder)
    except FileNotFoundError:
        return False
    return True


def remove_folder(root: str | Path, path: str) -> None:
    """Remove a folder if it is empty; otherwise leave it and its content."""
    try:
        with _place(root, path) as (folder, name):
            os.rmdir(name, dir_fd=folder)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOENT):
            raise


def set_aside(root: str | Path, path: str, folder: str) -> str:
    """Move a file, link or folder into the archive's folder for foreign files; return its new path."""
    with _place(root, path) as (here, name), _place(root, f"{folder}/", make=True) as (there, _):
        number, taken = 1, set(os.listdir(there))
        while (new := name if number == 1 else f"{name}.{number}") in taken:
            number += 1
        os.rename(name, new, src_dir_fd=here, dst_dir_fd=there)
    return f"{folder}/{new}"


def append_to(root: str | Path, path: str) -> int:
    """Return a handle to append to a file, which must have no other name."""
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    with _place(root, path) as (folder, name):
        try:
            handle = os.open(name, flags, 0o644, dir_fd=folder)
        except OSError as error:
            if error.errno == errno.ELOOP:
                raise link_at(Path(root), path) from None
            raise
    found = os.fstat(handle)
    if not stat.S_ISREG(found.st_mode) or found.st_nlink > 1:
        os.close(handle)
        what = "has a second name (a hard link)" if stat.S_ISREG(found.st_mode) else "is not a regular file"
        raise ArchiveError(
            f"{Path(root) / path} {what}: writing to it would change another file too. "
            f"Make it a file of its own: cp {path} {path}.own && mv {path}.own {path}"
        )
    return handle


# -- listing --------------------------------------------------------------------------------------------------------


def lacks(folder: Path, what: str) -> str:
    """Return the reason why a folder is not an archive: it does not exist, or has no ``what``."""
    return f"it holds no {what}" if folder.exists() else "it does not exist"


class Listing:
    """The names below the folders of an archive, by folder: ``files["data.zarr/scene"]``. Links are not listed.

    Content that an archive must not have raises an error or, if ``odd`` is given, is collected in ``odd`` by path.
    """

    def __init__(self, root: Path, odd: dict[str, str] | None = None) -> None:
        self.files: dict[str, set[str]] = {}
        self.folders: dict[str, set[str]] = {}
        self.odd = odd
        with os.scandir(root) as entries:
            for entry in entries:
                if entry.is_symlink():
                    self._refuse(entry.name, link_at(root, entry.name))
                elif entry.name in FOLDERS:
                    if not entry.is_dir(follow_symlinks=False):
                        self._refuse(entry.name, in_place_of_folder(root, entry.name))
                        continue
                    self._walk(root, entry.name)
                elif entry.name in FILES and not entry.is_file(follow_symlinks=False):
                    self._refuse(entry.name, in_place_of_file(root, entry.name))

    def _refuse(self, path: str, error: ArchiveError) -> None:
        if self.odd is None:
            raise error
        self.odd[path] = str(error)

    def _walk(self, root: Path, path: str) -> None:
        """List a folder and all folders below it. ``scandir`` returns entry types with the names: no file needs a
        ``stat``.
        """
        open_ = [path]
        while open_:
            path = open_.pop()
            files, folders = self.files.setdefault(path, set()), self.folders.setdefault(path, set())
            with os.scandir(f"{root}/{path}") as entries:
                for entry in entries:
                    own = f"{path}/{entry.name}"
                    if entry.is_dir(follow_symlinks=False):
                        if entry.name == "zarr.json":
                            self._refuse(own, in_place_of_file(root, own))
                            continue
                        folders.add(entry.name)
                        open_.append(own)
                    elif entry.is_file(follow_symlinks=False):
                        files.add(entry.name)
                    elif entry.is_symlink():
                        self._refuse(own, link_at(root, own))
                    else:
                        self._refuse(
                            own,
                            ArchiveError(
                                f"{root / own} is not a regular file; an archive holds only files and folders"
                            ),
                        )

    def has(self, path: str) -> bool:
        folder, _, name = path.rpartition("/")
        return name in self.files.get(folder, ())

    def below(self, path: str) -> Iterator[str]:
        """Yield every file below a folder."""
        for name in self.files.get(path, ()):
            yield f"{path}/{name}"
        for name in self.folders.get(path, ()):
            yield from self.below(f"{path}/{name}")


def read_document(path: Path) -> Document | None:
    """Return a JSON object from a file; None if the file does not exist or is damaged."""
    try:
        found = json.loads(plain_files.content(path, links=False))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def content_of(path: Path) -> bytes | None:
    """Return the content of a file; None if the file does not exist."""
    try:
        return plain_files.content(path, links=False)
    except FileNotFoundError:
        return None
    except IsADirectoryError:
        raise in_place_of_file(path.parent, path.name) from None
