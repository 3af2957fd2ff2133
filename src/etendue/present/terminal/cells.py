"""One table for terminal, notebook and JSON: rows stand in JSON as they are, columns say how they are read.

In:  rows; for each column its name, the side to which it is set, what of a row stands in it, its form, and what stands
     where there is nothing.
Out: cells as text, which terminals and notebooks escape in their own ways.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from etendue.types.documents import Document

# name, side; key or function of a row, its place where there is none; form or function of a value; what stands for none
Column = Sequence[Any]


def cells(columns: Iterable[Column], rows: Iterable[Any]) -> list[list[str]]:
    """A row of texts for each row."""
    own = [(*(column[2:] or (place,)), "", "")[:3] for place, column in enumerate(columns)]
    return [[_text(of(row) if callable(of) else row[of], form, none) for of, form, none in own] for row in rows]


def once(rows: Iterable[Document], key: str, *also: str) -> list[Document]:
    """The rows; ``key`` is empty where it and ``also`` are as in the row above."""
    told, above = [], None
    for row in rows:
        own = [row[name] for name in (key, *also)]
        told.append({**row, key: ""} if own == above else row)
        above = own
    return told


def _text(value: Any, form: str | Callable[[Any], str], none: str) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return none
    return form(value) if callable(form) else format(value, form)
