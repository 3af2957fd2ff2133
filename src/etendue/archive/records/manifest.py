"""The manifest: digests of everything in an archive except chunks of cells. It exists only while no run is unfinished.

A run removes it before its first change and writes it at the end, so any deviation from it was caused by another
program or a failing disk.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from etendue import plain_files
from etendue.archive.records import disk
from etendue.archive.records.indented import indented
from etendue.errors import ArchiveError

NAME = "manifest.json"
DATA = "data.zarr"
DIGITS = 64  # hex digits of the SHA-256 with which the name of an input begins


@dataclass(frozen=True)
class Manifest:
    """The SHA-256 of files, by path below the archive. ``metadata``: metadata, coordinates, status and tables of the
    store; ``files``: files beside the store.
    """

    metadata: Mapping[str, str]
    files: Mapping[str, str]
    journal: str = ""  # SHA-256 of the journal as the run left it; checked only by a full verification

    def changed(self, folder: Path, metadata: bool = True) -> list[str]:
        """Return the paths of files that are missing or differ from what was written; with ``metadata``, files of the
        store are checked too.
        """
        known = {**self.metadata, **self.files} if metadata else self.files
        return [path for path, digest in known.items() if digest_of(folder / path) != digest]

    def nodes(self) -> set[str]:
        """Return the groups and arrays of the store, by path below it."""
        end = "/zarr.json"
        return {
            path[len(DATA) + 1 : -len(end)]
            for path in self.metadata
            if path.startswith(f"{DATA}/") and path.endswith(end)
        } - {""}


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file; '' if it cannot be read."""
    try:
        return plain_files.sha256(path, links=False)
    except OSError:
        return ""


def read_manifest(folder: Path) -> Manifest | None:
    """Return the manifest of an archive; None if it does not exist or is damaged."""
    found = disk.read_document(folder / NAME) or {}
    metadata, files, journal = found.get("metadata"), found.get("files", {}), found.get("journal", "")
    if not isinstance(metadata, dict) or not isinstance(files, dict) or not isinstance(journal, str):
        return None
    if not all(isinstance(value, str) and _inside(path) for path, value in {**metadata, **files}.items()):
        return None
    if found.get("sum", "") not in ("", _sum(metadata, files, journal)):
        return None
    return Manifest(metadata, files, journal)


def _inside(path: str) -> bool:
    """Return True if an archive can have a file at this path; a manifest with any other path is rejected."""
    first, *rest = path.split("/")
    return (first in disk.FOLDERS and bool(rest) and not {"", ".", ".."} & set(rest)) if rest else first in disk.FILES


def _sum(metadata: Mapping[str, str], files: Mapping[str, str], journal: str) -> str:
    """Return the SHA-256 of the content of a manifest."""
    return hashlib.sha256(json.dumps([metadata, files, journal], sort_keys=True).encode()).hexdigest()


def write_manifest(folder: Path, metadata: Mapping[str, bytes], durable: bool = False) -> None:
    """Write the manifest; ``metadata``: content of the store's own files, by path below the archive."""
    runs = (f"runs/{p.name}" for p in sorted((folder / "runs").glob("*.*")))
    # descriptions of inputs too large to copy
    told = (f"inputs/{p.name}" for p in sorted((folder / "inputs").glob("*.json")) if len(p.stem) > DIGITS)
    beside = ["contact_sheet.png", "ro-crate-metadata.json", "CITATION.cff", *runs, *told]
    files = {
        path: digest_of(folder / path)
        for path in beside
        if (folder / path).is_file() and not path.endswith(disk.PARTIAL)
    }
    digests = {path: hashlib.sha256(data).hexdigest() for path, data in sorted(metadata.items())}
    put_manifest(folder, Manifest(digests, files, digest_of(folder / "journal.jsonl")), durable)


def put_manifest(folder: Path, found: Manifest, durable: bool = False) -> None:
    whole = {
        "metadata": dict(found.metadata),
        "files": dict(found.files),
        "journal": found.journal,
        "sum": _sum(found.metadata, found.files, found.journal),
    }
    disk.write(folder, NAME, indented(whole, 1), durable)


def damaged(folder: Path, paths: Sequence[str]) -> ArchiveError:
    """Return the error about files of an archive that are missing or changed."""
    more = f" and {len(paths) - 1} more {'file' if len(paths) == 2 else 'files'}" if len(paths) > 1 else ""
    return ArchiveError(
        f"{folder / paths[0]}{more} {'are missing or differ' if more else 'is missing or differs'} "
        f"from the written state: the archive is damaged. Repair it with: etendue verify {folder} --repair"
    )
