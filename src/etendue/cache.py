"""Results that are costly to compute and never change, cached between runs in the user's cache folder.

In:  a kind, and a key that covers everything the result depends on.
Out: the cached bytes, or None. If the folder is deleted, the results are computed again; nothing is lost.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def folder() -> Path:
    """Return the folder in ``ETENDUE_CACHE``; if it is not set, ``etendue`` in the user's cache folder."""
    own = os.environ.get("ETENDUE_CACHE")
    if own:
        return Path(own)
    caches = os.environ.get("XDG_CACHE_HOME")
    return (Path(caches) if caches else Path("~/.cache").expanduser()) / "etendue"


def read(kind: str, key: str) -> bytes | None:
    try:
        return (folder() / kind / key).read_bytes()
    except (OSError, RuntimeError):
        return None


def write(kind: str, key: str, data: bytes) -> None:
    """Write an entry completely or not at all. If it cannot be written, the result is computed again next time."""
    try:
        path = folder() / kind / key
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(data)
        os.replace(file.name, path)
    except (OSError, RuntimeError):
        return


def keep_newest(kind: str, most: int) -> None:
    """Remove all entries of a kind except the newest."""
    try:
        entries = sorted((folder() / kind).iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        for path in entries[most:]:
            path.unlink(missing_ok=True)
    except (OSError, RuntimeError):
        return
