"""The records of the runs of an archive, as stored.

In:  the folder of an archive.
Out: records, the newest first; damaged records are ignored.
"""

from __future__ import annotations

from pathlib import Path

from etendue.archive.records import disk
from etendue.archive.records.manifest import Manifest, digest_of
from etendue.types.documents import Document, DocumentView


def latest_record(folder: Path, manifest: Manifest | None = None) -> Document | None:
    """Return the newest run record of an archive that is readable and intact."""
    for path in reversed(record_paths(folder)):
        record = disk.read_document(path)
        known = manifest.files.get(f"runs/{path.name}") if manifest else None
        if record is not None and is_record(record) and known in (None, digest_of(path)):
            return record
    return None


def records(folder: Path) -> list[Document]:
    """Return all readable run records, the newest first."""
    found = [disk.read_document(path) for path in reversed(record_paths(folder))]
    return [record for record in found if record is not None and is_record(record)]


def record_paths(folder: Path) -> list[Path]:
    """Return the paths of all run records, the newest last."""
    return sorted(p for p in (folder / "runs").glob("*.json") if p.stem.isdigit()) if (folder / "runs").is_dir() else []


_WORDS = {
    "pipeline": str,
    "began": str,
    "shared": dict,
    "axes": dict,
    "nodes": dict,
    "platform": dict,
    "libraries": dict,
}


def is_record(record: DocumentView) -> bool:
    """Return True if a document has the form of a record."""
    if not all(isinstance(record.get(name), kind) for name, kind in _WORDS.items()):
        return False
    nodes = record["nodes"].values()
    whole = all(
        isinstance(node, dict) and all(isinstance(node.get(name), dict) for name in ("parameters", "shown"))
        for node in nodes
    )
    return whole and all(isinstance(values, list) for values in record["axes"].values())


def in_words(record: DocumentView) -> str:
    """Return the platform of a record in words: ``numpy 2.4.1, scipy 1.17.0, x86_64, Python 3.11``."""
    own = record["platform"]
    libraries = [f"{name} {own.get(name)}" for name in ("numpy", "scipy")]
    return ", ".join([*libraries, str(own.get("machine")), f"Python {own.get('python')}"])
