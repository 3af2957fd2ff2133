"""Write the results of studies: check the folder before anything is computed, and write each file completely or not at
all.

In:  a folder; files by name, as bytes; documents with numbers that JSON cannot hold.
Out: complete files; the same documents in a form that JSON can hold.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from etendue.errors import Fault, MachineError, RequestError


def check_folder(path: Path) -> None:
    """Make a folder if needed and check that files can be written to it. Call this before a run, not after it.

    Raises
    ------
    RequestError
        If the path is a file, or the folder cannot be created or written to.
    """
    try:
        if path.exists() and not path.is_dir():
            raise RequestError([Fault(str(path), "is a file; expected a folder, or the name of a new folder")])
        path.mkdir(parents=True, exist_ok=True)
        import tempfile  # not for --help

        with tempfile.TemporaryFile(dir=path):
            pass
    except OSError as error:
        raise RequestError([Fault(str(path), f"cannot write to this folder: {error.strerror or error}")]) from error


def write_whole(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write files into a folder and replace existing files of the same names. All files are on disk before the first is
    renamed to its final name.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    files : mapping of name to bytes

    Returns
    -------
    list of Path
        In the order of ``files``.

    Raises
    ------
    MachineError
        If the disk is full or the folder cannot be written to. No temporary file is left behind.
    """
    partial = {folder / name: folder / f".{name}.{os.getpid()}.partial" for name in files}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for temporary, data in zip(partial.values(), files.values(), strict=True):
            temporary.write_bytes(data)
        for path, temporary in partial.items():
            os.replace(temporary, path)
    except OSError as error:
        raise MachineError(f"{folder}: the results cannot be written: {error.strerror or error}") from error
    finally:
        for temporary in partial.values():
            with suppress(OSError):  # it was never made, or has been renamed
                temporary.unlink()
    return list(partial)


def finite(value: Any) -> Any:
    """Return a document in a form that JSON can hold: NaN becomes None, infinities become "inf" and "-inf"."""
    if isinstance(value, Mapping):
        return {str(key): finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [finite(one) for one in value]
    if not isinstance(value, float) and hasattr(value, "item"):  # a numpy scalar
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0 else "-inf"
    return value
