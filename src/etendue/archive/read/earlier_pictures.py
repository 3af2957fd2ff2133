"""The pictures of an earlier run: a table that not every run rewrites and that therefore contains its own digest.

In:  the files of the group ``frames``.
Out: whether they are intact, and the keys of the cells they show.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from etendue.archive.read.tree import Tree
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA, Manifest
from etendue.archive.records.names import ROOT
from etendue.types.documents import Document, DocumentView

FRAMES = "frames"


def stored(folder: Path, listing: disk.Listing) -> dict[str, bytes]:
    """Return the picture files of an earlier run, as bytes by path; empty if they are damaged."""
    paths = listing.below(f"{DATA}/{FRAMES}")
    files = {path.removeprefix(f"{DATA}/"): disk.content_of(folder / path) or b"" for path in paths}
    return files if whole(files) else {}


def sheet_is_whole(folder: Path, manifest: Manifest | None) -> bool:
    """Return True if the contact sheet of an earlier run is intact."""
    known = manifest.files.get("contact_sheet.png") if manifest else None
    data = disk.content_of(folder / "contact_sheet.png") or b""
    if known is not None:
        return hashlib.sha256(data).hexdigest() == known
    return data.startswith(b"\x89PNG") and data.endswith(b"IEND\xaeB`\x82")


def whole(files: Mapping[str, bytes]) -> bool:
    """Return True if the pictures are complete and unchanged."""
    attrs, own = attributes(files), Tree()
    own.put_group(FRAMES, attrs)
    return own.held.items() <= files.items() and attrs.get("digest") == digest(files)


def sealed(files: Mapping[str, bytes], attrs: DocumentView) -> dict[str, bytes]:
    """Return the metadata of the group of these pictures, with their digest among its attributes."""
    own = Tree()
    own.put_group(FRAMES, attrs)
    own.put_group(FRAMES, {**attrs, "digest": digest({**files, **own.held})})
    return own.held


def attributes(files: Mapping[str, bytes]) -> Document:
    """Return the attributes of the group of pictures; empty if they cannot be read."""
    try:
        found = json.loads(files.get(f"{FRAMES}/{ROOT}", b"{}"))["attributes"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def digest(files: Mapping[str, bytes]) -> str:
    """Return the digest of all pictures and their attributes; it is stored among these attributes."""
    said = {name: value for name, value in attributes(files).items() if name != "digest"}
    found = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    for path in sorted(files):
        if path != f"{FRAMES}/{ROOT}":
            found.update(f"{path} {hashlib.sha256(files[path]).hexdigest()}\n".encode())
    return found.hexdigest()
