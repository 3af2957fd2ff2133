"""Share process-wide state among independent threads.

In:  a temporary change of the process; foreign code that may leave the process changed.
Out: the change, made for the first user and undone after the last; the process as it was before any of the foreign code
     ran.

If every thread saved and restored the state itself, a change could stay for ever: the second thread would save the
state that the first has changed, and restore it last.
"""

from __future__ import annotations

import gc
import os
import re
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ContextDecorator, contextmanager
from typing import Any, Generic, TypeVar

from etendue.telling import here

_Found = TypeVar("_Found")


class SharedChange(ContextDecorator):
    """A change of the state of the process that several users may need at the same time. Use it as a context manager or
    a decorator, nested and in any number of threads.
    """

    def __init__(self, change: Callable[[], AbstractContextManager[Any]]) -> None:
        self.change, self.lock, self.count = change, threading.RLock(), 0
        self.made: AbstractContextManager[Any] | None = None

    def __enter__(self) -> None:
        with self.lock:
            if not self.count:
                made = self.change()
                made.__enter__()
                self.made = made
            self.count += 1

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.count -= 1
            if not self.count and self.made is not None:
                made, self.made = self.made, None
                made.__exit__(None, None, None)


@contextmanager
def _not_collecting() -> Iterator[None]:
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


# Pauses the garbage collector: scanning the cells, none of which is freed, takes a tenth of planning time.
NOT_COLLECTING = SharedChange(_not_collecting)


class StateBefore(Generic[_Found]):
    """Saves the state from before the first user began, and restores it after each user."""

    def __init__(self, now: Callable[[], _Found]) -> None:
        self.now, self.lock = now, threading.Lock()
        self.inside: dict[object, _Found] = {}

    def begin(self) -> tuple[object, _Found]:
        """Begin a use; return its token and the state to restore after it."""
        with self.lock:
            found = next(iter(self.inside.values())) if self.inside else self.now()
            who = object()
            self.inside[who] = found
        return who, found

    def end(self, who: object, put_back: Callable[[], object]) -> None:
        """End a use. The lock is held while the state is restored: a use that began at this moment would save the state
        that foreign code left.
        """
        with self.lock:
            try:
                put_back()
            finally:
                self.inside.pop(who, None)

    def abandon(self) -> None:
        """Forget all uses, because one of them will never end; later uses save and restore the present state."""
        with self.lock:
            self.inside.clear()


_ours: list[tuple[Any, ...]] = []  # the active filters of ``unwarned``
_filters = threading.Lock()


@contextmanager
def unwarned(message: str = "") -> Iterator[None]:
    """Suppress warnings that contain a text, or all warnings.

    ``warnings.catch_warnings`` is not enough: with two threads, the second thread saves and restores the settings of
    the first.
    """
    own = (
        "ignore",
        re.compile(f".*{re.escape(message)}", re.IGNORECASE | re.DOTALL) if message else None,
        Warning,
        None,
        0,
    )
    there: Any = warnings.filters
    with _filters:
        _ours.insert(0, own)
        _set(there, [own, *there])
    try:
        yield
    finally:
        with _filters:
            _ours[:] = _but((own,), _ours)
            for filters in (there, warnings.filters):  # a different list while other code catches warnings
                _set(filters, _but((own,), filters))


class Warned:
    """The state of warnings in the process, to be restored, together with the filters of ``unwarned``."""

    def __init__(self) -> None:
        self.filters: Any = warnings.filters
        self.shown = warnings.showwarning
        self.kept = _but(_ours, self.filters) if _ours else list(self.filters)

    def put_back(self) -> None:
        if warnings.filters is self.filters:  # otherwise another thread is catching warnings
            with _filters:
                expected = [*_ours, *self.kept]
                if self.filters != expected:
                    _set(self.filters, expected)
        if warnings.showwarning is not self.shown:
            warnings.showwarning = self.shown


def _but(some: Iterable[Any], filters: Iterable[Any]) -> list[Any]:
    """Return the filters except one, in order. Compared by identity: a foreign filter may equal one of ours."""
    own = {id(one) for one in some}
    return [one for one in filters if id(one) not in own]


def _set(filters: Any, wanted: list[Any]) -> None:
    filters[:] = wanted
    warnings._filters_mutated()  # type: ignore[attr-defined]


def return_to(folder: str) -> None:
    """Change back to a working folder; '' if it was removed."""
    if folder and here() != folder:
        os.chdir(folder)


FOLDER, WARNED = StateBefore(here), StateBefore(Warned)  # as before all foreign code that is running
