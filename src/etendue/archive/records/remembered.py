"""Cached results about a pipeline that are costly to find again (measured errors), beside the store of an archive.

In:  the folder of an archive, and the key of everything that a document depends on.
Out: the document; None if nothing is stored under that key or the file is damaged.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from etendue.archive.records import disk
from etendue.types.documents import Document, DocumentView

NAME = "measured.json"
SUM = "sum"
ANSWER = "answer"  # ``kind`` of documents with the errors of wanted variables
MOST = 256  # documents; the oldest is dropped first


def recall(folder: Path, key: str) -> Document | None:
    """Return the document stored under a key, or None."""
    found = documents(folder).get(key)
    return found if isinstance(found, dict) else None


def latest(folder: Path, kind: str) -> Document | None:
    """Return the stored document of a kind; None if there is none."""
    return next((one for one in documents(folder).values() if one.get("kind") == kind), None)


def documents(folder: Path) -> Document:
    """Return all stored documents; an empty dictionary if the file does not match its checksum."""
    found = disk.read_document(folder / NAME) or {}
    known = {name: one for name, one in found.items() if name != SUM and isinstance(one, dict)}
    return known if found.get(SUM, _sum(known)) == _sum(known) else {}


def whole(folder: Path) -> bool:
    """Return True if the file is absent or matches its checksum."""
    path = folder / NAME
    found = disk.read_document(path)
    return not (path.exists() or path.is_symlink()) or (found is not None and (not found or bool(documents(folder))))


def forget(folder: Path, kind: str) -> None:
    """Drop every document of a kind."""
    known = documents(folder)
    kept = {key: one for key, one in known.items() if one.get("kind") != kind}
    if len(kept) < len(known):
        _write(folder, kept)


def remember(folder: Path, key: str, document: DocumentView) -> None:
    """Store a document of plain values under its key. If documents name a ``kind``, only the last document of each kind
    is kept.
    """
    kind = document.get("kind")
    known = {k: v for k, v in documents(folder).items() if k != key and (kind is None or v.get("kind") != kind)}
    _write(folder, dict(list(known.items())[-(MOST - 1) :]) | {key: dict(document)})


def _write(folder: Path, kept: DocumentView) -> None:
    disk.write(folder, NAME, json.dumps({**kept, SUM: _sum(kept)}, indent=1).encode())


def _sum(known: DocumentView) -> str:
    """Return the SHA-256 of all documents, in the form in which they read back."""
    return hashlib.sha256(json.dumps(json.loads(json.dumps(known)), sort_keys=True).encode()).hexdigest()
