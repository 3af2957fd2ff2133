"""Cells of an earlier platform that a run goes on with, because it was told to.

In:  a plan, the record of the last run, what the journal says.
Out: the keys that cells had with the libraries of that run; what the journal is to say of those that are accepted.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from etendue.archive.entries import Entry
from etendue.archive.provenance import in_words
from etendue.contract.registry import installed_stages
from etendue.plan import planner
from etendue.plan.model import CellRef, Plan
from etendue.types.documents import DocumentView


@dataclass(frozen=True)
class Former:
    """``keys`` of cells that differ from those they have now, and the platform in words."""

    keys: Mapping[CellRef, str] = field(default_factory=dict)
    platform: str = ""


def former_of(plan: Plan, record: DocumentView) -> Former:
    """The plan's cells on the platform of an earlier run."""
    then = planner.make_plan(plan.pipeline, installed_stages(), plan.leaves_out, versions=record["libraries"])
    own = {ref: cell.key for ref, cell in then.cells.items() if ref in plan.cells and cell.key != plan.cells[ref].key}
    return Former(own, in_words(record))


def accepted(former: Former, plan: Plan, finished: Iterable[tuple[CellRef, Entry]]) -> list[tuple[CellRef, Entry]]:
    """Finished cells of the former platform: they have the keys of this one from now on, and are marked."""
    if not former.platform:
        return []
    return [
        (ref, replace(one, key=plan.cells[ref].key, platform=one.platform or former.platform)) for ref, one in finished
    ]
