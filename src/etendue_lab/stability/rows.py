"""What a check of stability found: a row a case, and the worst of each law.

In:  rows as the checks make them.
Out: the same as a document; groups for a table.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from etendue.types.documents import Document


@dataclass(frozen=True)
class Row:
    """One case of one law of one stage."""

    stage: str
    law: str
    case: str
    ok: bool | None  # None: not tried, and why
    error: float | None = None
    bound: float | None = None
    condition: float | None = None
    why: str = ""

    @property
    def nearness(self) -> float:
        """How bad it is: what broke first, then by the share of its bound that an error takes."""
        if self.ok is not True:
            return math.inf
        if self.error is None or self.bound is None:
            return -1.0
        return self.error / self.bound if self.bound else 0.0


@dataclass(frozen=True)
class Group:
    """The cases of one law of one stage: how many, the worst of them, the largest condition number."""

    worst: Row
    cases: int
    failed: int
    untried: int
    condition: float | None


def groups(rows: Iterable[Row]) -> list[Group]:
    """In the order of the rows; of what broke, a group for every law, with its first failure."""
    together: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        together.setdefault((row.stage, row.law), []).append(row)
    found = []
    for several in together.values():
        conditions = [row.condition for row in several if row.condition is not None]
        failed, untried = (sum(row.ok is state for row in several) for state in (False, None))
        worst = max((row for row in several if not failed or row.ok is False), key=lambda row: row.nearness)
        found.append(Group(worst, len(several), failed, untried, max(conditions, default=None)))
    return found


def document(rows: Iterable[Row]) -> Document:
    """``etendue stability --json``."""
    return {
        "cases": [
            {
                "stage": row.stage,
                "law": row.law,
                "case": row.case,
                "error": row.error,
                "bound": row.bound,
                "condition": row.condition,
                "ok": row.ok,
                "why": row.why,
            }
            for row in rows
        ]
    }


def single(rows: Iterable[Row]) -> list[Group]:
    """Each row for itself."""
    return [Group(row, 1, int(row.ok is False), int(row.ok is None), row.condition) for row in rows]


def counts(rows: Iterable[Row]) -> dict[str, int]:
    every = list(rows)
    held, failed, untried = (sum(row.ok is state for row in every) for state in (True, False, None))
    return {
        "cases": len(every),
        "stages": len({row.stage for row in every}),
        "held": held,
        "failed": failed,
        "untried": untried,
    }
