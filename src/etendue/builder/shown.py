"""Plans and pipelines as shown in a notebook.

In:  documents of numbers and untrusted texts.
Out: HTML without scripts; texts are escaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from etendue.plan.planner import summary
from etendue.present.html_tables import rows_of
from etendue.present.terminal.cells import Column
from etendue.present.terminal.terminal import expected_seconds, plan_columns
from etendue.run.peak_memory import peak_memory, workers_of
from etendue.telling import human_bytes
from etendue.types.documents import Document

if TYPE_CHECKING:
    from etendue.plan.model import Plan


def table_page(title: str, columns: Sequence[Column], rows: Iterable[Any], notes: Sequence[str] = ()) -> str:
    """Return a table with its title above and notes (HTML) below."""
    below = "".join(f"<div>{note}</div>" for note in notes)
    return f"<div><b>{escape(title)}</b>{rows_of(columns, rows)}{below}</div>"


def plan_page(document: Document) -> str:
    """Return the output of ``etendue plan`` as HTML."""
    columns = plan_columns(lambda axes: " \u00d7 ".join(axes) or "-")
    whole = (
        f"{document['cells']} cells ({document['naive_cells']} if every stage ran at every point), "
        f"{human_bytes(document['bytes'])}, "
        f"about {expected_seconds(document)} of CPU time, at most {human_bytes(document['peak_memory'])} "
        f"of memory"
    )
    notes = [whole, *(f"note: {escape(text)}" for text in document["warnings"])]
    return table_page(f"plan of {document['name']}", columns, document["stages"], notes)


@dataclass(frozen=True)
class Planned:
    """The planned work: stages, cells, bytes, time, and omissions with their reasons."""

    plan: Plan

    @property
    def cells(self) -> int:
        return len(self.plan.cells)

    def document(self) -> Document:
        """Return the document that ``etendue plan --json`` prints."""
        return summary(self.plan, peak_memory(self.plan, workers_of("threads", 0)).bytes)

    def __repr__(self) -> str:
        own = self.document()
        return (
            f"<plan of {own['name']}: {len(own['stages'])} stages, {own['cells']} cells, about {own['seconds']:.2g} "
            f"s of CPU time>"
        )

    def _repr_html_(self) -> str:
        return plan_page(self.document())
