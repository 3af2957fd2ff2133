"""Foreign files: distinguish an archive from other folders, and find files in it that no run has written.

In:  a folder, and a listing of it.
Out: ``ArchiveError`` if a run would overwrite, or write among, files that are not its own.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA, Manifest, digest_of
from etendue.archive.records.names import ROOT
from etendue.archive.records.owner import is_running
from etendue.archive.records.past_runs import latest_record
from etendue.archive.write.clearing import ASIDE, nodes_on_disk
from etendue.contract.values.names import TABLES
from etendue.errors import ArchiveError, ArchiveInUse
from etendue.types.documents import Document, DocumentView


def check_folder(folder: Path) -> None:
    """Refuse links and folders that are not archives. A folder in which another run is just starting may look like
    one, and is reported as in use.
    """
    for again in (False, True):
        try:
            check_ours(folder)
            disk.Listing(folder)
            return
        except (ArchiveError, FileNotFoundError):
            if is_running(folder):
                raise ArchiveInUse(f"{folder} is in use by another run") from None
            if again:  # so no run ended between the two attempts
                raise


def check_ours(folder: Path) -> None:
    """Refuse a folder that is not an archive."""
    names = {name for name in os.listdir(folder) if not ASIDE.fullmatch(name)} if folder.is_dir() else {""}
    begun = names <= {"lock", "journal.jsonl", "run.id", DATA} and not any(
        p.is_dir() for p in (folder / DATA).glob("*")
    )
    if begun or "etendue" in _root_attributes(folder):
        return
    begins = rb'\{"event":"(axes|arrays|start|done|run)"'  # as our journals do
    if DATA not in names or not (
        latest_record(folder) or re.match(begins, disk.content_of(folder / "journal.jsonl") or b"")
    ):
        raise ArchiveError(f"{folder} exists but is not an archive; choose another folder with --archive DIR")


def _root_attributes(folder: Path) -> Document:
    found = (disk.read_document(folder / DATA / ROOT) or {}).get("attributes")
    return found if isinstance(found, dict) else {}


def known_axes(folder: Path, manifest: Manifest | None, record: DocumentView | None) -> Document | None:
    """Return the stages with which the archive was created, and their axes, read from an intact source."""
    root: Any = _root_attributes(folder).get("etendue")
    axes = root.get("axes") if isinstance(root, dict) else None
    whole = isinstance(axes, dict) and all(isinstance(names, list) for names in axes.values())
    path = f"{DATA}/{ROOT}"
    if whole and manifest and manifest.metadata.get(path) == digest_of(folder / path):
        return axes
    recorded = (record or {}).get("stages")
    return recorded if isinstance(recorded, dict) else axes if whole else None


def other_stages(
    folder: Path,
    old: DocumentView,
    new: DocumentView,
    wanted: Iterable[str] | None,
    record: DocumentView | None,
) -> str:
    """Return the reason why a run with other stages or axes cannot continue in this archive, and the command to use
    instead. ``wanted``: the stages that the run is limited to.
    """
    lacking, over = [n for n in new if n not in old], sorted(set(old) - set(new))
    axes = [n for n in new if n in old and old[n] != new[n]]
    free = next(name for n in itertools.count(2) if not (folder.parent / (name := f"{folder.name}-{n}")).exists())
    ways = [f"Use another archive: --archive {free}"]
    if over and not lacking and not axes and wanted:
        ways.append(f"or continue in {folder.name} without --want {' --want '.join(wanted)}")
    if lacking and wanted and (before := _wanted_before(record)):
        both = dict.fromkeys([*before, *wanted])
        ways.append(f"or get both in one archive: --archive {free} --want {' --want '.join(map(shlex.quote, both))}")
    return (
        f"{folder} was made with other stages or axes ({_unlike(old, new, lacking, over, axes)}); both are fixed when "
        f"an archive is created. {'; '.join(ways)}"
    )


def _unlike(
    old: DocumentView, new: DocumentView, lacking: Sequence[str], over: Sequence[str], axes: Sequence[str]
) -> str:
    """Return a text that says how the stages of an archive and of a run differ; ``axes``: stages of both that have
    different axes.
    """
    there, here = ({dim for dims in own.values() for dim in dims} for own in (old, new))
    parts = {
        "not in the archive": lacking,
        "not in this run": over,
        "swept only in this run": sorted(here - there) if axes else (),
        "swept only in the archive": sorted(there - here) if axes else (),
        "axes affect other stages": axes if here == there else (),
    }
    return "; ".join(f"{what}: {_some(names)}" for what, names in parts.items() if names)


def _wanted_before(record: DocumentView | None) -> list[str]:
    """Return the ``wanted`` stages in the record of the last run; empty if the record has no ``wanted``."""
    try:
        before = json.loads((record or {}).get("overrides", {}).get("wanted", "[]"))
    except (ValueError, TypeError, AttributeError):
        return []
    return list(map(str, before)) if isinstance(before, list) else []


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def refuse_strangers(folder: Path, listing: disk.Listing, stages: set[str], ours: set[str]) -> None:
    """Refuse foreign groups or arrays that lie inside a group that runs write, or have the path of such a group,
    because they would be lost or break the tree. Other foreign groups are allowed.
    """
    for name in sorted(listing.folders.get(DATA, ())):
        found = [name] if name not in stages and name not in TABLES else []
        if found and name not in ours:
            document = disk.read_document(folder / DATA / name / ROOT)
            if document is None or document.get("node_type") == "group":
                continue
        else:
            inside = nodes_on_disk(listing, name) if ours and name not in TABLES else []
            found = [node for node in inside if node not in ours]
        if found:
            raise ArchiveError(
                f"{folder / DATA / found[0]} was not written by a run of this archive, but lies at a place that "
                "is reserved for results; "
                f"move it elsewhere (a group of your own may be directly in {DATA})"
            )
