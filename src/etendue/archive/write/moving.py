"""A group of the store becomes another one: its shards get a second name there, then the journal says so, then the
first name goes.

In:  an archive opened for a run; groups and what they become.
Out: the same cells in other groups: no byte of them is copied where the disk knows hard links.

Killed at any instant every cell lies where the journal says: the old names go only when all cells are named under the
new ones.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from etendue.archive.journaling.entries import Entry
from etendue.archive.read.tree import ROOT
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.remote import stubs
from etendue.archive.write.clearing import CHUNK, PART, remove_node

if TYPE_CHECKING:
    from etendue.archive.write.store import ArchiveWriter


def move(store: ArchiveWriter, moves: Mapping[str, str]) -> None:
    """Give groups their new names: shards, parts of them, axes and lines of the journal."""
    store.change()
    root = disk.read_document(store.folder / DATA / ROOT) or {}
    if root.pop("consolidated_metadata", None):  # its readers would be given fill values under the old names
        disk.write(store.folder, f"{DATA}/{ROOT}", json.dumps(root).encode(), store.durable)
    for old, new in moves.items():
        variables = list(store.journal.blocks[old])
        if not _name_twice(store, old, new, variables):
            continue  # what stands there is computed again
        _say(store, old, new)
        for variable in variables:
            disk.remove(store.folder, f"{DATA}/{old}/{variable}/{ROOT}")  # nobody reads an array that loses its shards
        for variable in variables:
            remove_node(store.folder, store.listing, f"{old}/{variable}")
    store.listing = disk.Listing(store.folder)


def _name_twice(store: ArchiveWriter, old: str, new: str, variables: Iterable[str]) -> bool:
    """Give every file of cells a second name; whether that could be: other bytes may stand there already."""
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
    store.journal.set_arrays({new: variables})  # before any is there: nobody else has put it there
    store.ours |= {new, *(f"{new}/{variable}" for variable in variables)}
    for first, second in files:
        os.close(stubs.opened(store.folder, first))  # what lies on an object store has no second name there
        disk.link(store.folder, first, second, store.durable)
    store.behind.sealed(second for _, second in files if second in _shards(store, old, new).values())
    return True


def _shards(store: ArchiveWriter, old: str, new: str) -> dict[str, str]:
    """The shards of a group, and what they become."""
    return {path: there for path in store.journal.shards if (there := _moved(path, old, new)) != path}


def _moved(path: str, old: str, new: str) -> str:
    group, variable, name = path.rsplit("/", 2)
    return f"{DATA}/{new}/{variable}/{name}" if group == f"{DATA}/{old}" else path


def _say(store: ArchiveWriter, old: str, new: str) -> None:
    """The journal knows the cells of a group under its new name."""
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
