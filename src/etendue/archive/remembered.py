"""What was found out about a camera and is costly to find again: measured errors, beside the store of an archive.

In:  the folder of an archive, the key of everything that a document depends on.
Out: the document; None where nothing is remembered under that key, or the file is damaged.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from etendue.archive import disk

NAME = "measured.json"
MOST = 256  # documents; the oldest is forgotten first


def recall(folder: Path, key: str) -> dict[str, Any] | None:
    """The document of a key."""
    found = (disk.read_document(folder / NAME) or {}).get(key)
    return found if isinstance(found, dict) else None


def remember(folder: Path, key: str, document: Mapping[str, Any], durable: bool = False) -> None:
    """Keep a document of plain values under its key."""
    known = {k: v for k, v in (disk.read_document(folder / NAME) or {}).items() if k != key and isinstance(v, dict)}
    kept = dict(list(known.items())[-(MOST - 1) :]) | {key: dict(document)}
    disk.write(folder, NAME, json.dumps(kept, indent=1).encode(), durable)
