"""The state in which the last run left an archive, and what has changed since.

In:  an archive opened for a run, with the layout of a plan.
Out: whether the archive is intact and matches the plan; the files that differ from the manifest.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA, digest_of
from etendue.archive.records.names import ROOT
from etendue.contract.values.names import TABLES

if TYPE_CHECKING:
    from etendue.archive.write.store import ArchiveWriter


def in_order(store: ArchiveWriter) -> bool:
    """Return True if a run that computes nothing would change no file."""
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
    """Return True if the groups equal the groups of the plan, with the same axis values and the same blocks."""
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
    folder, held = store.folder, dict.fromkeys(f"{DATA}/{path}" for path in store.tree.held)
    if store.manifest and (known := store.manifest.metadata):
        ours = (path for path in known if path in held or path.split("/")[1] in TABLES)
        odd = [path for path in ours if digest_of(folder / path) != known[path]]
    else:
        there = (path for path in held if path.endswith(ROOT) and store.listing.has(path))
        odd = [path for path in there if disk.read_document(folder / path) is None]
    yield from dict.fromkeys(re.sub(r"(/zarr\.json|/c(/\d+)*)$", "", path) for path in odd)
    if store.manifest:
        yield from store.manifest.changed(store.folder, metadata=False)
    yield from (f"{path} (its size or index)" for path in store.blocks.odd())
