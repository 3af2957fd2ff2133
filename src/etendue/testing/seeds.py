"""The seed of the laws' own draws, which is the same in every run unless another seed is given.

In:  a whole number.
Out: the seeds of a law's draws inside ``seeded``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_now: ContextVar[int] = ContextVar("seed of the laws", default=0)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Use another seed for the draws inside the ``with`` block."""
    before = _now.set(seed)
    try:
        yield
    finally:
        _now.reset(before)


def seed_of(words: str) -> bytes:
    """Return the seed of the draw that ``words`` names."""
    seed = _now.get()
    return f"{words}{f' {seed}' if seed else ''}".encode()


def number() -> int:
    return _now.get()
