"""Store the results of a study as groups of an archive: plain arrays, consolidated with the arrays of its stages.

In:  the folder of an archive whose last run ended normally, arrays by group.
Out: the groups, below the group of the study; the root and the manifest include them. A run does not change them.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from etendue.archive.read.studies import is_study
from etendue.archive.read.tree import Tree
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA, put_manifest, read_manifest
from etendue.archive.records.names import ROOT
from etendue.archive.records.owner import behind, fresh_id
from etendue.archive.structure.metadata import consolidated, document
from etendue.archive.write.clearing import nodes_on_disk, remove_node
from etendue.archive.write.compact import locked
from etendue.contract.values.names import STUDY
from etendue.errors import ArchiveError
from etendue.types.documents import Document, DocumentView


def store_study(folder: Path, study: str, groups: Mapping[str, DocumentView]) -> None:
    """Write groups of a study, ``{name: {"attrs": .., "arrays": {array: (dims, values, attrs)}}}``; groups that the
    study stored earlier are kept.

    Raises
    ------
    ArchiveError
        The archive is in use, unfinished or not writable, or another group has the name of the study.
    """
    folder = folder.resolve()
    if behind(folder).running or not os.access(folder / DATA, os.W_OK):
        raise ArchiveError(f"{folder} cannot be written")
    lock = locked(folder, fcntl.LOCK_EX)
    try:
        _write(folder, study, groups)
    finally:
        os.close(lock)


def _write(folder: Path, study: str, groups: Mapping[str, DocumentView]) -> None:
    listing, manifest = disk.Listing(folder), read_manifest(folder)
    root = disk.read_document(folder / DATA / ROOT) or {}
    if manifest is None or "consolidated_metadata" not in root or manifest.changed(folder):
        raise ArchiveError(f"{folder} is incomplete or damaged: run its pipeline on it first")
    there = disk.read_document(folder / DATA / study / ROOT)
    if listing.has(f"{DATA}/{study}") or (study in listing.folders.get(DATA, ()) and not is_study(there)):
        raise ArchiveError(f"{folder / DATA / study} was not written by a study")
    tree = Tree()
    tree.put_group(study, {STUDY: study})
    for name, group in groups.items():
        tree.put_group(f"{study}/{name}", {STUDY: study, **group["attrs"]})
        for array, (dims, values, attrs) in group["arrays"].items():
            tree.put_array(f"{study}/{name}", array, values, dims, attrs)
    files = tree.files()
    before = [node for name in groups for node in nodes_on_disk(listing, f"{study}/{name}")]
    if (
        all(disk.content_of(folder / DATA / path) == data for path, data in files.items())
        and len(before) == sum(path.endswith(ROOT) for path in files) - 1
    ):
        return
    # From here on the archive is as if a run had been interrupted, until its manifest is back.
    disk.write(folder, "run.id", fresh_id().encode())
    disk.remove(folder, "manifest.json")
    for node in sorted(before, key=lambda node: -node.count("/")):
        remove_node(folder, listing, node)
    for path in sorted(files, key=lambda path: (path.endswith(ROOT), -path.count("/"))):
        disk.write(folder, f"{DATA}/{path}", files[path])
    disk.write(folder, f"{DATA}/{ROOT}", whole := _consolidated(folder, root, tree, before))
    digests = {**manifest.metadata, f"{DATA}/{ROOT}": hashlib.sha256(whole).hexdigest()}
    put_manifest(folder, replace(manifest, metadata=digests))


def _consolidated(folder: Path, root: Document, tree: Tree, before: list[str]) -> bytes:
    """Return the root with the metadata of its nodes, with new metadata for the nodes of the study."""
    held: dict[str, Any] = dict(root["consolidated_metadata"]["metadata"])
    nodes = {path: _bare(node) for path, node in held.items() if path not in before}
    own = {path.removesuffix(f"/{ROOT}"): dict(node) for path, node in tree.nodes.items()}
    return document(consolidated({"": _bare(root), **nodes, **own}))


def _bare(node: DocumentView) -> Document:
    return {word: value for word, value in node.items() if word != "consolidated_metadata"}
