"""Cached trials, so that laws that need the same trial share it.

In:  everything that determines a trial: the stage by value, its inputs by their digests, grids, precision, seed.
Out: the trial, computed once inside ``keeping``; laws about state compute their trials again inside ``anew``.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from etendue.testing.bench import BenchTrial

LARGEST = 1 << 20  # bytes of a trial that is kept
Kept = dict[Hashable, "BenchTrial"]
_now: ContextVar[Kept | None] = ContextVar("trials that are kept", default=None)


@contextmanager
def keeping() -> Iterator[None]:
    """Keep the trials that are made inside the ``with`` block."""
    before = _now.set({})
    try:
        yield
    finally:
        _now.reset(before)


@contextmanager
def anew() -> Iterator[None]:
    """Compute every trial inside the ``with`` block again, even if it was kept."""
    before = _now.set(None)
    try:
        yield
    finally:
        _now.reset(before)


def once(key: tuple[object, ...], compute: Callable[[], BenchTrial]) -> BenchTrial:
    """Return the kept trial with this key, or compute it and keep it."""
    trials = _now.get()
    if trials is None:
        return compute()
    try:
        found = trials.get(key)
    except TypeError:  # the values of the stage cannot be keys
        return compute()
    if found is None:
        found = compute()
        if sum(array.nbytes for array in found.arrays.values()) <= LARGEST:
            trials[key] = found
    return found
