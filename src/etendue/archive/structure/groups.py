"""Choose the group of the store for the cells of a stage, from their shapes and from their present places.

In:  the cells of a stage; the places and forms of stored cells according to the journal.
Out: the group of every cell, and a group that has to be renamed.

In a new archive a stage has one group, or one child per shape if its grids differ. Stored cells keep their places:
cells of one shape stay in their group when more cells of this shape are added. Cells that are stored in the group of
the stage itself move into a child when a second shape is added, because a group with children holds no arrays; their
bytes are not rewritten.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from etendue.archive.records.manifest import DATA
from etendue.contract.arrays.grid import Coordinate
from etendue.plan.identity.keys import digest
from etendue.plan.identity.once import Once
from etendue.plan.identity.same_as import shape_of
from etendue.plan.model import Cell, CellRef, Node
from etendue.types.documents import DocumentView


@dataclass(frozen=True)
class ArchivedLayout:
    """The content of an archive: its groups, the stored form of their variables, and the shard in which a cell begins
    ('' if it is not stored).
    """

    groups: Collection[str] = ()
    blocks: Mapping[str, Mapping[str, DocumentView]] = field(default_factory=dict)
    shard: Callable[[CellRef], str] = lambda ref: ""

    def of(self, cells: Sequence[Cell], shapes: Mapping[str, tuple[int, ...]]) -> list[str]:
        """Return the groups in which some of the cells are stored with matching variable shapes, the group with most
        cells first.
        """
        shards = (self.shard(cell.ref) for cell in cells) if self.groups else ()
        found = Counter(path.rsplit("/", 2)[0].removeprefix(f"{DATA}/") for path in shards if path)
        return [group for group, _ in found.most_common() if self._fits(group, shapes)]

    def _fits(self, group: str, shapes: Mapping[str, tuple[int, ...]]) -> bool:
        stored = {
            name: one["form"].partition(" ")[2] for name, one in self.blocks.get(group, {}).items() if name in shapes
        }
        return bool(stored) and all(form == "x".join(map(str, shapes[name])) for name, form in stored.items())


def groups_of(
    node: Node, cells: Sequence[Cell], kept: Sequence[str], before: ArchivedLayout
) -> tuple[str | dict[CellRef, str], str]:
    """Return the group of all cells of a stage, or the group of each cell; also return the child group to which the
    content of the stage's own group must be moved, '' if it is not moved.
    """
    same = alike(cells)
    if same and not any(group.startswith(f"{node.name}/") for group in before.groups):
        return node.name, ""
    shapes, becomes, home = dict[str, list[Cell]](), "", dict[str, str]()
    names = shape_names(cells)
    for cell in cells:
        shapes.setdefault(names[cell.ref], []).append(cell)
    for name, own in shapes.items():
        stored = before.of(own, {v: own[0].grids[v].shape(node.writes[v].dims) for v in kept})
        if len(shapes) == 1:
            home[name] = next(iter(stored), node.name if same else f"{node.name}/{name}")
            continue
        there = [group for group in stored if group != node.name and group not in home.values()]
        home[name] = next(iter(there), f"{node.name}/{name}")
        if node.name in stored and not becomes:
            becomes = home[name]
    if set(home.values()) == {node.name}:
        return node.name, ""
    return {ref: home[name] for ref, name in names.items()}, becomes


def alike(cells: Sequence[Cell]) -> bool:
    """Return True if all cells have the same grids."""
    first = cells[0].grids
    return all(cell.grids is first or cell.grids == first for cell in cells)


def shape_names(cells: Sequence[Cell]) -> dict[CellRef, str]:
    """Return a name for the shape of each cell; cells with the same sizes, bins and labels have the same name.

    The name is ``64x64`` from the sizes of y and x, followed by every other dim that differs between the cells.
    """
    every, once = list[dict[str, tuple[int, Coordinate | None]]](), Once[int]()

    def number(cell: Cell) -> int:
        every.append(shape_of(cell))
        return len(every) - 1

    own = {cell.ref: once((cell.grids,), partial(number, cell)) for cell in cells}  # many cells share their grids
    differ = {dim for found in every for dim in found if found[dim] != every[0].get(dim)} - {"y", "x"}
    names: list[str] = []
    shapes: dict[str, set[tuple[Hashable, ...]]] = {}
    for found in every:
        plane = f"{found['y'][0]}x{found['x'][0]}" if "y" in found and "x" in found else ""
        rest = [dim for dim in found if dim in differ or (not plane and found[dim][0] > 0)]
        names.append("_".join([*([plane] if plane else []), *(f"{dim}{found[dim][0]}" for dim in rest)]) or "scalar")
        shapes.setdefault(names[-1], set()).add(tuple(sorted(found.items())))
    for place, (name, found) in enumerate(zip(names, every, strict=True)):
        if len(shapes[name]) > 1:  # same sizes but different bins or labels
            names[place] = f"{name}_{digest(repr(tuple(sorted(found.items()))).encode())[:8]}"
    return {ref: names[place] for ref, place in own.items()}
