"""Plans and pipelines as shown in a notebook.

In:  documents of numbers and texts, which may come from anywhere.
Out: HTML without scripts; texts are escaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from etendue.present.terminal.cells import Column
from etendue.present.terminal.html_tables import rows_of
from etendue.present.terminal.terminal import expected_seconds, plan_columns
from etendue.telling import human_bytes
from etendue.types.documents import Document


def table_page(title: str, columns: Sequence[Column], rows: Iterable[Any], notes: Sequence[str] = ()) -> str:
    """Return a table with its title above and notes (HTML) below."""
    below = "".join(f"<div>{note}</div>" for note in notes)
    return f"<div><b>{escape(title)}</b>{rows_of(columns, rows)}{below}</div>"


def plan_page(document: Document) -> str:
    """Return what ``etendue plan`` prints, as HTML."""
    columns = plan_columns(lambda axes: " \u00d7 ".join(axes) or "-")
    whole = (
        f"{document['cells']} cells ({document['naive_cells']} if every stage ran at every point), "
        f"{human_bytes(document['bytes'])}, "
        f"about {expected_seconds(document)} of thread time, at most {human_bytes(document['peak_memory'])} "
        f"of memory"
    )
    notes = [whole, *(f"note: {escape(text)}" for text in document["warnings"])]
    return table_page(f"plan of {document['name']}", columns, document["stages"], notes)
