"""One table for terminal, notebook and JSON: rows go into JSON unchanged, columns define their text form.

In:  rows; for each column its name, its alignment, the key of the value in a row, the format of the value, and the text
     for a missing value.
Out: cells as text, which terminals and notebooks escape in their own ways.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from etendue.types.documents import Document

# name, side; key or function of a row (default: the column's position); format or function of a value; text for none
Column = Sequence[Any]


def cells(columns: Iterable[Column], rows: Iterable[Any]) -> list[list[str]]:
    """Return a row of texts for each row."""
    own = [(*(column[2:] or (place,)), "", "")[:3] for place, column in enumerate(columns)]
    return [[_text(of(row) if callable(of) else row[of], form, none) for of, form, none in own] for row in rows]


def once(rows: Iterable[Document], key: str, *also: str) -> list[Document]:
    """Return the rows; the value of ``key`` becomes '' if ``key`` and all of ``also`` have the same values as in the
    row above.
    """
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
