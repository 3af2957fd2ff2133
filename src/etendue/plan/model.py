"""The plan: frozen values that state what is computed. No arrays.

A ``Node`` is a stage of the pipeline with the axes that affect it. A ``Cell`` is one stage at one combination of these
axes. A ``CellRef`` names a cell by its node and its position on each of the node's axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod
from operator import mul
from typing import Any

from etendue.contract.arrays.dims import banded
from etendue.contract.capabilities import (
    Source,
    Summed,
    Tinting,
    is_transfer,
)
from etendue.contract.stage import Stage, per_kind, reads_of, writes_of
from etendue.pipeline.file import PipelineFile
from etendue.plan.identity.same_as import of_cell, same_as
from etendue.plan.structure.cell import ALL_DIGITS as ALL_DIGITS
from etendue.plan.structure.cell import Approximated as Approximated
from etendue.plan.structure.cell import Cell as Cell
from etendue.plan.structure.cell import CellRef as CellRef
from etendue.plan.structure.cell import LeftOut as LeftOut
from etendue.plan.structure.nodes import Alternative as Alternative
from etendue.plan.structure.nodes import Axis as Axis
from etendue.plan.structure.nodes import Node as Node
from etendue.types.documents import DocumentView

StageVariable = tuple[str, str]


def scene_of(cells: Mapping[CellRef, Cell], cell: Cell) -> Cell:
    """Return the source cell at which the chain of first inputs of a cell starts."""
    while cell.inputs:
        cell = cells[cell.inputs[0][1]]
    return cell


def is_whole(cells: Mapping[CellRef, Cell], cell: Cell) -> bool:
    """Return whether a product of transfer functions describes everything between the scene and a transfer cell."""
    while cell.inputs:
        if not (is_transfer(type(cell.stage)) or cell.stage.pointwise):
            return False
        cell = cells[cell.inputs[0][1]]
    return True


def pixel_of(cells: Sequence[Cell]) -> list[Cell]:
    """Return, as a list, the first cell that sums over bands, else the last cell; empty if there are no cells."""
    return [c for c in cells if isinstance(c.stage, Summed)][:1] or list(cells[-1:])


def light_of(cells: Mapping[CellRef, Cell], cell: Cell) -> tuple[float, ...] | None:
    """Return white light by band before a transfer cell: the white of the scene multiplied by the transmission of
    filters, scaled to a largest value of 1 and rounded to 12 digits.

    Return None if the scene states no white, or if a stage changes white in another way than by a transmission.
    """
    edges = cell.input_grids[cell.inputs[0][0]].bands().edges
    passed = [1.0] * (len(edges) - 1)
    while cell.inputs:
        if isinstance(cell.stage, Tinting):
            taken = cell.stage.transmission(next(grid for grid in cell.input_grids.values() if grid.banded))
            passed = [own * float(share) for own, share in zip(passed, taken, strict=True)]
        elif _changes_white(type(cell.stage)):
            return None
        cell = cells[cell.inputs[0][1]]
    white = cell.stage.white_light(edges) if isinstance(cell.stage, Source) else None
    if white is None or len(white) != len(passed):
        return None
    light = [share * float(own) for share, own in zip(passed, white, strict=True)]
    return tuple(round(value / max(light), 12) for value in light) if max(light) > 0 else None


@per_kind
def _changes_white(kind: type[Stage]) -> bool:
    """Return whether a stage reads and writes a variable that has one value per band and no position."""
    read = {declared.variable for declared in reads_of(kind).values()}
    return any(
        declared.variable in read and len(declared.dims) == 1 and banded(declared.dims)
        for declared in writes_of(kind).values()
    )


def chains(names: Sequence[str], nodes: Mapping[str, Node]) -> list[list[int]]:
    """Return, for each of some transfer nodes in order, the numbers of the nodes through which its light passes; its
    own number is last.
    """
    found: list[list[int]] = []
    for number, name in enumerate(names):
        before: set[str] = set()
        open_ = {name}
        while open_:
            before |= open_
            open_ = {source for n in open_ for bound in nodes[n].inputs for _, source, _ in bound} - before
        found.append([i for i in range(number + 1) if names[i] in before])
    return found


class Numbers:
    """Numbers cells from 0 in the order of the plan, so that data by cell can be stored in arrays with a few bytes per
    cell.

    The cells of a node are consecutive, the last axis varies fastest. A number therefore follows from strides, without
    a table.
    """

    def __init__(self, nodes: Iterable[Node], sizes: Mapping[str, int]) -> None:
        self.count = 0
        self.counts: dict[str, int] = {}  # by node
        self.places: dict[str, tuple[int, tuple[int, ...]]] = {}
        for node in nodes:
            own = [sizes[dim] for dim in node.axes]
            self.places[node.name] = self.count, tuple(prod(own[place + 1 :]) for place in range(len(own)))
            self.counts[node.name] = prod(own)
            self.count += prod(own)

    def range(self, node: str) -> range:
        """Return the numbers of the cells of a node."""
        first = self.places[node][0]
        return range(first, first + self.counts[node])

    def of(self, ref: CellRef) -> int:
        first, strides = self.places[ref[0]]
        number: int = first + sum(map(mul, ref[1], strides))
        return number


@dataclass(frozen=True)
class Plan:
    """A plan: the cells to compute, in order, and the cells that are left out, with reasons."""

    pipeline: PipelineFile
    axes: tuple[Axis, ...]
    nodes: tuple[Node, ...]
    cells: Mapping[CellRef, Cell]
    wanted: tuple[StageVariable, ...]
    kept: frozenset[tuple[str, str]]
    precision: str
    shared: DocumentView
    warnings: tuple[str, ...] = ()
    leaves_out: bool = True  # whether anything may be left out or approximated
    digits: float = 0.0  # tolerance to which the digits of pictures are rounded; 0: all stay
    looked: float = 0.0  # seconds spent on the analysis of scenes that were never planned before
    expected: bool = False  # means instead of draws and rounding: integer variables are floats, nothing is stored
    # variables that ``keep`` names: they are stored even if all their cells are left out
    copied: frozenset[StageVariable] = frozenset()
    # nodes that are not run, because others look only at their stages, for example at a transfer function
    seen_only: frozenset[str] = frozenset()
    derived: tuple[Axis, ...] = ()  # distinct combinations of some factors; positions follow from other axes

    def node(self, name: str) -> Node:
        return self._named[name]

    def axis(self, dim: str) -> Axis:
        for axis in self.positioned:
            if axis.dim == dim:
                return axis
        raise KeyError(dim)

    @property
    def positioned(self) -> tuple[Axis, ...]:
        """All axes on which a cell has a position."""
        return (*self.axes, *self.derived)

    def everywhere(self, at: Mapping[str, int]) -> dict[str, int]:
        """Return positions on all axes from those on the independent axes."""
        return {**at, **{one.dim: one.places[at[one.of]] for one in self.derived if one.of in at}}

    def of(self, name: str) -> list[Cell]:
        """Return the cells of a node, in order."""
        return list(self._grouped.get(name, ()))

    @cached_property
    def numbers(self) -> Numbers:
        return Numbers(self.nodes, {axis.dim: len(axis.values) for axis in self.positioned})

    @cached_property
    def same_as(self) -> Mapping[StageVariable, str]:
        """For each kept variable without its own array, the stage that has its values (``identity.same_as``)."""
        return same_as(self.nodes, self._grouped, self.cells, self.kept, self.copied)

    @cached_property
    def with_arrays(self) -> frozenset[StageVariable]:
        """The kept variables that have an array of their own."""
        return self.kept - self.same_as.keys()

    def stored(self, ref: CellRef, variable: str) -> CellRef:
        """Return the cell that has the values of a kept variable: the cell itself, or an earlier cell."""
        holder = self.same_as.get((ref[0], variable))
        return ref if holder is None else of_cell(self.cells, ref, variable, holder)

    @cached_property
    def _named(self) -> Mapping[str, Node]:
        return {node.name: node for node in self.nodes}

    @cached_property
    def _grouped(self) -> Mapping[str, Sequence[Cell]]:
        found: dict[str, list[Cell]] = {}
        for cell in self.cells.values():
            found.setdefault(cell.node, []).append(cell)
        return found

    def origin(self, ref: CellRef) -> str:
        """Return the stage of a cell and its distribution, as ``STAGE of DISTRIBUTION 0.1.0``."""
        cell = self.cells[ref]
        one = next(a for a in self.node(ref[0]).alternatives if a.kind is type(cell.stage) and a.use == cell.use)
        return f"{one.use} of {one.distribution} {one.version}"

    def labels(self, ref: CellRef) -> dict[str, Any]:
        """Return the axis values of a cell, by dim."""
        node = self.node(ref[0])
        return {dim: self.axis(dim).values[i] for dim, i in zip(node.axes, ref[1], strict=True)}
