"""What is dear to find out and the same for ever, kept between runs in the user's folder for caches.

In:  a kind, a key that holds everything it depends on.
Out: the bytes that were kept; None where there are none. Whoever deletes the folder loses time and nothing else.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path


def folder() -> Path:
    """``ETENDUE_CACHE``, else ``etendue`` in the user's folder for caches."""
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
    """Whole or not at all; where nothing can be written, it is found out again next time."""
    try:
        path = folder() / kind / key
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(data)
        os.replace(file.name, path)
    except (OSError, RuntimeError):
        return
