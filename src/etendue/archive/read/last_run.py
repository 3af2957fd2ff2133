"""The state in which the last run left an archive, and what has changed since.

In:  an archive opened for a run, with a plan laid out over it.
Out: whether the archive is intact and matches the plan; the files that differ from the manifest.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from etendue.archive.read.tree import ROOT
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.contract.values.names import TABLES

if TYPE_CHECKING:
    from etendue.archive.write.store import ArchiveWriter


def in_order(store: ArchiveWriter) -> bool:
    """Return True if a run with nothing to compute would change no file."""
    known = store.manifest
    if known is None or store.mended or store.journal.torn or not store.recorded or known.changed(store.folder):
        return False
    half_written = (disk.PARTIAL, disk.PART)
    if any(name.endswith(half_written) for names in store.listing.files.values() for name in names):
        return False
    if not _laid_out_alike(store):
        return False
    held = {f"{DATA}/{path}": data for path, data in store.tree.held.items() if path != ROOT}
    own = {path: hashlib.sha256(data).hexdigest() for path, data in held.items()}
    others = known.metadata.keys() - own.keys() - {f"{DATA}/{ROOT}"}
    return own.items() <= known.metadata.items() and all(path.split("/")[1] in TABLES for path in others)


def _laid_out_alike(store: ArchiveWriter) -> bool:
    """Return True if the groups are those of the plan, with the same axis values and the same blocks."""
    journal, laid = store.journal, store.laid
    blocks = {group: journal.blocks.get(group) for group in journal.axes}
    others = (node for node in store.ours - store.nodes if node.split("/")[0] not in TABLES)
    return (
        journal.axes == laid.axes
        and blocks == laid.blocks
        and {group: own for group, own in journal.same.items() if own} == laid.same
        and not any(store.listing.has(f"{DATA}/{node}/{ROOT}") for node in others)
    )


def damaged(store: ArchiveWriter) -> Iterator[str]:
    """Yield files that differ from the manifest or are not valid JSON, so that no run can have written them."""
    known = store.manifest.metadata if store.manifest else {}
    found: dict[str, None] = {}
    for path in known or [f"{DATA}/{path}" for path in store.tree.held if path.endswith(ROOT)]:
        own = path.removeprefix(f"{DATA}/")
        if own in store.tree.held or own.split("/")[0] in TABLES:
            data = disk.content_of(store.folder / path)
            if (known and hashlib.sha256(data or b"").hexdigest() != known[path]) or (
                data is not None and own.endswith(ROOT) and disk.read_document(store.folder / path) is None
            ):
                found[re.sub(r"(/zarr\.json|/c(/\d+)*)$", "", path)] = None
    yield from found
    if store.manifest:
        yield from (path for path in store.manifest.changed(store.folder) if path in store.manifest.files)
    yield from (f"{path} (its size or index)" for path in store.blocks.odd())
