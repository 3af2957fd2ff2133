"""Memory of a process that runs cells: what is freed is kept, what nobody holds any more is let go, and neither costs
much.

A cell frees what the next one needs again, of the same size. glibc returns large blocks to the system at once, and
touching fresh pages costs more than filling them: 10 us a page on a virtual machine, 2 ms for the three channels of a
256 x 256 picture, where a stage may take 0.3 ms. Elsewhere than on glibc nothing happens.

A ``DataTree`` is a circle, which only Python's collector finds. It counts objects: a tree is some thousand of them,
whether it holds one megabyte or a thousand. So bytes are counted here, and the collector is called when enough of them
wait.
"""

from __future__ import annotations

import ctypes
import gc
import sys
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from etendue.process import Shared

if TYPE_CHECKING:
    import xarray

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
LARGEST_BLOCK = 32 << 20  # the largest glibc accepts; larger arrays are mapped as before
LARGEST_KEPT = 1 << 30
# objects made until the youngest are looked through, instead of 700: those of a plan and of a cell go by themselves
AT_ONCE = 10_000
LEAST, MOST, TREES = 32 << 20, 256 << 20, 8  # so many trees may wait to be collected, in bytes at least and at most


@contextmanager
def _seldom() -> Iterator[None]:
    young, middle, old = gc.get_threshold()
    if young:  # 0: somebody wants no collecting at all
        gc.set_threshold(max(young, AT_ONCE), middle, old)
    try:
        yield
    finally:
        if young and gc.get_threshold() == (max(young, AT_ONCE), middle, old):
            gc.set_threshold(young, middle, old)


SELDOM_COLLECTING = Shared(_seldom)


class Trees:
    """Trees that were handed out: those that are still there are held by somebody, or wait for the collector."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.young: list[tuple[weakref.ref[xarray.DataTree], int]] = []  # since the young were collected
        self.old: list[tuple[weakref.ref[xarray.DataTree], int]] = []
        self.allowed = 0  # of the old; what is held by somebody would be looked through in vain

    def hand_out(self, tree: xarray.DataTree, size: int) -> None:
        """Remember a tree and the bytes of its arrays."""
        with self.lock:
            self.young.append((weakref.ref(tree), size))

    def collect(self) -> None:
        """In front of a run: what the next tree takes is freed before, if there is so much of it."""
        if not gc.isenabled():
            return
        with self.lock:
            room = min(max(LEAST, TREES * max((size for _, size in self.young), default=0)), MOST)
            if _there(self.young) <= room // 2:
                return
            young, self.young = self.young, []
        gc.collect(1)  # of what was made since: 1 ms
        with self.lock:
            self.old += young
            held = _there(self.old)
            if held < self.allowed // 4:
                self.allowed = 2 * held
            if held <= max(room, self.allowed):
                return
            self.allowed = 2 * held  # for others, meanwhile
        gc.collect()  # of everything: 0.1 s
        with self.lock:
            self.allowed = 2 * _there(self.old)


def _there(trees: list[tuple[weakref.ref[xarray.DataTree], int]]) -> int:
    """Bytes of those that are still there; the others are forgotten."""
    trees[:] = [(tree, size) for tree, size in trees if tree() is not None]
    return sum(size for _, size in trees)


TREES_OUT = Trees()


@cache
def keep_freed_memory() -> bool:
    """Once per process; whether the allocator took the advice."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    kept = mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK) and mallopt(M_TRIM_THRESHOLD, LARGEST_KEPT)
    return bool(kept and mallopt(M_ARENA_MAX, 1))  # what one thread has freed serves all of them
