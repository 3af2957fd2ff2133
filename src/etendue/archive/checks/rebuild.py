"""Restore the parts of a damaged archive that have a second copy (records, inputs found elsewhere, axis values), and
mark the rest to be recomputed.

In:  the folder of an archive, the damage found in it, and places where its inputs may be found.
Out: an archive that a run of its own pipeline can complete; a list of texts that describe each step.

Files that do not belong to an archive are moved into ``strays``, never deleted.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.archive.checks.verify import STRAYS
from etendue.archive.read.inspection import Verified
from etendue.archive.read.stored import Stored
from etendue.archive.records import disk, past_runs, remembered
from etendue.archive.records.inputs import digest_now
from etendue.archive.records.manifest import DATA, DIGITS, Manifest, digest_of
from etendue.archive.sharding.chunks import RAW
from etendue.archive.sharding.partition import pieces_of
from etendue.archive.write.store import ArchiveWriter
from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    from etendue.types.documents import AxisValue

RECORD = ".json"


def prepare(found: Verified, sources: Iterable[Path]) -> list[str]:
    """Restore everything that needs no computing, mark lost cells in the journal, and return a description of each
    step.

    Raises
    ------
    ArchiveInUse
        A run is writing to the archive.
    """
    folder, done = found.folder, list[str]()
    for damage in found.damages:
        if damage.kind in ("odd", "added") and os.path.lexists(folder / damage.path):
            done.append(f"{damage.path} was moved to {disk.set_aside(folder, damage.path, STRAYS)}")
    if not remembered.whole(folder):
        done.append(
            f"{remembered.NAME} was moved to {disk.set_aside(folder, remembered.NAME, STRAYS)}: run --measure again"
        )
    done += _inputs(folder, [d.path for d in found.damages if d.path.startswith("inputs/")], sources)
    with ArchiveWriter(folder) as store:
        store.journal.open()
        if os.fstat(store.lock).st_size:
            os.ftruncate(store.lock, 0)
        kept = dict(store.journal.records)
        done += _records(folder, kept, [d.path for d in found.damages if d.path.startswith("runs/")])
        stored = Stored(folder)
        there = stored.axes()
        axes = {group: own for group, own in there.items() if own != store.journal.axes.get(group)}
        blocks = _blocks(folder, there, stored)
        store.journal.set_axes(axes)
        store.journal.set_blocks(blocks)
        done += [f"the axis values of {group} were taken from its coordinates" for group in axes]
        done += [f"the blocks of the variables of {group} were taken from their metadata" for group in blocks]
        for path, text in _unkept(folder, kept, store.manifest):
            store.journal.record(path, text)
        lost = [name for name in found.lost if name in store.journal.entries]
        store.journal.start((name, store.journal.entries[name].key) for name in lost)
    return done


def _inputs(folder: Path, damaged: Iterable[str], sources: Iterable[Path]) -> Iterator[str]:
    """Copy inputs that are found elsewhere, matched by digest; yield a description of each step."""
    wanted = {Path(path).name[:DIGITS]: path for path in damaged}
    for file in _files(sources) if wanted else ():
        path = wanted.pop(digest_now(file), None)
        if path is None:
            continue
        for part in sorted(p.relative_to(file) for p in file.rglob("*") if p.is_file()) if file.is_dir() else [None]:
            data = (file / part if part else file).read_bytes()
            disk.write(folder, f"{path}/{part.as_posix()}" if part else path, data)
        yield f"{path} was copied from {file.name}"


def _files(sources: Iterable[Path]) -> Iterator[Path]:
    for source in sources:
        yield source
        if source.is_dir():
            yield from (path for path in sorted(source.rglob("*")) if path.is_file())


def _records(folder: Path, kept: Mapping[str, str], damaged: Iterable[str]) -> Iterator[str]:
    """Rewrite records of runs and their pipelines from the journal; yield a description of each step."""
    for path in damaged:
        text = kept.get(f"{path.rpartition('.')[0]}{RECORD}")
        if text is None:
            continue
        data = text if path.endswith(RECORD) else str(json.loads(text)["resolved"])
        disk.write(folder, path, data.encode())
        yield f"{path} was rewritten from the journal"


def _unkept(folder: Path, kept: Mapping[str, str], manifest: Manifest | None) -> Iterator[tuple[str, str]]:
    """Yield intact run records that have no copy in the journal."""
    for file in past_runs.record_paths(folder):
        path = f"runs/{file.name}"
        if path not in kept and manifest and manifest.files.get(path) == digest_of(file):
            yield path, file.read_text()


def _blocks(
    folder: Path, axes: Mapping[str, Mapping[str, list[AxisValue]]], stored: Stored
) -> dict[str, dict[str, Document]]:
    """Return how variables are split into shards according to intact metadata, for groups in which the journal says
    otherwise or nothing.
    """
    found: dict[str, dict[str, Document]] = {}
    for node in sorted(stored.nodes):
        group, _, name = node.rpartition("/")
        path = f"{DATA}/{node}/zarr.json"
        if (
            group not in axes
            or name in (*axes[group], "status")
            or not stored.manifest
            or stored.manifest.metadata[path] != digest_of(folder / path)
        ):
            continue
        document = disk.read_document(folder / path) or {}
        if document.get("chunk_key_encoding", {}).get("configuration", {}).get("separator") != ".":
            continue  # not a variable of cells
        found.setdefault(group, {})[name] = _block(document, len(axes[group]))
    known = stored.journal.blocks
    # the journal may also name an array that is lost on disk
    whole = {group: {**known.get(group, {}), **own} for group, own in found.items()}
    return {group: own for group, own in whole.items() if known.get(group) != own}


def _block(document: DocumentView, axes: int) -> Document:
    """Return the journal entry that says how a variable is split into shards, from its metadata."""
    outer, shape = document["chunk_grid"]["configuration"]["chunk_shape"], document["shape"][axes:]
    shard = next((one["configuration"] for one in document["codecs"] if one["name"] == "sharding_indexed"), None)
    inner = shard["chunk_shape"][axes:] if shard else outer[axes:]
    codecs = {one["name"]: one.get("configuration", {}) for one in (shard["codecs"] if shard else document["codecs"])}
    count = pieces_of(shape, inner)
    return {
        "block": list(outer[:axes]),
        "codec": codecs["blosc"]["cname"] if "blosc" in codecs else RAW,
        "form": f"{document['data_type']} {'x'.join(map(str, shape))}",
        "pieces": count,
        **({"chunk": list(inner)} if count > 1 else {}),
    }
