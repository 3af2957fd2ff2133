"""Limits on the size of a request, checked before memory for it is allocated.

In:  the text of a file, the document in it, the number of something.
Out: nothing; or one ``Fault`` with the number, the limit and a remedy.

Each limit is far above normal use and far below the capacity of a machine: planning a cell takes 0.1 ms and 6 kB.
"""

from __future__ import annotations

import re

from etendue.errors import Fault
from etendue.types.documents import DocumentView

LARGEST_FILE = 1 << 20  # bytes
MOST_KEYS = 10_000  # per file: tables, keys and the entries of tables in lists
MOST_LISTED = 200_000  # commas per file: more distinct numbers do not fit in it
MOST_NESTED = 16
LONGEST_NUMBER = 1000  # bits of an integer
MOST_PARTS = 32  # of a dotted key; the parser's time and memory grow with their square
MOST_CELLS = 1_000_000  # unless the file says ``most_cells``
MOST_POINTS = 1_000_000  # along one dim
MOST_BANDS = 20_000
MOST_VALUES = 10**11  # of one variable in one cell

_PART = r"""(?:[\w\-]+|"[^"\n]*"|'[^'\n]*')"""
_DOTTED = re.compile(rf"""(?<![\w\-"'])(?:{_PART}[ \t]*\.[ \t]*){{{MOST_PARTS}}}""")


def dotted_fault(text: str) -> Fault | None:
    """Return a fault if the text has a key of too many parts; checked before parsing."""
    found = _DOTTED.search(text)
    if found is None:
        return None
    return Fault(
        "",
        f"not a pipeline: a key of more than {MOST_PARTS} parts, {found[0][:20]}...",
        text.count("\n", 0, found.start()) + 1,
    )


def more_values(text: str, most_cells: int) -> Fault | None:
    """Return a fault if the text of an axis has more values than cells are allowed, since each value makes at least one
    cell. The text is checked before it is parsed.
    """
    count = text.count(",")
    if count <= most_cells + MOST_KEYS:
        return None
    return Fault("sweep", beyond(count, "values", most_cells, "to allow more, use --most-cells N"))


def document_fault(document: DocumentView) -> Fault | None:
    """Return a fault if a document is nested too deeply or has too many keys; checked without recursion."""
    keys, open_ = 0, [(document, "", 0)]
    while open_:
        value, place, depth = open_.pop()
        if isinstance(value, dict):
            items = [(str(key), one) for key, one in value.items()]
        elif isinstance(value, list | tuple):
            items = [("", one) for one in value if isinstance(one, int | dict | list | tuple)]
        else:
            if isinstance(value, int) and value.bit_length() > LONGEST_NUMBER:
                return Fault(place, "is a number of more than 300 digits")
            continue
        if depth > MOST_NESTED:
            return Fault(place, f"is nested more than {MOST_NESTED} deep")
        keys += sum(bool(key) or isinstance(one, dict | list | tuple) for key, one in items)
        if keys > MOST_KEYS:
            return Fault("", f"not a pipeline: more than {MOST_KEYS} tables and keys")
        open_ += [(one, place or key, depth + 1) for key, one in items]
    return None


def beyond(count: float, what: str, most: int, hint: str) -> str:
    """Return '3e+09 bands, more than the 20000 that are allowed; ...' if a count is above its limit, else ''."""
    if count <= most:
        return ""
    return f"{number(count)} {what}, more than the {number(most)} allowed; {hint}"


def number(count: float) -> str:
    """Return a readable count: in digits up to a million, else in scientific notation."""
    if count <= 1_000_000:
        return f"{int(count)}"
    try:
        return f"{float(count):.3g}"
    except OverflowError:
        return f"1e{len(str(count)) - 1}"
