"""Presets: values of many shared quantities under one name, brought by distributions, each with the source it comes
from.

In:  a table and the name that its preset word has.
Out: a ``Preset``: values as they would stand in the table; what the pipeline itself says goes before them.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

from etendue.contract.tables import Table, tables
from etendue.errors import RequestError, nearest
from etendue.plugins import discovery
from etendue.telling import plain
from etendue.types.documents import Document

TYPICAL = "typical"
SPOKEN = (TYPICAL, "definition", "seed paper")  # how a source begins that is no address


@dataclass(frozen=True)
class Sourced:
    """One value, and who says so. ``typical``: nobody citable; a value that such things have."""

    value: Any
    source: str
    note: str = ""


@dataclass(frozen=True)
class Preset:
    """What a name gives the table of shared quantities, and what else is published of it."""

    name: str
    title: str
    kind: str
    description: str
    shared: Mapping[str, Sourced]
    facts: Mapping[str, Sourced]
    distribution: str
    version: str

    def values(self) -> Document:
        """As in the table."""
        return {name: sourced.value for name, sourced in self.shared.items()}


def preset_names(table: Table | None = None) -> tuple[str, ...]:
    """The presets of a table; without one those of all tables."""
    hooks = [one.presets for one in ([table] if table else tables().values()) if one.presets]
    return tuple(sorted({name for hook in hooks for name in discovery.installed().names(hook)}))


@cache
def preset(name: str, table: Table | None = None) -> Preset:
    """The preset of a name, in a table or in the first that has presets.

    Raises
    ------
    RequestError
        There is none of that name, with the nearest one; two distributions bring it; what is brought cannot be read.
    """
    found = discovery.installed()
    table = table or next((one for one in tables().values() if one.presets), None)
    if table is None or not table.presets:
        raise RequestError(f"there is no preset {name!r}; nothing that is installed brings any")
    what = table.preset
    brought = found.all(table.presets, name)
    if not brought:
        hint = nearest(name, preset_names(table)) or (f"; {table.listed} lists them" if table.listed else "")
        raise RequestError(f"there is no {what} {name!r}{hint}{found.missed(table.presets, name)}")
    if clash := found.clash(table.presets, name):
        raise RequestError(f"the {what} {name!r} is {clash}")
    (one,) = brought
    try:
        document = one.value
        if not isinstance(document, Mapping):
            document = tomllib.loads(Path(document).read_text(encoding="utf-8"), parse_float=Decimal)
        read = {
            part: {
                key: Sourced(entry["value"], entry["source"], entry.get("note", ""))
                for key, entry in document.get(part, {}).items()
            }
            for part in (table.name, "facts")
        }
        words = (document["title"], document["kind"], document["description"])
    except (OSError, ValueError, TypeError, AttributeError, KeyError) as error:
        lacking = f"{error} is lacking" if isinstance(error, KeyError) else plain(str(error))
        form = f"expected title, kind, description, and a value and its source under {table.name}.NAME"
        raise RequestError(f"the {what} {name!r} of {one.origin} cannot be read: {lacking}; {form}") from error
    return Preset(name, *words, read[table.name], read["facts"], one.distribution, one.version)
