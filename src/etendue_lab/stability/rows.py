"""Results of a stability check: a row per case, and the worst of each law.

In:  rows as the checks make them.
Out: the same as a document; groups for a table.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from etendue.types.documents import Document


@dataclass(frozen=True)
class LawCase:
    """One case of one law of one stage."""

    stage: str
    law: str
    case: str
    ok: bool | None  # None if not tested; ``why`` gives the reason
    error: float | None = None
    bound: float | None = None
    condition: float | None = None
    why: str = ""

    @property
    def nearness(self) -> float:
        """Severity: failures first, then the error relative to its bound."""
        if self.ok is not True:
            return math.inf
        if self.error is None or self.bound is None:
            return -1.0
        return self.error / self.bound if self.bound else 0.0


@dataclass(frozen=True)
class LawCases:
    """The cases of one law of one stage: their number, the worst of them, the largest condition number."""

    worst: LawCase
    cases: int
    failed: int
    untried: int
    condition: float | None


def groups(rows: Iterable[LawCase]) -> list[LawCases]:
    """Group rows by stage and law, in order. The worst row of a group is the worst failed row, if any failed."""
    together: dict[tuple[str, str], list[LawCase]] = {}
    for row in rows:
        together.setdefault((row.stage, row.law), []).append(row)
    found = []
    for several in together.values():
        conditions = [row.condition for row in several if row.condition is not None]
        failed, untried = (sum(row.ok is state for row in several) for state in (False, None))
        worst = max((row for row in several if not failed or row.ok is False), key=lambda row: row.nearness)
        found.append(LawCases(worst, len(several), failed, untried, max(conditions, default=None)))
    return found


def document(rows: Iterable[LawCase]) -> Document:
    """Return the document of ``etendue stability --json``."""
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


def single(rows: Iterable[LawCase]) -> list[LawCases]:
    """Return a group for each row."""
    return [LawCases(row, 1, int(row.ok is False), int(row.ok is None), row.condition) for row in rows]


def counts(rows: Iterable[LawCase]) -> dict[str, int]:
    every = list(rows)
    held, failed, untried = (sum(row.ok is state for row in every) for state in (True, False, None))
    return {
        "cases": len(every),
        "stages": len({row.stage for row in every}),
        "held": held,
        "failed": failed,
        "untried": untried,
    }
