"""The measurements of a law: an error with its bound, and the condition number of the solved problem.

In:  numbers of a law, as it finds them.
Out: the worst of them inside ``measuring``, or ``LawBroken``.
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
    """The worst results of one law for one instance: the error closest to its bound, the largest condition number."""

    error: float | None = None
    bound: float | None = None
    condition: float | None = None
    untried: str = ""

    def take(self, error: float, bound: float) -> None:
        if self.error is None or self.bound is None or _nearness(error, bound) > _nearness(self.error, self.bound):
            self.error, self.bound = error, bound

    def magnified(self, condition: float) -> None:
        self.condition = condition if self.condition is None else max(self.condition, condition)


def _nearness(error: float, bound: float) -> float:
    """Return an error divided by its bound; 0 if both are 0."""
    return error / bound if bound else (math.inf if error else 0.0)


_now: ContextVar[WorstError | None] = ContextVar("measured", default=None)


@contextmanager
def measuring() -> Iterator[WorstError]:
    """Collect the measurements that are made inside the ``with`` block."""
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
    """Record an error and its bound; the bound is tested elsewhere."""
    if (found := _now.get()) is not None:
        found.take(error, bound)


def untried(what: str) -> None:
    """Record the part of a law that is skipped for this instance, and the reason."""
    if (found := _now.get()) is not None:
        found.untried = what


def within(error: float, bound: float, otherwise: str) -> None:
    """Record an error and require it to be within its bound."""
    told(error, bound)
    hold(error <= bound, otherwise)


def magnified(condition: float) -> None:
    """Record a condition number: the factor by which a small change grows."""
    if (found := _now.get()) is not None:
        found.magnified(condition)


def ratio_of(apart: float, scale: float) -> float:
    """Return a difference divided by full scale; 0 if both are 0."""
    return apart / scale if scale else (math.inf if apart else 0.0)
