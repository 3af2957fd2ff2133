"""Check the remaining contents of an archive, apart from cells and their metadata: lines of the journal, names in the
manifest, duplicate keys in documents.

In:  an archive, its plan computed again, every file of the store that a run writes (``trust.remade``).
Out: ``Difference``: file, place in it, its value, and the expected value.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from etendue.archive.read import earlier_pictures
from etendue.archive.read.stored import LEDGER, Stored
from etendue.archive.records import crate, disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.past_runs import record_paths
from etendue.trust.remade import Again
from etendue.types.documents import Document

JOURNAL, MANIFEST = "journal.jsonl", "manifest.json"


@dataclass(frozen=True)
class Deviation:
    """A content of an archive that was not reproduced.

    Attributes
    ----------
    where : place in the file, such as ``attributes.units``
    says, is_ : the archived and the recomputed value; '' for a value that is missing
    """

    file: str
    where: str
    says: str
    is_: str


def of_the_rest(stored: Stored, again: Again, own: Mapping[str, bytes]) -> Iterator[Deviation]:
    """Yield all differences; ``own``: every file of the store that a run writes, by path below it."""
    yield from _of_lines(stored, again, own)
    yield from _of_names(stored, own)
    yield from _of_runs(stored)
    for file in _documents(stored):
        if (word := named_twice(disk.content_of(stored.folder / file))) is not None:
            yield Deviation(file, word, "it occurs twice", "once")


def _of_lines(stored: Stored, again: Again, own: Mapping[str, bytes]) -> Iterator[Deviation]:
    """Check the groups and arrays that the journal names, and the counts of its last run."""
    journal, nodes = stored.journal, {node.name: node for node in again.plan.nodes}
    arrays: dict[str, set[str]] = {}
    for path in own:
        group, _, name = path.removesuffix("/zarr.json").rpartition("/")
        arrays.setdefault(group, set()).add(name)
    for group in dict.fromkeys((*journal.axes, *journal.blocks, *journal.arrays)):
        node = nodes.get(group.split("/")[0])
        if node is None:
            yield Deviation(JOURNAL, f"group {group}", "it is there", "")
            continue
        if group in arrays:  # otherwise the group has a shape that no current cell has
            named = {*journal.arrays.get(group, ()), *journal.blocks.get(group, ())}
            for name in sorted(named - arrays[group] - node.writes.keys() - node.optional.keys()):
                yield Deviation(JOURNAL, f"array {group}/{name}", "it is there", "")
    for what in ("planned", "todo") if journal.run is not None and stored.manifest is not None else ():
        for stage, count in getattr(journal.run, what).items():
            most = len(again.plan.of(stage)) if stage in nodes else 0
            if not 0 <= count <= most:
                yield Deviation(JOURNAL, f"run {what} {stage}", str(count), f"at most {most}")


def _of_names(stored: Stored, own: Mapping[str, bytes]) -> Iterator[Deviation]:
    """Check that the manifest names only files of the store that a run writes."""
    for path in sorted(stored.manifest.metadata if stored.manifest is not None else ()):
        inner = path.removeprefix(f"{DATA}/")
        apart = inner.startswith(f"{LEDGER}/") and inner.count("/") > 1  # its columns are compared separately
        if inner not in own and not apart and inner.split("/")[0] != earlier_pictures.FRAMES:
            yield Deviation(MANIFEST, path, "it is there", "")


def _of_runs(stored: Stored) -> Iterator[Deviation]:
    """Check that runs are numbered from 1 without gaps; a run killed at once may leave only its pipeline."""
    there = {path.stem for path in (stored.folder / "runs").glob("*.*")}
    for number in range(1, len(there) + 1):
        if f"{number:04}" not in there and record_paths(stored.folder)[-1].stem > f"{number:04}":
            yield Deviation(f"runs/{number:04}.json", "", "", "it is there: runs are numbered from 1")


def _documents(stored: Stored) -> Iterator[str]:
    """Yield the paths of all JSON documents except the journal."""
    yield from (f"runs/{path.name}" for path in record_paths(stored.folder))
    yield from (MANIFEST, crate.NAME)
    yield from (
        path
        for path in (stored.manifest.metadata if stored.manifest is not None else ())
        if path.endswith("/zarr.json")
    )


def named_twice(data: bytes | None) -> str | None:
    """Return a key that occurs twice in one object of a document, so that programs may read different values; None if
    there is none.
    """
    found: list[str] = []

    def looked_at(pairs: list[tuple[str, object]]) -> Document:
        whole = dict(pairs)
        if len(whole) < len(pairs):
            names = [name for name, _ in pairs]
            found.append(next(name for name in names if names.count(name) > 1))
        return whole

    try:
        json.loads(data or b"null", object_pairs_hook=looked_at)
    except (ValueError, RecursionError):  # not valid JSON, which is reported elsewhere
        return None
    return found[0] if found else None
