"""What an archive says beside its cells and their metadata: lines of the journal, names in the manifest, documents with
a word twice.

In:  an archive, its plan computed again, every file of the store that a run writes (``trust.remade``).
Out: ``Difference``: file, place in it, what it says, what it has to say.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from etendue.archive import crate, disk, frames
from etendue.archive.manifest import DATA
from etendue.archive.provenance import record_paths
from etendue.archive.stored import LEDGER, Stored
from etendue.trust.remade import Again
from etendue.types.documents import Document

JOURNAL, MANIFEST = "journal.jsonl", "manifest.json"


@dataclass(frozen=True)
class Difference:
    """Something that an archive says, and that does not come out again.

    Attributes
    ----------
    where : in the file, such as ``attributes.units``
    says, is_ : what it says, and what comes out; '' where one is missing
    """

    file: str
    where: str
    says: str
    is_: str


def of_the_rest(stored: Stored, again: Again, own: Mapping[str, bytes]) -> Iterator[Difference]:
    """``own``: every file of the store that a run writes, by path below it."""
    yield from _of_lines(stored, again, own)
    yield from _of_names(stored, own)
    yield from _of_runs(stored)
    for file in _documents(stored):
        if (word := named_twice(disk.content_of(stored.folder / file))) is not None:
            yield Difference(file, word, "it stands there twice", "once")


def _of_lines(stored: Stored, again: Again, own: Mapping[str, bytes]) -> Iterator[Difference]:
    """Groups and arrays that the journal names, and how much it says that its last run had to do."""
    journal, nodes = stored.journal, {node.name: node for node in again.plan.nodes}
    arrays: dict[str, set[str]] = {}
    for path in own:
        group, _, name = path.removesuffix("/zarr.json").rpartition("/")
        arrays.setdefault(group, set()).add(name)
    for group in dict.fromkeys((*journal.axes, *journal.blocks, *journal.arrays)):
        node = nodes.get(group.split("/")[0])
        if node is None:
            yield Difference(JOURNAL, f"group {group}", "it is there", "")
            continue
        if group in arrays:  # else one of a shape that no run asks for any more
            named = {*journal.arrays.get(group, ()), *journal.blocks.get(group, ())}
            for name in sorted(named - arrays[group] - node.writes.keys() - node.optional.keys()):
                yield Difference(JOURNAL, f"array {group}/{name}", "it is there", "")
    for what in ("planned", "todo") if journal.run is not None and stored.manifest is not None else ():
        for stage, count in getattr(journal.run, what).items():
            most = len(again.plan.of(stage)) if stage in nodes else 0
            if not 0 <= count <= most:
                yield Difference(JOURNAL, f"run {what} {stage}", str(count), f"at most {most}")


def _of_names(stored: Stored, own: Mapping[str, bytes]) -> Iterator[Difference]:
    """Files of the store for which the manifest vouches as of those that a run writes."""
    for path in sorted(stored.manifest.metadata if stored.manifest is not None else ()):
        inner = path.removeprefix(f"{DATA}/")
        apart = inner.startswith(f"{LEDGER}/") and inner.count("/") > 1  # its columns are compared one by one
        if inner not in own and not apart and inner.split("/")[0] != frames.FRAMES:
            yield Difference(MANIFEST, path, "it is there", "")


def _of_runs(stored: Stored) -> Iterator[Difference]:
    """Runs have the numbers from 1 on; one that was killed at once may have left its pipeline alone."""
    there = {path.stem for path in (stored.folder / "runs").glob("*.*")}
    for number in range(1, len(there) + 1):
        if f"{number:04}" not in there and record_paths(stored.folder)[-1].stem > f"{number:04}":
            yield Difference(f"runs/{number:04}.json", "", "", "it is there: runs have the numbers from 1 on")


def _documents(stored: Stored) -> Iterator[str]:
    """Every document in JSON, but the lines of the journal."""
    yield from (f"runs/{path.name}" for path in record_paths(stored.folder))
    yield from (MANIFEST, crate.NAME)
    yield from (
        path
        for path in (stored.manifest.metadata if stored.manifest is not None else ())
        if path.endswith("/zarr.json")
    )


def named_twice(data: bytes | None) -> str | None:
    """A word that stands twice in one object of a document, of which readers take one or the other; None where there
    is none.
    """
    found: list[str] = []

    def looked_at(pairs: list[tuple[str, Any]]) -> Document:
        whole = dict(pairs)
        if len(whole) < len(pairs):
            names = [name for name, _ in pairs]
            found.append(next(name for name in names if names.count(name) > 1))
        return whole

    try:
        json.loads(data or b"null", object_pairs_hook=looked_at)
    except (ValueError, RecursionError):  # it is no document, which is said elsewhere
        return None
    return found[0] if found else None
