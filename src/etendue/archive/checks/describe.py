"""Describe an archive without opening its arrays: from the journal, the run records and the metadata."""

from __future__ import annotations

import calendar
import math
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.journaling.journal import Read, read
from etendue.archive.read.stored import Stored
from etendue.archive.read.studies import stored_studies
from etendue.archive.records import disk
from etendue.archive.records.manifest import NAME, damaged, read_manifest
from etendue.archive.records.names import ROW, left_by_compact
from etendue.archive.records.owner import is_running
from etendue.archive.records.past_runs import latest_record, record_paths
from etendue.errors import ArchiveError
from etendue.types.documents import Document


def refuse_changed(folder: Path, running: bool) -> None:
    """Check metadata, coordinates, tables and records (everything but the journal and the chunks of cells) against the
    manifest.

    Raises
    ------
    ArchiveError
        A file is missing or differs from what was written.
    """
    manifest = read_manifest(folder) if not running else None
    changed = manifest.changed(folder) if manifest else []
    if manifest is None and not running and (folder / NAME).exists():
        changed = [NAME]
    if changed and not is_running(folder):  # a run may have begun since
        raise damaged(folder, changed)


@dataclass(frozen=True)
class Checked:
    """An archive whose files, except the chunks of cells (which are not read), are as written."""

    listing: disk.Listing
    journal: Read
    record: Document  # of the latest run
    records: list[Path]
    running: bool


def checked(folder: Path) -> Checked:
    """Check everything of an archive except its chunks.

    Raises
    ------
    ArchiveError
        The folder is not an archive, or it is damaged; the message names the damage and the command that repairs it.
    """
    root = folder / "data.zarr"
    manifest, records = read_manifest(folder), record_paths(folder) if folder.is_dir() else []
    if not root.is_dir() or (not records and not manifest and not (folder / JOURNAL).is_file()):
        lacking = disk.lacks(folder, "data.zarr with a run record")
        raise ArchiveError(f"{folder} is not an archive of etendue ({lacking})")
    listing = disk.Listing(folder)
    running = is_running(folder)
    refuse_changed(folder, running)
    record = latest_record(folder)
    if record is None:
        if running:
            raise ArchiveError(f"{folder}: a run is just starting; try again in a moment")
        raise damaged(folder, [f"runs/{path.name}" for path in records[-1:]] or ["runs"])
    journal = read(folder / JOURNAL)
    if journal.damaged and not running:
        raise damaged(folder, [JOURNAL])
    if not running and (odd := Stored(folder, journal=journal).odd()):
        raise damaged(folder, odd)
    return Checked(listing, journal, record, records, running)


def describe_archive(folder: Path) -> Document:
    """Return the stages with their variables and cells, axes, size, progress, and whether a run is active.

    Raises
    ------
    ArchiveError
        The folder is not an archive, or it is damaged; the message names the damage and the command that repairs it.
    """
    found = checked(folder)
    root, listing, journal, record = folder / "data.zarr", found.listing, found.journal, found.record
    files = (*(path for top in disk.FOLDERS for path in listing.below(top)), *disk.FILES)
    return {
        "archive": str(folder),
        "store": str(root),
        "pipeline": record["pipeline"],
        "axes": record["axes"],
        "running": found.running,
        "began": record["began"],
        "runs": len(found.records),
        "bytes": sum((folder / path).lstat().st_size for path in files if (folder / path).exists()),
        "stages": _stages(folder, listing, journal, order_of(root, record)),
        "libraries": record["libraries"],
        "studies": [
            {"group": one.path, "cells": one.cells, "stale": one.stale or None}
            for one in stored_studies(folder, journal)
        ],
        "partial": left_by_compact(folder) or None,
        **progress(journal, str(record["began"]) if found.running else ""),
    }


def _stages(folder: Path, listing: disk.Listing, journal: Read, order: Iterable[str]) -> list[Document]:
    """Return every stage with its variables, the number of its cells by status, and the progress of the last run."""
    counts: dict[str, dict[str, int]] = {}
    for (stage, status), count in journal.said.counts(journal.outdated).items():
        counts.setdefault(stage, {})[status] = count
    ended, order = _ended(journal), list(order)
    by_stage = {name: _variables(folder, listing, name) for name in order}
    _add_left_out(by_stage, journal)
    return [
        {
            "name": name,
            "variables": by_stage[name],
            "cells": dict(sorted(counts.get(name, {}).items())),
            **_progress(journal, ended, [name]),
        }
        for name in order
    ]


