"""Plans and pipelines as they look in a notebook.

In:  documents of numbers and texts, which may come from anywhere.
Out: HTML without scripts; texts are escaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from etendue.present.terminal.html_tables import rows_of
from etendue.present.terminal.terminal import human_seconds
from etendue.telling import human_bytes
from etendue.types.documents import Document


def table_page(title: str, heads: Sequence[str], rows: Iterable[Sequence[Any]], notes: Sequence[str] = ()) -> str:
    """A table with its title above and notes (HTML) below."""
    below = "".join(f"<div>{note}</div>" for note in notes)
    return f"<div><b>{escape(title)}</b>{rows_of(heads, rows)}{below}</div>"


def plan_page(document: Document) -> str:
    """What ``etendue plan`` prints."""
    rows = [
        (
            stage["name"],
            " \u00d7 ".join(stage["axes"]) or "-",
            stage["cells"],
            stage["left_out"]["cells"] if stage["left_out"] else "",
            human_bytes(stage["bytes"]),
            human_seconds(stage["seconds"]),
        )
        for stage in document["stages"]
    ]
    whole = (
        f"{document['cells']} cells ({document['naive_cells']} if every stage ran at every point), "
        f"{human_bytes(document['bytes'])}, "
        f"about {human_seconds(document['seconds'])} of thread time, {human_bytes(document['peak_memory'])} held at "
        f"most"
    )
    notes = [whole, *(f"note: {escape(text)}" for text in document["warnings"])]
    return table_page(
        f"plan of {document['name']}", ("stage", "axes", "cells", "left out", "stored", "time"), rows, notes
    )
