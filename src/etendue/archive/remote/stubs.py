"""Stand-ins: shards of an archive whose bytes lie on an object store. Here is a file of their size that holds their
index alone.

In:  the folder of an archive beside ``store.json``, which names the store.
Out: bytes of chunks, fetched when they are asked for; a shard fetched whole before it is copied from.

A stand-in is told by the time of its last change, which no other file has. Whoever overlooks that reads zeros, which
fit no checksum.
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
    """Whether the bytes of an open file lie elsewhere."""
    return os.fstat(handle).st_mtime_ns == disk.ELSEWHERE


def store_behind(root: Path) -> Objects:
    """The store on which the bytes of stand-ins lie; one for each process."""
    key = (os.getpid(), str(root))
    with _lock:
        if key not in _stores:
            known = disk.read_document(root.parent / STORE) or {}
            _stores[key] = Objects(str(known["url"]))
        return _stores[key]


def forget(root: Path) -> None:
    """Nothing is asked of this archive any more."""
    with _lock:
        _stores.pop((os.getpid(), str(root)), None)


def read(root: Path, path: str, handle: int, offset: int, size: int) -> bytes:
    """Some bytes of the object that a file stands for; ``FileNotFoundError`` where it is gone.

    Chunks of a shard that lie near each other are fetched together: reading all costs a request for every 4 MiB.
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
    """A handle to a shard that holds its bytes: they are fetched first where they lie elsewhere."""
    flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    handle = os.open(root / path, flags)
    if is_stand_in(handle):
        os.close(handle)
        disk.write(root, path, store_behind(root).pieces(path))
        handle = os.open(root / path, flags)
    return handle


def stand_for(root: Path, path: str, index: int) -> None:
    """Leave a stand-in in the place of a shard that is on the store; its last ``index`` bytes stay."""
    handle = os.open(root / path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        size = os.fstat(handle).st_size
        tail = os.pread(handle, index, max(size - index, 0))
    finally:
        os.close(handle)
    disk.write_stand_in(root, path, size, tail)
