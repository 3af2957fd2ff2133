"""Read from an archive alone the pipeline of its last run and the input files that the pipeline names.

In:  the folder of an archive.
Out: the record of its last run, its pipeline, and the digests that its inputs must have.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from etendue.archive.records import disk
from etendue.archive.records.inputs import digest_now
from etendue.archive.records.manifest import DATA, digest_of, read_manifest
from etendue.archive.records.past_runs import is_record, record_paths
from etendue.contract.values.bounds import MOST_CELLS, more_values
from etendue.errors import ArchiveError, RequestError
from etendue.pipeline.file import PipelineFile, parse_pipeline
from etendue.types.documents import DocumentView

_INPUT = re.compile(r'"\.\./inputs/([0-9a-f]{64}[^"/]*)"')


@dataclass(frozen=True)
class Recorded:
    """One run of an archive: its record and the pipeline it ran."""

    path: Path
    record: DocumentView

    @property
    def text(self) -> str:
        return str(self.record["resolved"])

    @property
    def inputs(self) -> list[str]:
        """The names below ``inputs/`` that its pipeline reads; each begins with the SHA-256 of its content."""
        return list(dict.fromkeys(_INPUT.findall(self.text)))

    def pipeline(self, most_cells: int | None = None) -> PipelineFile:
        """Return the resolved pipeline; ``most_cells`` is the limit set by the reader and overrides the limit in the
        pipeline.

        Raises
        ------
        ArchiveError
            One of the inputs of the pipeline is missing, or its content does not match the digest in its name.
        RequestError
            The text cannot be read.
        """
        folder = self.path.parent.parent
        faults = [fault for name in self.inputs if (fault := input_fault(folder, name))]
        if faults:
            raise ArchiveError("\n".join(faults))
        beyond = more_values(self.text, most_cells or MOST_CELLS)
        if beyond:
            raise RequestError([beyond], str(self.path.with_suffix(".toml")))
        found = parse_pipeline(self.text, str(self.path.with_suffix(".toml")), self.path.parent)
        return replace(found, most_cells=most_cells or MOST_CELLS)


def input_fault(folder: Path, name: str) -> str:
    """Return the fault of one input of an archive and the remedy; '' if it is intact."""
    copy, told = folder / "inputs" / name, disk.read_document(folder / "inputs" / f"{name}.json")
    if not copy.exists():
        if told is not None:
            size = f", {told.get('bytes')} bytes"
            return (
                f"{copy} is not in the archive: {told.get('name')}{size}, was described and not copied. Put it "
                f"there under this name"
            )
        return (
            f"{copy} is missing. Put the file whose SHA-256 is this name there, or run: "
            f"etendue verify {folder} --repair --from FOLDER"
        )
    try:
        found = digest_now(copy)
    except OSError as error:
        found = f"unknown, as it cannot be read ({error.strerror})"
    if found == name[:64]:
        return ""
    what = f"does not match its name: its SHA-256 is {found}"
    return f"{copy} {what}. Put the right file there, or run: etendue verify {folder} --repair --from FOLDER"


def recorded(folder: Path) -> Recorded:
    """Return the last recorded run of an archive.

    Raises
    ------
    ArchiveError
        The folder is not an archive, or the record of its last run is missing or damaged.
    """
    if not (folder / DATA).is_dir():
        raise ArchiveError(f"{folder} is not an archive of etendue ({disk.lacks(folder, DATA)})")
    disk.Listing(folder)  # raises for links: nothing is read through one
    paths = record_paths(folder)
    if not paths:
        what = "holds no record of a run, so its pipeline is unknown"
        raise ArchiveError(f"{folder} {what}. Run its pipeline file: etendue run FILE --archive {folder}")
    record, manifest = disk.read_document(paths[-1]), read_manifest(folder)
    newer = [
        path
        for path in (manifest.files if manifest else ())
        if path.endswith(".json") and path > f"runs/{paths[-1].name}"
    ]
    if any(path.startswith("runs/") for path in newer):
        raise ArchiveError(
            f"{folder / max(newer)} is missing: it is the record of the last run. "
            f"Repair it with: etendue verify {folder} --repair"
        )
    known = manifest.files.get(f"runs/{paths[-1].name}") if manifest else None
    if record is None or not is_record(record) or known not in (None, digest_of(paths[-1])):
        raise ArchiveError(
            f"{paths[-1]} is damaged: it is the record of the last run. "
            f"Repair it with: etendue verify {folder} --repair"
        )
    if not isinstance(record.get("resolved"), str):
        what = "holds no complete pipeline: it was written by an early version"
        raise ArchiveError(f"{paths[-1]} {what}. Run its file: etendue run FILE --archive {folder}")
    return Recorded(paths[-1], record)


def every_record(folder: Path, known: Container[str] | None = None) -> Iterator[Recorded]:
    """Yield all runs with readable records, the newest first; ``known`` limits them to these paths."""
    for path in reversed(record_paths(folder)):
        if known is not None and f"runs/{path.name}" not in known:
            continue
        record = disk.read_document(path)
        if record is not None and is_record(record) and isinstance(record.get("resolved"), str):
            yield Recorded(path, record)
