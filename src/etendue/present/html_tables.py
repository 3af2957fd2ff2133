"""HTML tables for notebooks.

In:  rows of numbers and texts from any source, and the columns that define how they are shown.
Out: HTML without scripts; texts are escaped.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from etendue.present.terminal.cells import Column, cells
from etendue.telling import printable

STYLE = "text-align:left;padding:2px 10px 2px 0;border:0;vertical-align:top"


def rows_of(columns: Sequence[Column], rows: Iterable[Any]) -> str:
    """Return a table without a title."""
    head = "".join(f'<th style="{STYLE}">{_safe(name)}</th>' for name, *_ in columns)
    body = "".join(
        "<tr>" + "".join(f'<td style="{STYLE}">{_safe(text)}</td>' for text in row) + "</tr>"
        for row in cells(columns, rows)
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def table(
    title: str,
    columns: Sequence[Column],
    rows: Iterable[Any],
    notes: Sequence[str] = (),
    colour: str = "",
    folded: bool = False,
) -> str:
    """Return a table with its title above and notes below; with ``folded`` the table is hidden until its title is
    clicked.
    """
    below = "".join(f"<div>{_safe(note)}</div>" for note in notes)
    own = f"{rows_of(columns, rows)}{below}"
    tint = f' style="color:{colour}"' if colour else ""
    named = f"<b{tint}>{_safe(title)}</b>"
    if folded:
        return f'<details style="margin-top:.6em"><summary>{named}</summary>{own}</details>'
    return f'<div style="margin-top:.6em">{named}{own}</div>'


def _safe(text: str) -> str:
    return escape(printable(text))
