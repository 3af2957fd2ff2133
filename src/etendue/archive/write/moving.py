"""Rename a group of the store: its shards get second names in the new group, the journal is updated, and the first
names are removed.

In:  an archive opened for a run; groups and their new names.
Out: the same cells in other groups; no byte is copied if the file system supports hard links.

If the run is killed at any instant, every cell is where the journal says: the old names are removed only when all cells
are recorded under the new names.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from etendue.archive.journaling.entries import Entry
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.names import ROOT
from etendue.archive.remote import stubs
from etendue.archive.write.clearing import CHUNK, PART, remove_node

if TYPE_CHECKING:
    from etendue.archive.write.store import ArchiveWriter


def move(store: ArchiveWriter, moves: Mapping[str, str]) -> None:
    """Give groups their new names: shards, parts, axes and journal lines."""
    store.change()
    root = disk.read_document(store.folder / DATA / ROOT) or {}
    # Readers of the consolidated metadata would get fill values under the old names.
    if root.pop("consolidated_metadata", None):
        disk.write(store.folder, f"{DATA}/{ROOT}", json.dumps(root).encode(), store.durable)
    for old, new in moves.items():
        variables = list(store.journal.blocks[old])
        if not _name_twice(store, old, new, variables):
            continue  # its cells are recomputed
        _say(store, old, new)
        for variable in variables:
            # first, so that nobody reads an array that is losing its shards
            disk.remove(store.folder, f"{DATA}/{old}/{variable}/{ROOT}")
        for variable in variables:
            remove_node(store.folder, store.listing, f"{old}/{variable}")
    store.listing = disk.Listing(store.folder)


def _name_twice(store: ArchiveWriter, old: str, new: str, variables: Iterable[str]) -> bool:
    """Give every file of the cells a second name; return False if other files already have these names."""
    places = [(f"{DATA}/{old}/{variable}", f"{DATA}/{new}/{variable}") for variable in variables]
    files = [
        (f"{a}/{name}", f"{b}/{name}")
        for a, b in places
        for name in store.listing.files.get(a, ())
        if CHUNK.fullmatch(name) or PART.fullmatch(name)
    ]
    if any(
        os.path.lexists(store.folder / b) and not os.path.samefile(store.folder / a, store.folder / b) for a, b in files
    ):
        return False
    store.journal.set_arrays({new: variables})  # before any exists, which marks them as ours
    store.ours |= {new, *(f"{new}/{variable}" for variable in variables)}
    for first, second in files:
        os.close(stubs.opened(store.folder, first))  # fetch stubs: objects cannot be hard-linked
        disk.link(store.folder, first, second, store.durable)
    store.behind.sealed(second for _, second in files if second in _shards(store, old, new).values())
    return True


def _shards(store: ArchiveWriter, old: str, new: str) -> dict[str, str]:
    """Return the shards of a group and their new paths."""
    return {path: there for path in store.journal.shards if (there := _moved(path, old, new)) != path}


def _moved(path: str, old: str, new: str) -> str:
    group, variable, name = path.rsplit("/", 2)
    return f"{DATA}/{new}/{variable}/{name}" if group == f"{DATA}/{old}" else path


def _say(store: ArchiveWriter, old: str, new: str) -> None:
    """Record the cells of a group under its new name in the journal."""
    journal = store.journal
    journal.set_axes({new: journal.axes[old]})
    journal.set_blocks({new: journal.blocks[old]})
    journal.put({there: journal.shards[path] for path, there in _shards(store, old, new).items()})

    def moved(entry: Entry) -> Entry:
        return replace(entry, files=tuple(replace(one, path=_moved(one.path, old, new)) for one in entry.files))

    own = ((name, journal.entries[name]) for name in list(journal.entries) if name.partition(" ")[0] == old)
    outdated = set(journal.outdated)
    journal.end([(name, moved(entry)) for name, entry in own if entry.files])
    journal.set_outdated(outdated)
    journal.forget_axes([old])
