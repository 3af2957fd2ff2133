"""What is in an archive, without opening its arrays: from the journal, the run records and the metadata."""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path
from typing import Any

from etendue.archive.journal import read_journal
from etendue.archive.provenance import latest_record
from etendue.errors import ArchiveError


def _running(folder: Path) -> bool:
    try:
        handle = os.open(folder / "lock", os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        return False
    except BlockingIOError:
        return True
    finally:
        os.close(handle)


def describe_archive(folder: Path) -> dict[str, Any]:
    """Stages with their variables and cells, axes, size, and whether a run is going on.

    Raises
    ------
    ArchiveError
        The folder is not an archive.
    """
    root = folder / "data.zarr"
    record = latest_record(folder)
    if not (root / "zarr.json").exists() or record is None:
        raise ArchiveError(f"{folder} is not an archive of etendue (no data.zarr with a run record in it)")
    attributes = json.loads((root / "zarr.json").read_text()).get("attributes", {})
    counts: dict[str, dict[str, int]] = {}
    for cell, entry in read_journal(folder / "journal.jsonl").items():
        own = counts.setdefault(cell.split(" ")[0], {})
        status = "unfinished" if entry.event == "start" else entry.status
        own[status] = own.get(status, 0) + 1
    stages = []
    for name in attributes.get("etendue", {}).get("stages", []):
        groups = []
        for path in sorted(p.parent for p in (root / name).rglob("zarr.json")) if (root / name).exists() else []:
            document = json.loads((path / "zarr.json").read_text())
            if document.get("node_type") == "array" and path.name != "status":
                dims = document.get("dimension_names") or []
                if dims == [path.name] or path.name.endswith("_um") or path.name == "wavelength_bounds":
                    continue
                group = str(path.parent.relative_to(root))
                sizes = dict(zip(dims, document["shape"], strict=True))
                units = document.get("attributes", {}).get("units", "")
                groups.append({"group": group, "variable": path.name, "dims": sizes, "units": units, "dtype": document["data_type"]})
        stages.append({"name": name, "variables": groups, "cells": dict(sorted(counts.get(name, {}).items()))})
    size = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
    return {
        "archive": str(folder), "store": str(root), "pipeline": record["pipeline"], "axes": record["axes"], "running": _running(folder),
        "began": record["began"], "runs": len(list((folder / "runs").glob("*.json"))), "bytes": size, "stages": stages,
        "libraries": record["libraries"],
    }  # fmt: skip
