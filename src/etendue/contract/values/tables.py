"""The table of a pipeline file that holds shared quantities, and the keys in it that name presets.

In:  the tables that distributions provide by ``etendue_tables``; a document.
Out: ``Table``. Every file may have ``[shared]``; a domain may give the table another name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache

from etendue.plugins import discovery
from etendue.types.documents import DocumentView

SHARED = "shared"


@dataclass(frozen=True)
class Table:
    """A table of shared quantities.

    ``preset``: the key that selects a named set of values, which may also be an axis; '' if the table has none.
    ``presets``: the hook that provides these sets; ``listed``: the command that lists them. ``find``: "module:function"
    instead of a hook, for names that are looked up: the function takes the text that names a preset and returns the
    path of its file, or raises RequestError. ``further``: more keys like ``preset`` in the same table, each with its
    own ``presets`` or ``find``, and ``listed``.
    """

    preset: str = ""
    presets: str = ""
    listed: str = ""
    name: str = SHARED
    find: str = ""
    further: Mapping[str, Mapping[str, str]] = field(default_factory=dict, hash=False)

    def place(self, name: str) -> str:
        """Return the name of a quantity as written outside the table."""
        return f"{self.name}.{name}"

    def kinds(self) -> tuple[Table, ...]:
        """Return one table per key that names presets, each as if the table had only this key."""
        own = {self.preset: self} if self.preset else {}
        return tuple({**own, **{word: self._kind(word) for word in self.further}}.values())

    def _kind(self, word: str) -> Table:
        own = self.further[word]
        presets, listed, find = (own.get(key, "") for key in ("presets", "listed", "find"))
        return Table(word, presets, listed, self.name, find)

    def words(self) -> tuple[str, ...]:
        """Return the keys that name presets."""
        return tuple(kind.preset for kind in self.kinds())

    def kind_of(self, word: str) -> Table:
        """Return the table as if it had only this preset key."""
        return next(kind for kind in self.kinds() if kind.preset == word)


@cache
def tables() -> dict[str, Table]:
    """Return all tables by name; the table that needs no distribution is last."""
    found = discovery.installed()
    own = {
        name: discovery.made_of(Table, f"the table {name!r}", brought)
        for name in found.names("tables")
        if (brought := found.first("tables", name))
    }
    return {**{name: replace(table, name=name) for name, table in own.items()}, SHARED: Table()}


def table_of(quantity: str) -> str:
    """Return the name of the table that the distribution of a quantity declares; if it declares none, the first."""
    found, every = discovery.installed(), list(tables())
    own = found.first("quantities", quantity)
    origin = {name: found.first("tables", name) for name in every}
    return next((name for name, by in origin.items() if own and by and by.distribution == own.distribution), every[0])


def table_in(document: DocumentView) -> Table:
    """Return the table in a document; if it has none, the first table."""
    every = tables()
    return next((table for name, table in every.items() if name in document), next(iter(every.values())))


def preset_keys() -> frozenset[str]:
    """Return the keys that name presets, in any table."""
    return frozenset(word for table in tables().values() for word in table.words())
