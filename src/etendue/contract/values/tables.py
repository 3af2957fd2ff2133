"""The table of a pipeline file that holds shared quantities, and the key in it that names a preset.

In:  what distributions bring by ``etendue_tables``; a document.
Out: ``Table``. Every file may have ``[shared]``; a domain may give the table a name of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

from etendue.plugins import discovery
from etendue.types.documents import DocumentView

SHARED = "shared"


@dataclass(frozen=True)
class Table:
    """A table of shared quantities.

    ``preset``: the key, and axis, that names a set of values, '' for none; ``presets``: the hook that brings such sets;
    ``listed``: the command that lists them."""

    preset: str = ""
    presets: str = ""
    listed: str = ""
    name: str = SHARED

    def place(self, name: str) -> str:
        """Return the name of a quantity as written outside the table."""
        return f"{self.name}.{name}"


@cache
def tables() -> dict[str, Table]:
    """Return all tables by name; the one that needs no distribution is last."""
    found = discovery.installed()
    own = {
        name: discovery.made_of(Table, f"the table {name!r}", brought)
        for name in found.names("tables")
        if (brought := found.first("tables", name))
    }
    return {**{name: replace(table, name=name) for name, table in own.items()}, SHARED: Table()}


def table_in(document: DocumentView) -> Table:
    """Return the table that a document has; if it has none, the first one."""
    every = tables()
    return next((table for name, table in every.items() if name in document), next(iter(every.values())))


def preset_keys() -> frozenset[str]:
    """Return the keys that name presets, in any table."""
    return frozenset(table.preset for table in tables().values() if table.preset)
