"""Removal of files from an archive: only files with names that runs give, in folders that were listed without following
links.

In:  the folder of an archive, and a listing of it.
Out: half-written files of killed runs, and groups and arrays that are no longer wanted, are removed.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection
from pathlib import Path

from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.names import ROOT

CHUNK = re.compile(r"c(\.\d+)*")
PART = re.compile(r"\.c(\.\d+)*\.[0-9a-f]{12}" + re.escape(disk.PART))
ASIDE = re.compile(r"\..*\.\d+\.\d+" + re.escape(disk.PARTIAL))


def sweep(folder: Path, listing: disk.Listing, kept: Collection[str]) -> None:
    """Remove half-written files of killed runs, except parts that hold finished cells (``kept``)."""
    for place, names in listing.files.items():
        for name in names:
            if name.startswith(".") and name.endswith(disk.PARTIAL):
                disk.remove(folder, f"{place}/{name}")
            elif PART.fullmatch(name) and f"{place}/{name}" not in kept:
                disk.remove(folder, f"{place}/{name}")
    for name in filter(ASIDE.fullmatch, os.listdir(folder)):
        disk.remove(folder, name)


def remove_node(folder: Path, listing: disk.Listing, node: str) -> None:
    """Remove a group or array: its metadata, shards and chunks, by name. Files that no run has written are kept."""
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
    """Return the number of dims of the single chunk of a plain array (nested folders of it); 0 if there is no chunk."""
    place, count = f"{DATA}/{node}/c", int("c" in listing.folders.get(f"{DATA}/{node}", ()))
    while count and "0" in listing.folders.get(place, ()):
        place, count = f"{place}/0", count + 1
    return count


def nodes_on_disk(listing: disk.Listing, path: str) -> list[str]:
    """Return the paths of the groups and arrays at and below a folder of the store."""
    own = [path] if listing.has(f"{DATA}/{path}/{ROOT}") else []
    for name in sorted(listing.folders.get(f"{DATA}/{path}", ())):
        own += nodes_on_disk(listing, f"{path}/{name}")
    return own
