"""Keys: equal keys mean equal results. A key digests the recipe of a result, not its values.

In:  a stage's class, its resolved parameters, the keys of what it reads.
Out: 128-bit BLAKE2b digests, and the fields from which they were computed, so that a change can be named.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
from functools import cache
from pathlib import Path

from etendue import plain_files
from etendue.contract.stage import Stage, file_state, files_of, parameters_of
from etendue.contract.values.late_bound import LateValue
from etendue.plugins.discovery import named
from etendue.types.documents import Document


def digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()


def canonical(value: object) -> object:
    """Return a value as JSON whose text is the same for equal values; floats are in hex."""
    if isinstance(value, float):
        return value.hex()
    if isinstance(value, LateValue):  # the key of the cell that finds it is among the inputs
        return "found"
    if isinstance(value, dict):
        return {str(k): canonical(v) for k, v in sorted(value.items())}
    if isinstance(value, list | tuple):
        return [canonical(v) for v in value]
    return value


def plain_text(value: object) -> str:
    """Return a grid as text that is the same for equal grids, whether a number in it came as an int, a float or a numpy
    scalar.
    """
    if dataclasses.is_dataclass(value):
        return (
            f"{type(value).__name__}("
            f"{' '.join(plain_text(getattr(value, field.name)) for field in dataclasses.fields(value))})"
        )
    if isinstance(value, tuple | list):
        return f"({' '.join(map(plain_text, value))})"
    return float(value).hex() if hasattr(value, "__float__") else repr(value)


def key_of(fields: Document) -> str:
    return digest(json.dumps(canonical(fields), sort_keys=True).encode())


@cache
def version_of(distribution: str) -> str:
    try:
        return named(importlib.metadata.distribution(distribution))[1]
    except importlib.metadata.PackageNotFoundError:
        return "missing"


def file_digest(path: str) -> str:
    """Return the SHA-256 of a file, or of the names and contents of a folder's files: files count by content."""
    return _file_digest(path, file_state(path))


@cache
def _file_digest(path: str, state: tuple[int, int]) -> str:
    whole = Path(path)
    if not whole.is_dir():
        return plain_files.sha256(whole, None)
    found = hashlib.sha256()
    for part in sorted(p for p in whole.rglob("*") if p.is_file()):
        found.update(f"{part.relative_to(whole).as_posix()} {plain_files.sha256(part, None)}\n".encode())
    return found.hexdigest()


def parameters_for_key(stage: Stage) -> Document:
    """Return the resolved parameters, with files replaced by the digest of their content."""
    files = files_of(stage)
    return {
        n: f"sha256:{file_digest(files[n])}" if n in files else getattr(stage, n) for n in parameters_of(type(stage))
    }
