"""What a process has only once, in the hands of threads that know nothing of each other.

In:  a change of the process for a while; foreign code that may leave it changed.
Out: the change, made by the first who needs it and undone behind the last; the process as it was before any of the
     foreign code ran.

Taken back by each who made it, in whatever order they end, a change stays for ever: the second found what the first had
changed.
"""

from __future__ import annotations

import os
import re
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Generic, TypeVar

from etendue.telling import here

_Found = TypeVar("_Found")


class SharedChange:
    """A change that several need at once. Use as a context manager, as often and in as many threads as it is needed."""

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


class StateBefore(Generic[_Found]):
    """What stood before the first began of all who are still at it: that is put back behind each of them."""

    def __init__(self, now: Callable[[], _Found]) -> None:
        self.now, self.lock = now, threading.Lock()
        self.inside: dict[object, _Found] = {}

    def begin(self) -> tuple[object, _Found]:
        """Whoever begins, and what is to stand behind it."""
        with self.lock:
            found = next(iter(self.inside.values())) if self.inside else self.now()
            who = object()
            self.inside[who] = found
        return who, found

    def end(self, who: object, put_back: Callable[[], object]) -> None:
        """Whoever ends. Between what is put back and this end nobody begins: it would take what is left for what
        stood before.
        """
        with self.lock:
            try:
                put_back()
            finally:
                self.inside.pop(who, None)

    def abandon(self) -> None:
        """Somebody will never end: what stands now is what those who begin from now on put back."""
        with self.lock:
            self.inside.clear()


_ours: list[tuple[Any, ...]] = []  # the filters of ``unwarned`` that are in force
_filters = threading.Lock()


@contextmanager
def unwarned(message: str = "") -> Iterator[None]:
    """Warnings with such a text, or all, are not shown.

    ``warnings.catch_warnings`` puts back what it found: of two threads the second finds what the first has set.
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
            for filters in (there, warnings.filters):  # another list, where somebody catches warnings now
                _set(filters, _but((own,), filters))


class Warned:
    """How the process warns, to be put back; what ``unwarned`` says stands beside it."""

    def __init__(self) -> None:
        self.filters: Any = warnings.filters
        self.shown = warnings.showwarning
        self.kept = _but(_ours, self.filters) if _ours else list(self.filters)

    def put_back(self) -> None:
        if warnings.filters is self.filters:  # else a thread beside this one catches warnings
            with _filters:
                expected = [*_ours, *self.kept]
                if self.filters != expected:
                    _set(self.filters, expected)
        if warnings.showwarning is not self.shown:
            warnings.showwarning = self.shown


def _but(some: Iterable[Any], filters: Iterable[Any]) -> list[Any]:
    """The others, in their order. A filter of somebody else's may be equal to one of ours."""
    own = {id(one) for one in some}
    return [one for one in filters if id(one) not in own]


def _set(filters: Any, wanted: list[Any]) -> None:
    filters[:] = wanted
    warnings._filters_mutated()  # type: ignore[attr-defined]


def return_to(folder: str) -> None:
    """The working folder; '' where it had been removed."""
    if folder and here() != folder:
        os.chdir(folder)


FOLDER, WARNED = StateBefore(here), StateBefore(Warned)  # in front of all foreign code that is under way
