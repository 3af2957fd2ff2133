"""Presets: values of many shared quantities under one name, provided by distributions, each with its source.

In:  a table and the value of its preset key.
Out: a ``Preset``: values as they would be in the table; the pipeline's own values override them.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

from etendue import plain_files
from etendue.contract.values.tables import Table, tables
from etendue.errors import RequestError, nearest
from etendue.plugins import discovery
from etendue.telling import plain
from etendue.types.documents import Document

TYPICAL = "typical"
COPY = re.compile(r"\.\./inputs/[0-9a-f]{64}[^/]*")  # a file of an archive, named from its records
BESIDE = re.compile(r"[0-9a-f]{64}\.\w+")  # a file next to that of a preset, named by its SHA-256
SPOKEN = (TYPICAL, "definition", "the paper")  # beginnings of a source that is not a URL


@dataclass(frozen=True)
class Sourced:
    """One value, its source and the licence of the source if it has one."""

    value: Any
    source: str
    note: str = ""
    licence: str = ""

    @property
    def stands_in(self) -> bool:
        """Return whether the value is a stand-in: a usual value without a citable source."""
        return self.source.startswith(TYPICAL)

    def words(self) -> dict[str, str]:
        """Return the description of the source."""
        return {"source": self.source, "licence": self.licence, "note": self.note}


@dataclass(frozen=True)
class Preset:
    """The values that a name gives to the table of shared quantities, and other published facts."""

    name: str
    title: str
    kind: str
    description: str
    shared: Mapping[str, Sourced]
    facts: Mapping[str, Sourced]
    distribution: str
    version: str
    file: str = ""  # its document, if it was named by a path or found by its name

    def values(self) -> Document:
        """Return the values, as in the table."""
        return {name: sourced.value for name, sourced in self.shared.items()}


def preset_names(table: Table | None = None) -> tuple[str, ...]:
    """Return the names of the presets of a table, or of all tables."""
    kinds = [table] if table else [kind for one in tables().values() for kind in one.kinds()[:1]]
    hooks = [one.presets for one in kinds if one.presets]
    return tuple(sorted({name for hook in hooks for name in discovery.installed().names(hook)}))


@cache
def preset(name: str, table: Table | None = None) -> Preset:
    """Return the preset of a name, in a table or in the first table that has presets.

    Raises
    ------
    RequestError
        If the name is unknown (the message gives the closest name), two distributions provide it, or its file cannot be
        read.
    """
    found = discovery.installed()
    table = table or next((one for one in tables().values() if one.presets), None)
    if table is None or not table.presets:
        raise RequestError(f"unknown preset {name!r}; no installed distribution provides presets")
    what = table.preset
    brought = found.all(table.presets, name)
    if not brought:
        hint = nearest(name, preset_names(table)) or (f"; {table.listed} lists them" if table.listed else "")
        raise RequestError(f"unknown {what} {name!r}{hint}{found.missed(table.presets, name)}")
    if clash := found.clash(table.presets, name):
        raise RequestError(f"the {what} {name!r} is {clash}")
    (one,) = brought
    return _read(one.value, name, table, one.origin, one.distribution, one.version)


def is_file(name: str) -> bool:
    """Return whether the name of a preset is the path of a file: ``./mine.toml``."""
    return name.endswith(".toml")


def preset_at(name: str, table: Table | None, folder: Path) -> Preset:
    """Return a preset by its name, or from a file: ``./mine.toml`` next to the pipeline in ``folder``.

    Raises
    ------
    RequestError
        As `preset`; or the file cannot be read. A record of an archive may come from anywhere and names only files in
        its ``inputs/``.
    """
    if not is_file(name):
        if table is None or not table.find:
            return preset(name, table)
        found = discovery.loaded(table.find, f"the function that finds a {table.preset}")(name)
        return _of_file(str(found), Path(found), name, table)
    table = table or next((one for one in tables().values() if one.presets), None)
    if table is None or not (table.presets or table.find) or (folder.name == "runs" and not COPY.fullmatch(name)):
        raise RequestError(
            f"{name!r}: a file cannot be a {table.preset if table else 'preset'} here; give its values instead"
        )
    path = (folder / name).absolute()
    if folder.name == "runs" and not path.resolve().is_relative_to((folder.parent / "inputs").resolve()):
        raise RequestError(f"the {table.preset} {name!r} is not in the archive's inputs/")
    return _of_file(name, path, name, table)


def _of_file(said: str, path: Path, name: str, table: Table) -> Preset:
    try:
        text = plain_files.table(path).decode("utf-8")
        document = tomllib.loads(text, parse_float=Decimal)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or plain(str(error))
        raise RequestError(
            f"the {table.preset} {said!r} cannot be read: {why}; relative paths start at the pipeline's folder"
        ) from None
    read = _read(document, name, table, str(path), "", "")
    beside = {key: replace(one, value=_beside(one.value, said, path)) for key, one in read.shared.items()}
    return replace(read, shared=beside, file=str(path))


def _beside(value: Any, said: str, path: Path) -> Any:
    """Return a value of a preset. The name of a file that is named by its SHA-256 becomes its path next to the preset's
    file.
    """
    if not isinstance(value, str) or not BESIDE.fullmatch(value):
        return value
    return f"../inputs/{value}" if COPY.fullmatch(said) else str(path.parent / value)


def _read(document: Any, name: str, table: Table, origin: str, distribution: str, version: str) -> Preset:
    """Return a preset from a document, or from the path of its file."""
    what = table.preset
    try:
        if not isinstance(document, Mapping):
            document = tomllib.loads(Path(document).read_text(encoding="utf-8"), parse_float=Decimal)
        read = {
            part: {
                key: Sourced(entry["value"], entry["source"], entry.get("note", ""), entry.get("licence", ""))
                for key, entry in document.get(part, {}).items()
            }
            for part in (table.name, "facts")
        }
        words = (document["title"], document["kind"], document["description"])
    except (OSError, ValueError, TypeError, AttributeError, KeyError) as error:
        lacking = f"{error} is missing" if isinstance(error, KeyError) else plain(str(error))
        form = f"expected title, kind, description, and a value and its source under {table.name}.NAME"
        raise RequestError(f"the {what} {name!r} of {origin} cannot be read: {lacking}; {form}") from error
    return Preset(name, *words, read[table.name], read["facts"], distribution, version)
