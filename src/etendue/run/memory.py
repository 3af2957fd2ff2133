"""Memory management of a process that runs cells: make it reuse freed memory, and collect unreachable results, both in
little time.

A cell frees blocks of the sizes that the next cell needs. glibc returns large blocks to the system at once, and
touching fresh pages costs more than filling them: 10 us a page on a virtual machine, 2 ms for the three channels of a
256 x 256 picture, where a stage may take 0.3 ms. Without glibc nothing is changed.

A ``DataTree`` is a reference cycle, which only Python's garbage collector frees. The collector counts objects, and a
tree consists of a few thousand, whether it holds a megabyte or a gigabyte. Bytes are therefore counted here, and the
collector is called when many bytes may be unreachable.
"""

from __future__ import annotations

import ctypes
import gc
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from etendue.process import NOT_COLLECTING, SharedChange

if TYPE_CHECKING:
    import xarray

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8
LARGEST_BLOCK = 12 << 20  # larger arrays are mapped, and returned at once: with huge pages that costs little
LARGEST_KEPT = 1 << 30
LEAST_RETURNED = 32 << 20  # bytes of freed memory that are worth returning
# new objects before the youngest generation is collected, instead of 700; those of plans and cells are freed anyway
AT_ONCE = 10_000
# lower and upper limit in bytes of uncollected trees, and their number in between
LEAST, MOST, TREES = 32 << 20, 256 << 20, 8


@contextmanager
def _seldom() -> Iterator[None]:
    young, middle, old = gc.get_threshold()
    if young:  # 0: automatic collection is switched off
        gc.set_threshold(max(young, AT_ONCE), middle, old)
    try:
        yield
    finally:
        if young and gc.get_threshold() == (max(young, AT_ONCE), middle, old):
            gc.set_threshold(young, middle, old)


SELDOM_COLLECTING = SharedChange(_seldom)


class Trees:
    """Trees that were handed out; those that still exist are in use, or wait for the garbage collector."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.young: list[tuple[weakref.ref[xarray.DataTree], int]] = []  # since the last young collection
        self.old: list[tuple[weakref.ref[xarray.DataTree], int]] = []
        # Bytes of old trees that survived a collection and are presumed in use; collecting again would not free them.
        self.allowed = 0

    def hand_out(self, tree: xarray.DataTree, size: int) -> None:
        """Register a tree and the bytes of its arrays."""
        with self.lock:
            self.young.append((weakref.ref(tree), size))

    def collect(self) -> None:
        """Free uncollected trees if they hold too many bytes. Call before a run."""
        if not (gc.isenabled() or NOT_COLLECTING.count):  # switched off by whoever calls
            return
        with self.lock:
            room = min(max(LEAST, TREES * max((size for _, size in self.young), default=0)), MOST)
            if _there(self.young) <= room // 2:
                return
            young, self.young = self.young, []
        gc.collect(1)  # young objects only: 1 ms
        with self.lock:
            self.old += young
            held = _there(self.old)
            if held < self.allowed // 4:
                self.allowed = 2 * held
            if held <= max(room, self.allowed):
                return
            self.allowed = 2 * held  # so that other threads do not collect meanwhile
        gc.collect()  # everything: 0.1 s
        with self.lock:
            self.allowed = 2 * _there(self.old)


def _there(trees: list[tuple[weakref.ref[xarray.DataTree], int]]) -> int:
    """Return the bytes of trees that still exist; drop the others from the list."""
    trees[:] = [(tree, size) for tree, size in trees if tree() is not None]
    return sum(size for _, size in trees)


TREES_OUT = Trees()


@cache
def keep_freed_memory() -> bool:
    """Make the allocator keep freed memory, once per process; return whether the allocator supports this."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    kept = mallopt(M_MMAP_THRESHOLD, LARGEST_BLOCK) and mallopt(M_TRIM_THRESHOLD, LARGEST_KEPT)
    return bool(kept and mallopt(M_ARENA_MAX, 1))  # one arena, so that memory freed by one thread serves all


class _Heap(ctypes.Structure):
    """``struct mallinfo2``."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost".split()
    )


@cache
def _returning() -> tuple[Callable[[], _Heap], Callable[[int], int]] | None:
    if not keep_freed_memory():
        return None
    try:
        library = ctypes.CDLL(None)
        library.mallinfo2.restype = _Heap
        return library.mallinfo2, library.malloc_trim
    except (OSError, AttributeError):  # before glibc 2.33
        return None


def return_freed_memory() -> None:
    """Give memory that was freed, but is still held by the process, back to the system if there is much of it. Call
    before a large allocation, which would add to this memory.
    """
    known = _returning()
    if known is not None and known[0]().fordblks > LEAST_RETURNED:
        known[1](0)
