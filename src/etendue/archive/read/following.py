"""Variables without an array, because all their cells are left out: the places of the values of each cell.

In: the journal's lines about the groups, and the finished cells.
Out: for every such cell the chunks of the cell that has its values.

The values of a cell are taken only from a cell with an equal key whose variable has an array, so the result is the same
and one step suffices. A forged journal therefore cannot cause an endless loop, give wrong values, or lead out of the
archive.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING

from etendue.archive.journaling.journal import Read
from etendue.archive.records.names import cell_label

if TYPE_CHECKING:
    from etendue.archive.read.reading import StoredCell, StoredChunk

Place = tuple[int, ...]


@dataclass(frozen=True)
class Followed:
    """A variable of a group that has no array, and, for each of its cells, the cell that has the values."""

    group: str
    variable: str
    path: str  # of the array that has the values
    cells: dict[Place, tuple[StoredCell, tuple[StoredChunk, ...]]] = field(default_factory=dict)

    @property
    def source(self) -> str:
        """The group of the array that has the values."""
        return self.path[1:].rpartition("/")[0]


def fault_of(journal: Read, group: str, variable: str) -> str:
    """Return the reason why the array named by the journal cannot have the values of a variable; '' if it can."""
    path = journal.same[group][variable]
    source, _, name = path[1:].rpartition("/")
    if group not in journal.axes:
        return "the archive has no such group"
    if name != variable:
        return f"{path} is another variable"
    if variable in journal.same.get(source, {}):
        return f"{path} has no array of its own"
    if source not in journal.axes or variable not in journal.blocks.get(source, {}):
        return f"the archive has no array {path}"
    if not set(journal.axes[source]) <= set(journal.axes[group]):
        return f"{path} has axes that {group} lacks"
    return ""


def follow(journal: Read, cells: Mapping[str, StoredCell]) -> list[Followed]:
    """Return every variable without an array, with its finished cells."""
    found = []
    for group, own in journal.same.items():
        for variable, path in own.items():
            one = Followed(group, variable, path)
            if not fault_of(journal, group, variable):
                one.cells.update(_cells(journal, one, cells))
            found.append(one)
    return found


def _cells(
    journal: Read, one: Followed, cells: Mapping[str, StoredCell]
) -> Iterator[tuple[Place, tuple[StoredCell, tuple[StoredChunk, ...]]]]:
    stage, before, axes = one.group.split("/")[0], one.source.split("/")[0], journal.axes[one.group]
    there = journal.axes[one.source]
    for at in product(*(range(len(values)) for values in axes.values())):
        labels = {dim: values[i] for i, (dim, values) in zip(at, axes.items(), strict=True)}
        cell = cells.get(cell_label(stage, labels))
        source = cells.get(cell_label(before, {dim: labels[dim] for dim in there}))
        if cell is None or source is None or cell.entry.key != source.entry.key or cell.entry.status != "left_out":
            continue
        chunks = tuple(c for c in source.chunks if (c.group, c.variable) == (one.source, one.variable))
        if chunks:
            yield at, (cell, chunks)
