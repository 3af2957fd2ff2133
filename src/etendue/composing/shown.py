"""Plans and pipelines as they look in a notebook.

In:  documents of numbers and texts, which may come from anywhere.
Out: HTML without scripts; texts are escaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from etendue.report.terminal import human_seconds
from etendue.telling import human_bytes

STYLE = "text-align:left;padding:2px 10px 2px 0;border:0;vertical-align:top"


def table_page(title: str, heads: Sequence[str], rows: Iterable[Sequence[Any]], notes: Sequence[str] = ()) -> str:
    """A table with its title above and notes (HTML) below."""
    head = "".join(f'<th style="{STYLE}">{escape(name)}</th>' for name in heads)
    body = "".join("<tr>" + "".join(f'<td style="{STYLE}">{escape(str(cell))}</td>' for cell in row) + "</tr>" for row in rows)
    below = "".join(f"<div>{note}</div>" for note in notes)
    return f"<div><b>{escape(title)}</b><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{below}</div>"


def plan_page(document: dict[str, Any]) -> str:
    """What ``etendue plan`` prints."""
    rows = [
        (
            stage["name"], " \u00d7 ".join(stage["axes"]) or "-", stage["cells"], stage["left_out"]["cells"] if stage["left_out"] else "",
            human_bytes(stage["bytes"]), human_seconds(stage["seconds"]),
        )
        for stage in document["stages"]
    ]  # fmt: skip
    whole = (
        f"{document['cells']} cells ({document['naive_cells']} if every stage ran at every point), {human_bytes(document['bytes'])}, "
        f"about {human_seconds(document['seconds'])} of thread time, {human_bytes(document['peak_memory'])} held at most"
    )
    notes = [whole, *(f"note: {escape(text)}" for text in document["warnings"])]
    return table_page(f"plan of {document['name']}", ("stage", "axes", "cells", "left out", "stored", "time"), rows, notes)
