"""The manifest: digests of everything in an archive that is no chunk of a cell. There is one while no run is unfinished.

A run takes it away before it changes anything and writes it when it has ended, so that what differs from it was changed by
somebody else, or by a failing disk.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from etendue.archive import disk

NAME = "manifest.json"
DATA = "data.zarr"


@dataclass(frozen=True)
class Manifest:
    """SHA-256 by path below the archive: metadata, coordinates, status and tables of the store; other files beside it."""

    metadata: Mapping[str, str]
    files: Mapping[str, str]

    def changed(self, folder: Path) -> list[str]:
        """The paths whose files are missing or not as they were written."""
        return [path for path, known in {**self.metadata, **self.files}.items() if digest_of(folder / path) != known]

    def nodes(self) -> set[str]:
        """Groups and arrays of the store, by path below it."""
        end = "/zarr.json"
        return {path[len(DATA) + 1 : -len(end)] for path in self.metadata if path.startswith(f"{DATA}/") and path.endswith(end)} - {""}


def digest_of(path: Path) -> str:
    """SHA-256 of a file, '' where it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def read_manifest(folder: Path) -> Manifest | None:
    """The manifest of an archive; None where there is none, or it is damaged."""
    found = disk.read_document(folder / NAME) or {}
    metadata, files = found.get("metadata"), found.get("files", {})
    if not isinstance(metadata, dict) or not isinstance(files, dict):
        return None
    if not all(isinstance(value, str) and ".." not in path.split("/") for path, value in {**metadata, **files}.items()):
        return None
    return Manifest(metadata, files)


def write_manifest(folder: Path, metadata: Mapping[str, bytes], durable: bool = False) -> None:
    """``metadata``: the bytes of the store's own files, by path below the archive."""
    beside = ["contact_sheet.png", "ro-crate-metadata.json", *(f"runs/{p.name}" for p in sorted((folder / "runs").glob("*.*")))]
    files = {path: digest_of(folder / path) for path in beside if (folder / path).is_file() and not path.endswith(disk.PARTIAL)}
    digests = {path: hashlib.sha256(data).hexdigest() for path, data in sorted(metadata.items())}
    disk.write(folder, NAME, json.dumps({"metadata": digests, "files": files}, indent=1).encode(), durable)
