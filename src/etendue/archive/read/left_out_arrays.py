"""Virtual arrays of variables without an array, for the verified store: metadata, and the chunks of other arrays.

In:  an archive open for reading.
Out: for each array, its metadata and the places of its chunks; every cell is a separate file.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from etendue.archive.read.following import Followed, fault_of
from etendue.archive.read.reading import StoredArchive, StoredForm
from etendue.archive.read.tree import Tree
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.names import ROOT
from etendue.archive.structure.metadata import in_order
from etendue.errors import ArchiveError

if TYPE_CHECKING:
    from etendue.archive.read.reading import StoredChunk


class LeftOutArrays:
    """Virtual arrays. ``by_node``: by path of the virtual array, the cells that have its values."""

    def __init__(self, archive: StoredArchive) -> None:
        self.archive = archive
        self.by_node = {f"{one.group}/{one.variable}": one for one in archive.followed}

    def form(self, node: str) -> StoredForm:
        """Return the form of a virtual array: the form of the chunks that have its values, with one cell per file."""
        one = self.by_node[node]
        return replace(self.archive.form(one.source, one.variable), block=(1,) * len(self._axes(one)))

    def _axes(self, one: Followed) -> Mapping[str, Sequence[Any]]:
        return self.archive.journal.axes[one.group]

    def files(self) -> Iterator[tuple[str, dict[int, StoredChunk]]]:
        """Yield every file below the archive that these arrays would have, with its chunks by slot."""
        for node, one in self.by_node.items():
            for place, (_, chunks) in one.cells.items():
                name = ".".join(["c", *map(str, place), *("0" for _ in chunks[0].form.shape)])
                yield f"{DATA}/{node}/{name}", {c.written.slot % c.form.pieces: c for c in chunks}

    @cached_property
    def metadata(self) -> dict[str, bytes]:
        """The metadata of each array, by path of its file.

        Raises
        ------
        ArchiveError
            The journal names an array that cannot hold the values of a left-out cell.
        """
        return {f"{node}/{ROOT}": self._metadata(node, one) for node, one in self.by_node.items()}

    def _metadata(self, node: str, one: Followed) -> bytes:
        folder = self.archive.folder
        why = fault_of(self.archive.journal, one.group, one.variable)
        document = None if why else disk.read_document(folder / DATA / one.path[1:] / ROOT)
        if document is None:
            raise ArchiveError(
                f"{folder / DATA / node} should equal {one.path}, but {why or 'its metadata is not readable'}. "
                f"Find changes with: etendue verify {folder}"
            )
        axes, there = self._axes(one), self.archive.journal.axes[one.source]
        own = [str(dim) for dim in document.get("dimension_names") or () if dim not in there]
        attrs = dict(document.get("attributes", {}))
        beside = str(attrs.pop("coordinates", "")).split()
        beside = [name for name in beside if (folder / DATA / one.group / name / ROOT).is_file()]
        attrs |= {"coordinates": " ".join(beside)} if beside else {}
        tree, form = Tree(), self.form(node)
        tree.put_cells(node, (*map(len, axes.values()), *form.shape), form, (*axes, *own), attrs)
        return tree.held[f"{node}/{ROOT}"]

    def consolidated(self, root: bytes) -> bytes:
        """Return the metadata of the root, including the metadata of these arrays."""
        whole = json.loads(root)
        nodes = (whole.get("consolidated_metadata") or {}).get("metadata")
        if not isinstance(nodes, dict):
            return root
        nodes |= {path.removesuffix(f"/{ROOT}"): json.loads(data) for path, data in self.metadata.items()}
        whole["consolidated_metadata"]["metadata"] = in_order(nodes)
        return json.dumps(whole).encode()
