"""Cells that were computed on an earlier platform and are accepted with ``--accept-platform``.

In:  a plan, the record of the last run, the entries of the journal.
Out: the keys that cells had with the libraries of that run; new journal entries for the cells that are accepted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from etendue.archive.journaling.entries import Entry
from etendue.archive.records.past_runs import in_words
from etendue.contract.registry import installed_stages
from etendue.plan import planner
from etendue.plan.model import CellRef, Plan
from etendue.types.documents import DocumentView


@dataclass(frozen=True)
class Former:
    """The former ``keys`` of cells whose key has changed, and the former platform in words."""

    keys: Mapping[CellRef, str] = field(default_factory=dict)
    platform: str = ""


def former_of(plan: Plan, record: DocumentView) -> Former:
    """Return the keys of the plan's cells on the platform of an earlier run."""
    then = planner.make_plan(plan.pipeline, installed_stages(), plan.leaves_out, versions=record["libraries"])
    own = {ref: cell.key for ref, cell in then.cells.items() if ref in plan.cells and cell.key != plan.cells[ref].key}
    return Former(own, in_words(record))


def accepted(former: Former, plan: Plan, finished: Iterable[tuple[CellRef, Entry]]) -> list[tuple[CellRef, Entry]]:
    """Return new entries for finished cells of the former platform: with today's keys, and marked as accepted."""
    if not former.platform:
        return []
    return [
        (ref, replace(one, key=plan.cells[ref].key, platform=one.platform or former.platform)) for ref, one in finished
    ]
