"""What a law measures: an error beside its bound, and the condition number of what was solved.

In:  numbers of a law, as it finds them.
Out: the worst of them, for whoever asks (``measuring``), or ``LawBroken``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from etendue.testing.bench import LawBroken


@dataclass
class WorstError:
    """The worst that one law has found of one instance: the error that comes nearest to its bound, and the largest
    condition number.
    """

    error: float | None = None
    bound: float | None = None
    condition: float | None = None

    def take(self, error: float, bound: float) -> None:
        if self.error is None or self.bound is None or _nearness(error, bound) > _nearness(self.error, self.bound):
            self.error, self.bound = error, bound

    def magnified(self, condition: float) -> None:
        self.condition = condition if self.condition is None else max(self.condition, condition)


def _nearness(error: float, bound: float) -> float:
    """How much of its bound an error takes; two that take nothing are told apart by nothing."""
    return error / bound if bound else (math.inf if error else 0.0)


_now: ContextVar[WorstError | None] = ContextVar("measured", default=None)


@contextmanager
def measuring() -> Iterator[WorstError]:
    """What is measured in here."""
    found = WorstError()
    before = _now.set(found)
    try:
        yield found
    finally:
        _now.reset(before)


def hold(condition: bool, otherwise: str) -> None:
    if not condition:
        raise LawBroken(otherwise)


def told(error: float, bound: float) -> None:
    """An error beside its bound, which is held elsewhere."""
    if (found := _now.get()) is not None:
        found.take(error, bound)


def within(error: float, bound: float, otherwise: str) -> None:
    """An error, which is to be no larger than its bound."""
    told(error, bound)
    hold(error <= bound, otherwise)


def magnified(condition: float) -> None:
    """A condition number: how many times a small change grows."""
    if (found := _now.get()) is not None:
        found.magnified(condition)


def ratio_of(apart: float, scale: float) -> float:
    """Relative to full scale; what differs by nothing differs by nothing of anything."""
    return apart / scale if scale else (math.inf if apart else 0.0)
