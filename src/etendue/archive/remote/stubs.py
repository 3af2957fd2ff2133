"""Stubs: local files in place of shards whose bytes are on an object store. A stub has the shard's size and
holds only its index.

In:  the folder of an archive beside ``store.json``, which names the store.
Out: bytes of chunks, fetched on demand; whole shards, fetched before they are copied from.

A stub is recognised by its mtime, which no other file has. Code that reads a stub as an ordinary file gets
zeros, which fail every checksum.
"""

from __future__ import annotations

import os
import threading
from collections import OrderedDict
from pathlib import Path

from etendue.archive.records import disk
from etendue.archive.remote.objects import Objects

STORE = "store.json"  # beside the folder of an archive
WINDOW = 4 << 20  # small chunks are fetched with their neighbours
DIRECT = 1 << 20  # chunks of this size are fetched alone
WINDOWS = 16
_lock = threading.Lock()
_stores: dict[tuple[int, str], Objects] = {}
_windows: OrderedDict[tuple[str, int, int], bytes] = OrderedDict()


def is_stand_in(handle: int) -> bool:
    """Return True if the bytes of an open file are on the store."""
    return os.fstat(handle).st_mtime_ns == disk.ELSEWHERE


def store_behind(root: Path) -> Objects:
    """Return the store that holds the bytes of stubs; one client per process."""
    key = (os.getpid(), str(root))
    with _lock:
        if key not in _stores:
            known = disk.read_document(root.parent / STORE) or {}
            _stores[key] = Objects(str(known["url"]))
        return _stores[key]


def forget(root: Path) -> None:
    """Release the store client of an archive that is no longer read."""
    with _lock:
        _stores.pop((os.getpid(), str(root)), None)


def read(root: Path, path: str, handle: int, offset: int, size: int) -> bytes:
    """Return bytes of the object that a stub replaces; ``FileNotFoundError`` if the object is gone.

    Chunks of a shard that lie close together are fetched together: reading the whole shard costs one request per 4 MiB.
    """
    store, state = store_behind(root), os.fstat(handle)
    if size >= DIRECT:
        return store.part(path, offset, min(size, max(state.st_size - offset, 0)))
    found = b""
    while len(found) < size and offset + len(found) < state.st_size:
        at = offset + len(found)
        window = _window(store, f"{root}/{path}", path, state, at - at % WINDOW)
        piece = window[at % WINDOW : at % WINDOW + size - len(found)]
        if not piece:
            break
        found += piece
    return found


def _window(store: Objects, name: str, path: str, state: os.stat_result, start: int) -> bytes:
    key = (name, state.st_ctime_ns, start)
    with _lock:
        if key in _windows:
            _windows.move_to_end(key)
            return _windows[key]
    data = store.part(path, start, min(WINDOW, state.st_size - start))
    with _lock:
        _windows[key] = data
        if len(_windows) > WINDOWS:
            _windows.popitem(last=False)
    return data


def opened(root: Path, path: str) -> int:
    """Return a handle to a shard that holds its bytes; a stub is replaced by the fetched object first."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    handle = os.open(root / path, flags)
    if is_stand_in(handle):
        os.close(handle)
        disk.write(root, path, store_behind(root).pieces(path))
        handle = os.open(root / path, flags)
    return handle


def stand_for(root: Path, path: str, index: int) -> None:
    """Replace a shard that is on the store by a stub; its last ``index`` bytes are kept."""
    handle = os.open(root / path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        size = os.fstat(handle).st_size
        tail = os.pread(handle, index, max(size - index, 0))
    finally:
        os.close(handle)
    disk.write_stand_in(root, path, size, tail)
