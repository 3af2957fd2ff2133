"""Limit linear algebra libraries to one thread during a run: the bits of results depend on the number of threads.

In:  runs that begin and end in any thread, in any order.
Out: every library that is loaded now or during a run is limited to one thread, and restored after the last run.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

BRINGS = "scipy.linalg"  # loads a library of its own; kernels import it on their first call


class OneThread(MetaPathFinder):
    """A context manager, usable in any number of threads. It watches imports, which may load more libraries."""

    def __init__(self) -> None:
        self.lock, self.count = threading.RLock(), 0
        self.held: list[tuple[Any, int]] = []  # libraries, each with its former number of threads
        self.seen: tuple[int, int] | None = None  # libraries loaded and unloaded by then, of those:
        self.libraries: list[Any] = []

    def __enter__(self) -> None:
        with self.lock:
            self.limit()
            self.count += 1
            if self.count == 1:
                sys.meta_path.insert(0, self)

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.count -= 1
            if not self.count:
                sys.meta_path.remove(self)
                while self.held:
                    _give(*self.held.pop())

    def limit(self) -> None:
        """Limit every library that is not limited yet to one thread."""
        from threadpoolctl import ThreadpoolController

        with self.lock:  # import nothing here: an import would wait for this lock
            counts = _counts()
            if counts is None or counts != self.seen:  # looking through all that is loaded takes some milliseconds
                self.libraries, self.seen = ThreadpoolController().lib_controllers, counts
            for library in self.libraries:
                had = library.num_threads
                if had is not None and had != 1:
                    self.held.append((library, had))
                    _give(library, 1)

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return the module spec of the other finders, wrapped so that libraries are checked after its import."""
        if name != BRINGS and ("." in name or name in sys.stdlib_module_names):
            return None
        for finder in sys.meta_path:
            if finder is not self and hasattr(finder, "find_spec"):
                spec = finder.find_spec(name, path, target)
                if spec is not None:
                    if hasattr(spec.loader, "exec_module"):
                        spec.loader = _Watched(spec.loader, self)
                    return spec
        return None


class _Watched(Loader):
    """A loader that wraps another loader, to check for libraries after an import; the module itself sees its own
    loader.
    """

    def __init__(self, own: Any, one_thread: OneThread) -> None:
        self.own, self.one_thread = own, one_thread

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        made: ModuleType | None = self.own.create_module(spec)
        return made

    def exec_module(self, module: ModuleType) -> None:
        module.__loader__ = self.own
        if module.__spec__ is not None:
            module.__spec__.loader = self.own
        self.own.exec_module(module)
        with self.one_thread.lock:
            if self.one_thread.count:
                self.one_thread.limit()


class _Library(ctypes.Structure):
    """The head of ``dl_phdr_info``."""

    _fields_ = (
        ("address", ctypes.c_void_p),
        ("name", ctypes.c_char_p),
        ("headers", ctypes.c_void_p),
        ("count", ctypes.c_uint16),
        ("loaded", ctypes.c_ulonglong),
        ("unloaded", ctypes.c_ulonglong),
    )


def _counts() -> tuple[int, int] | None:
    """Return the numbers of libraries that this process has loaded and unloaded so far; None if the system does not
    report them.
    """
    if not sys.platform.startswith("linux"):
        return None
    found: list[tuple[int, int]] = []

    def first(library: Any, size: int, _: Any) -> int:
        if size >= ctypes.sizeof(_Library):
            found.append((library.contents.loaded, library.contents.unloaded))
        return 1  # every library has the same counts

    kind = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(_Library), ctypes.c_size_t, ctypes.c_void_p)
    # PyDLL keeps the interpreter lock during the call. Otherwise the callback could wait for that lock, with the lock
    # of the loader held, while another thread holds the interpreter lock, loads a library and waits for the loader.
    try:
        ctypes.PyDLL(None).dl_iterate_phdr(kind(first), None)
    except (OSError, AttributeError):
        return None
    return found[0] if found else None


def _give(library: Any, threads: int) -> None:
    """Set a library's number of threads. From version 3.8 on, ``threadpoolctl`` obeys only the first thread of a
    process that calls it, and silently ignores all other threads. The recorded thread is therefore cleared before this
    call, and again afterwards for later callers.
    """
    clear = getattr(library, "clear_controlling_thread", None)
    for _ in range(8):  # another thread may ask in between
        if clear:
            clear(force=True)
        library.set_num_threads(threads)
        if clear:
            clear(force=True)
        if library.num_threads == threads:
            return


ONE_THREAD = OneThread()
