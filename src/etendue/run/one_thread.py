"""Libraries of linear algebra compute with one thread while any run goes on: bits depend on how many there are.

In:  runs that begin and end in any thread, in any order.
Out: every library that is there, or comes meanwhile, held to one thread; with its own number again behind the last run.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

BRINGS = "scipy.linalg"  # the part of scipy with a library of its own; kernels import it when they first call it


class OneThread(MetaPathFinder):
    """Use as a context manager, in as many threads as run. Meanwhile it sees what is imported: that may bring
    another library.
    """

    def __init__(self) -> None:
        self.lock, self.count = threading.RLock(), 0
        self.held: list[tuple[Any, int]] = []  # libraries, each with the number of threads that it had

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
        """Hold to one thread what is not yet."""
        from threadpoolctl import ThreadpoolController

        with self.lock:  # in here nothing is imported: who imports waits for it
            for library in ThreadpoolController().lib_controllers:
                had = library.num_threads
                if had is not None and had != 1:
                    self.held.append((library, had))
                    _give(library, 1)

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """What the other finders find, looked at again behind its import."""
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
    """Another loader, behind which libraries are looked for. The module never learns of it."""

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


def _give(library: Any, threads: int) -> None:
    """So many threads to a library. From 3.8 on, ``threadpoolctl`` listens to one thread of a process alone, the first
    that asked, and lets all others ask in vain: that is cleared before, for this one, and behind it, for whoever comes
    next."""
    clear = getattr(library, "clear_controlling_thread", None)
    for _ in range(8):  # somebody else may ask in between
        if clear:
            clear(force=True)
        library.set_num_threads(threads)
        if clear:
            clear(force=True)
        if library.num_threads == threads:
            return


ONE_THREAD = OneThread()
