"""Write folders that appear completely or not at all.

In:  texts by path.
Out: files; no existing file is overwritten.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from etendue.errors import RequestError


def refuse_existing(place: Path) -> None:
    """Raise ``RequestError`` if the place already exists."""
    if place.exists() or place.is_symlink():
        raise RequestError(f"{place} already exists and is not overwritten; give another name, or -o FOLDER")


def write_folder(place: Path, files: Mapping[str, str]) -> list[Path]:
    """Write the files below a new folder and return their paths."""
    refuse_existing(place)
    place.parent.mkdir(parents=True, exist_ok=True)
    # The folder is written under another name and renamed at the end, so a folder with the final name is always
    # complete.
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
