"""What a run removes of an archive: by the names that runs give, in folders that were listed without links, and nothing
else.

In:  the folder of an archive, a listing of it.
Out: what killed runs left half written is gone; groups and arrays that nobody asks for any more.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection
from pathlib import Path

from etendue.archive.read.tree import ROOT
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA

CHUNK = re.compile(r"c(\.\d+)*")
PART = re.compile(r"\.c(\.\d+)*\.[0-9a-f]{12}" + re.escape(disk.PART))
ASIDE = re.compile(r"\..*\.\d+\.\d+" + re.escape(disk.PARTIAL))


def sweep(folder: Path, listing: disk.Listing, kept: Collection[str]) -> None:
    """Remove what a killed run left half written, parts that hold finished cells aside."""
    for place, names in listing.files.items():
        for name in names:
            if name.startswith(".") and name.endswith(disk.PARTIAL):
                disk.remove(folder, f"{place}/{name}")
            elif PART.fullmatch(name) and f"{place}/{name}" not in kept:
                disk.remove(folder, f"{place}/{name}")
    for name in filter(ASIDE.fullmatch, os.listdir(folder)):
        disk.remove(folder, name)


def remove_node(folder: Path, listing: disk.Listing, node: str) -> None:
    """Remove a group or array: metadata, shards and chunks, by name; what somebody else put beside them stays."""
    place = f"{DATA}/{node}"
    for name in listing.files.get(place, ()):
        if name == ROOT or CHUNK.fullmatch(name) or PART.fullmatch(name):
            disk.remove(folder, f"{place}/{name}")
    if "c" in listing.folders.get(place, ()):
        _remove_digits(folder, listing, f"{place}/c")
    if place in listing.files:
        disk.remove_folder(folder, place)


def _remove_digits(folder: Path, listing: disk.Listing, place: str) -> None:
    for name in listing.files.get(place, ()):
        if name.isdigit():
            disk.remove(folder, f"{place}/{name}")
    for name in listing.folders.get(place, ()):
        if name.isdigit():
            _remove_digits(folder, listing, f"{place}/{name}")
    disk.remove_folder(folder, place)


def dims_on_disk(listing: disk.Listing, node: str) -> int:
    """How many dims the one chunk of a plain array has, a folder for each but the last; 0: there is none."""
    place, count = f"{DATA}/{node}/c", int("c" in listing.folders.get(f"{DATA}/{node}", ()))
    while count and "0" in listing.folders.get(place, ()):
        place, count = f"{place}/0", count + 1
    return count


def nodes_on_disk(listing: disk.Listing, path: str) -> list[str]:
    """Groups and arrays at and below a folder of the store."""
    own = [path] if listing.has(f"{DATA}/{path}/{ROOT}") else []
    for name in sorted(listing.folders.get(f"{DATA}/{path}", ())):
        own += nodes_on_disk(listing, f"{path}/{name}")
    return own
