"""More consistent forgeries: in journal lines, names in the manifest, and other documents.

In:  an archive (a copy).
Out: it is changed in place; ``verify`` finds nothing.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from forgery_kinds import Forge, chunk_edited, lines, record, sealed, several, values

from etendue.archive.journaling.journal import summed


def lines_more(*events: dict[str, Any]) -> Forge:
    """Append lines to the journal."""

    def act(archive: Path) -> None:
        with (archive / "journal.jsonl").open("ab") as file:
            file.write(b"".join(summed(json.dumps(one, separators=(",", ":")).encode()) + b"\n" for one in events))
        sealed(archive)

    return act


def ours(path: str, data: bytes) -> Forge:
    """Add a file that no run writes, with its digest in the manifest."""

    def act(archive: Path) -> None:
        place = archive / path
        place.parent.mkdir(exist_ok=True)
        place.write_bytes(data)
        manifest = json.loads((archive / "manifest.json").read_text())
        manifest["metadata"][path] = ""
        (archive / "manifest.json").write_text(json.dumps(manifest))
        sealed(archive)

    return act


def word_twice(path: str, word: str, other: str) -> Forge:
    """Duplicate a key of a document, first with another value: readers may take either."""

    def act(archive: Path) -> None:
        place = archive / path
        place.write_text(place.read_text().replace(f'"{word}":', f'"{word}": {other}, "{word}":', 1))
        sealed(archive)

    return act


def no_crate(archive: Path) -> None:
    (archive / "ro-crate-metadata.json").unlink()
    manifest = json.loads((archive / "manifest.json").read_text())
    del manifest["files"]["ro-crate-metadata.json"]
    (archive / "manifest.json").write_text(json.dumps(manifest))
    sealed(archive)


def first_run_gone(archive: Path) -> None:
    """Remove the first of two runs with the same request."""
    for name in ("0001.json", "0001.toml"):
        (archive / "runs" / name).rename(archive / "runs" / name.replace("1", "2"))
    for path in ("manifest.json", "ro-crate-metadata.json", "journal.jsonl"):
        place = archive / path
        place.write_text(
            place.read_text()
            .replace("runs/0001", "runs/0002")
            .replace("run-0001", "run-0002")
            .replace("run 0001", "run 0002")
        )
    lines("record", lambda one: one.pop("sum", None))(archive)


UNKNOWN = {
    "cell": "adc f_number=99",
    "key": "0" * 32,
    "seconds": 1.0,
    "clipped": 0.0,
    "clipped_flux": 0.0,
    "floored": 0.0,
    "files": [],
}

WORDS: dict[str, Forge] = {
    "a number in an outdated cell": several(
        chunk_edited, lines_more({"event": "outdated", "cells": ["adc f_number=2.0", "adc f_number=4.0"]})
    ),
    "cells marked as outdated": lines_more({"event": "outdated", "cells": ["adc f_number=2.0"]}),
    "the work of the last run": lines_more({"event": "run", "planned": {"adc": 9}, "todo": {"adc": 9}}),
    "an array in the journal": lines_more({"event": "arrays", "group": "adc", "names": ["trusted"]}),
    "a group in the journal": lines_more({"event": "axes", "group": "calibration", "axes": {"f_number": [2.0]}}),
    # files named as ours
    "attributes of Zarr 2": ours("data.zarr/adc/raw/.zattrs", b'{"units": "ke"}'),
    "a file in a group": ours("data.zarr/adc/NOTE.txt", b"calibrated"),
    "an extra group": ours(
        "data.zarr/calibration/zarr.json", b'{"zarr_format": 3, "node_type": "group", "attributes": {}}'
    ),
    # documents
    "a duplicate unit": word_twice("data.zarr/adc/x_um/zarr.json", "units", '"mm"'),
    "a duplicate seed": word_twice("runs/0001.json", "seed", "9"),
    "an extra option": record(lambda found: found["options"].update(certified="yes")),
    "a missing description": no_crate,
    "a missing run": first_run_gone,
}

SAID_WORDS: dict[str, tuple[Forge, str]] = {
    "a cell not in its pipeline": (
        lines_more({"event": "failed", "status": "failed", **UNKNOWN}),
        "1 journal lines of cells",
    ),
    "seconds in the summary": (values("summary/seconds", lambda found: found * 0), "seconds"),
}
