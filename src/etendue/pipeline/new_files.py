"""Folders that appear whole or not at all.

In:  texts by path.
Out: files; nothing that stands there is written over.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from etendue.errors import RequestError


def refuse_existing(place: Path) -> None:
    """Raises ``RequestError`` where something stands in the way."""
    if place.exists() or place.is_symlink():
        raise RequestError(f"{place} is there already; nothing is written over. Give another name, or -o FOLDER")


def write_folder(place: Path, files: Mapping[str, str]) -> list[Path]:
    """The files below a new folder."""
    refuse_existing(place)
    place.parent.mkdir(parents=True, exist_ok=True)
    beside = Path(tempfile.mkdtemp(prefix=f".{place.name}.", dir=place.parent))
    try:
        for path, text in files.items():
            own = beside / path
            own.parent.mkdir(parents=True, exist_ok=True)
            own.write_text(text, encoding="utf-8")
        os.chmod(beside, 0o755)
        os.rename(beside, place)
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise
    return [place / path for path in files]
