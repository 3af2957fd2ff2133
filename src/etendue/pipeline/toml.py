"""Write a document as TOML text that ``tomllib`` reads back as the same document.

In:  tables, lists, text, numbers (int, float, Decimal), true and false; nothing else.
Out: text: plain keys and values first, then tables, then lists of tables.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from decimal import Decimal

from etendue.types.documents import DocumentView

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_ESCAPES = {"\\": "\\\\", '"': '\\"', "\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f", "\r": "\\r"}


def _text(value: str) -> str:
    written = [
        _ESCAPES.get(c) or (c if c.isprintable() else f"\\U{ord(c):08X}" if ord(c) > 0xFFFF else f"\\u{ord(c):04X}")
        for c in value
    ]
    return f'"{"".join(written)}"'


def key(name: str) -> str:
    """Return a key, in quotes if it needs them."""
    return name if _BARE.fullmatch(name) else _text(name)


def value(found: object) -> str:
    """Return a value on one line.

    Raises
    ------
    TypeError
        If TOML has no such value.
    """
    if isinstance(found, bool):
        return "true" if found else "false"
    if isinstance(found, str):
        return _text(found)
    if isinstance(found, Mapping):
        return (
            "{ " + ", ".join(f"{key(str(name))} = {value(one)}" for name, one in found.items()) + " }"
            if found
            else "{}"
        )
    if isinstance(found, list | tuple):
        return f"[{', '.join(map(value, found))}]"
    if hasattr(found, "item") and not isinstance(found, Decimal):
        return value(found.item())  # a numpy scalar
    if isinstance(found, int):
        return str(found)
    if isinstance(found, float | Decimal):
        if not math.isfinite(found):
            return "nan" if math.isnan(found) else "inf" if found > 0 else "-inf"
        return str(found if isinstance(found, Decimal) else Decimal(repr(found)))  # as it is once it has been read
    raise TypeError(f"TOML has no {type(found).__name__}")


def dumps(document: DocumentView) -> str:
    """Return the text of a document whose tables hold plain values."""
    tables = {name: found for name, found in document.items() if isinstance(found, Mapping)}
    lists = {
        name: found
        for name, found in document.items()
        if isinstance(found, list) and found and isinstance(found[0], Mapping)
    }
    parts = [_lines({name: found for name, found in document.items() if name not in tables and name not in lists})]
    parts += [f"[{key(name)}]\n{_lines(found)}" for name, found in tables.items()]
    parts += [f"[[{key(name)}]]\n{_lines(one)}" for name, found in lists.items() for one in found]
    return "\n".join(part for part in parts if part)


def _lines(table: DocumentView) -> str:
    return "".join(f"{key(name)} = {value(found)}\n" for name, found in table.items())