def _add_left_out(by_stage: Mapping[str, list[Document]], journal: Read) -> None:
    """Add the variables without an array to their stages, with unit, type and own dims of the array that has their
    values (``same_as``).
    """
    known = {(v["group"], v["variable"]): v for own in by_stage.values() for v in own}
    for group, own in journal.same.items():
        for name, path in own.items():
            source, stage = path[1:].rpartition("/")[0], group.split("/")[0]
            one = known.get((source, name))
            if one is None or stage not in by_stage or group not in journal.axes or source not in journal.axes:
                continue
            axes = {dim: len(values) for dim, values in journal.axes[group].items()}
            inner = {dim: size for dim, size in one["dims"].items() if dim not in journal.axes[source]}
            by_stage[stage].append({**one, "group": group, "dims": axes | inner, "same_as": path})


def order_of(root: Path, record: Document) -> list[str]:
    """Return the names of the stages in pipeline order: of two stages that write the same variable, the later one
    counts.
    """
    attributes = (disk.read_document(root / "zarr.json") or {}).get("attributes", {})
    own = attributes.get("etendue") if isinstance(attributes, dict) else None
    for names in (record.get("order"), own.get("stages") if isinstance(own, dict) else None):
        if isinstance(names, list):
            return [str(name) for name in names]
    return list(record["nodes"])


def progress(journal: Read, began: str = "") -> Document:
    """Return the progress of the last run: number of cells requested and number of cells present. If the run has been
    active since ``began``, also return cells per second and remaining seconds.
    """
    return {**_progress(journal, _ended(journal)), **(_pace(journal, began) if began else {"rate": None, "left": None})}


def _ended(journal: Read) -> Mapping[str, int]:
    """Return the number of cells of each stage that have ended in the last run."""
    return Counter(cell.partition(" ")[0] for cell in journal.run.ended) if journal.run else Counter[str]()


def _progress(journal: Read, ended: Mapping[str, int], of: Iterable[str] | None = None) -> Document:
    """Return the number of cells requested by the last run, and the number of these that are present or have ended."""
    if journal.run is None:
        return {"planned": None, "finished": None}
    stages = list({**ended, **journal.run.planned} if of is None else of)
    planned, todo = (sum(counts.get(name, 0) for name in stages) for counts in (journal.run.planned, journal.run.todo))
    return {
        "planned": planned,
        "finished": max(planned - todo, 0) + min(sum(ended.get(name, 0) for name in stages), todo),
    }


def _pace(journal: Read, began: str) -> dict[str, float | None]:
    """Return cells per second since an active run began, and the remaining seconds; None if unknown.

    Remaining cells are weighted by the mean time of finished cells of their stage: early stages have few but
    expensive cells.
    """
    run, elapsed = journal.run, time.time() - _instant(began)
    if run is None or not run.ended or elapsed <= 0:
        return {"rate": None, "left": None}
    took: dict[str, list[float]] = {}
    for cell in run.ended:
        took.setdefault(cell.split(" ")[0], []).append(journal.said.took(cell))
    spent, known = sum(map(sum, took.values())), sum(map(len, took.values()))
    ahead = 0.0
    for stage, todo in run.todo.items():
        own = took.get(stage) or [spent / known]
        ahead += max(todo - len(took.get(stage, ())), 0) * sum(own) / len(own)
    return {"rate": len(run.ended) / elapsed, "left": elapsed * ahead / spent if spent > 0 else None}


def _instant(text: str) -> float:
    """Return the seconds since 1970 of a recorded time; infinity if it is invalid."""
    try:
        return float(calendar.timegm(time.strptime(text, "%Y-%m-%dT%H:%M:%SZ")))
    except ValueError:
        return math.inf


def _variables(folder: Path, listing: disk.Listing, stage: str) -> list[Document]:
    """Return the arrays of a stage, without coordinates."""
    found = []
    top = f"data.zarr/{stage}"
    for path in sorted(path for path in listing.below(top) if path.endswith("/zarr.json")):
        document = disk.read_document(folder / path)
        group, name = path.removeprefix("data.zarr/").removesuffix("/zarr.json").rpartition("/")[::2]
        if document is None:
            if not (folder / path).exists():
                continue  # a run has just replaced it
            raise damaged(folder, [path])
        if document.get("node_type") != "array" or name == "status":
            continue
        dims, shape, attributes = (
            document.get("dimension_names") or [],
            document.get("shape"),
            document.get("attributes", {}),
        )
        if not (
            isinstance(dims, list)
            and isinstance(shape, list)
            and isinstance(attributes, dict)
            and len(dims) == len(shape)
        ):
            raise damaged(folder, [path])
        if dims == [name] or "parameter" in attributes or name.endswith(("_um", "_at", "_bounds", ROW)):
            continue
        sizes = {str(dim): size for dim, size in zip(dims, shape, strict=True)}
        units, dtype = str(attributes.get("units", "")), str(document.get("data_type"))
        found.append({"group": group, "variable": name, "dims": sizes, "units": units, "dtype": dtype})
    return found
