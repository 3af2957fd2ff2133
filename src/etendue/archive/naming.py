"""Names and places of cells, found from their references: nothing is held of a cell.

In:  a plan.
Out: the name of a cell in the journal; which group it is of, and where it stands there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from etendue.plan.model import Cell, CellRef, Plan
from etendue.types.documents import Place

Index = tuple[int, ...]


def cell_name(plan: Plan, ref: CellRef) -> str:
    """A cell by stage and axis values: the same name whatever else is swept."""
    return cell_label(ref[0], plan.labels(ref))


def cell_label(stage: str, labels: Place) -> str:
    """The name of a cell in the journal."""
    return stage + "".join([_piece(dim, value) for dim, value in labels.items()])


def _piece(dim: str, value: Any) -> str:
    return f" {dim}={value!r}" if isinstance(value, str) else f" {dim}={value}"


class Names(Mapping[CellRef, str]):
    """``cell_name`` of every cell of a plan."""

    def __init__(self, plan: Plan) -> None:
        pieces = {axis.dim: [_piece(axis.dim, value) for value in axis.values] for axis in plan.axes}
        self.plan, self.pieces = plan, {node.name: [pieces[dim] for dim in node.axes] for node in plan.nodes}

    def __getitem__(self, ref: CellRef) -> str:
        return ref[0] + "".join([own[i] for own, i in zip(self.pieces[ref[0]], ref[1], strict=True)])

    def __iter__(self) -> Iterator[CellRef]:
        return iter(self.plan.cells)

    def __len__(self) -> int:
        return len(self.plan.cells)


class Homes(Mapping[CellRef, str]):
    """The group of every cell of which something is kept. ``of``: by stage its one group, or the group of each of
    its cells.
    """

    def __init__(self, plan: Plan, of: Mapping[str, str | Mapping[CellRef, str]]) -> None:
        self.plan, self.groups = plan, of

    def __getitem__(self, ref: CellRef) -> str:
        found = self.groups[ref[0]]
        return found if isinstance(found, str) else found[ref]

    def __iter__(self) -> Iterator[CellRef]:
        return (ref for ref in self.plan.cells if ref[0] in self.groups)

    def __len__(self) -> int:
        return sum(1 for _ in self)


class Whole(Mapping[CellRef, Index]):
    """The places of the cells of a stage that has one group: those on its axes."""

    def __init__(self, cells: list[Cell]) -> None:
        self.cells = cells

    def __getitem__(self, ref: CellRef) -> Index:
        return ref[1]

    def __iter__(self) -> Iterator[CellRef]:
        return (cell.ref for cell in self.cells)

    def __len__(self) -> int:
        return len(self.cells)
