"""The plan: frozen values that say what will be computed. No arrays.

A ``Node`` is a stage of the pipeline with its axes; a ``Cell`` is one stage at one combination of the axes that
reach it. A ``CellRef`` names a cell by its node and the position on each of the node's axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import prod
from operator import mul
from typing import Any

from etendue.contract.capabilities import (
    Probe,
    Source,
    Summed,
    Tinting,
    draws_anew,
    ends_in_sum,
    is_random,
    is_source,
    is_transfer,
)
from etendue.contract.dims import banded
from etendue.contract.facts import Facts
from etendue.contract.grid import Coordinate, Grid
from etendue.contract.stage import Stage, per_kind, quantities_of, reads_of, writes_of
from etendue.contract.variables import Declaration
from etendue.pipeline.file import Pipeline
from etendue.types.documents import DocumentView

CellRef = tuple[str, tuple[int, ...]]


@dataclass(frozen=True)
class Axis:
    """One swept parameter. ``key`` is its name in the file, ``dim`` its name as a dimension."""

    key: str
    dim: str
    values: tuple[Any, ...]  # floats, ints or texts; labels where a stage is swapped
    units: str = ""
    gives: Mapping[str, tuple[Any, ...]] = field(
        default_factory=dict, hash=False
    )  # by parameter: names of many at once

    def value(self, name: str, position: int) -> Any:
        """What a parameter is at a position."""
        return self.gives[name][position] if name in self.gives else self.values[position]


@dataclass(frozen=True)
class Alternative:
    """One stage that may stand at a node: its class and its fixed parameters."""

    use: str
    label: str
    kind: type[Stage]
    values: DocumentView
    distribution: str
    version: str
    digest: str
    written: frozenset[str] = frozenset()  # parameters that the file gives


@dataclass(frozen=True)
class Node:
    """A stage of the pipeline with what it reads and the axes that reach it."""

    name: str
    number: int
    place: str
    alternatives: tuple[Alternative, ...]
    direct: tuple[tuple[str, str], ...]  # (axis dim, parameter) set by an axis
    use_axis: str | None  # dim of the axis that swaps this stage
    inputs: tuple[
        tuple[tuple[str, str, str], ...], ...
    ]  # per alternative: (port or shared quantity, node, variable); ports first
    looks_at: tuple[tuple[str, str, tuple[str, ...]], ...]  # (port, 'transfer' or variable, nodes in order)
    writes: Mapping[str, Declaration]
    axes: tuple[str, ...]
    optional: Mapping[str, Declaration] = field(default_factory=dict)  # what it could write too, and nobody asks for
    segment: tuple[str, ...] = ()  # names of the transfer nodes of its segment up to itself
    mapped: tuple[str, ...] = ()  # dims of what it reads that it does not work on: it is run for each of their values

    @property
    def found(self) -> dict[str, str]:
        """Shared quantities that earlier stages write, and which stages those are."""
        pairs = zip(self.alternatives, self.inputs, strict=True)
        return {name: source for one, bound in pairs for name, source, _ in bound if name in quantities_of(one.kind)}

    @property
    def kind(self) -> type[Stage]:
        return self.alternatives[0].kind

    @property
    def is_source(self) -> bool:
        return is_source(self.kind)

    @property
    def is_transfer(self) -> bool:
        return is_transfer(self.kind)

    @property
    def ends_in_sum(self) -> bool:
        return ends_in_sum(self.kind)

    @property
    def is_probe(self) -> bool:
        return issubclass(self.kind, Probe)

    @property
    def is_random(self) -> bool:
        return any(is_random(a.kind) for a in self.alternatives)

    @property
    def draws_anew(self) -> bool:
        return any(draws_anew(a.kind) for a in self.alternatives)


@dataclass(frozen=True)
class LeftOut:
    """Why a cell needs no computing, and how wrong that is relative to the full scale of its variable."""

    bound: float
    why: str


@dataclass(frozen=True)
class Approximated:
    """A knob that the plan has set, what it would be in the reference, and what the difference may add to the cell's
    own output.
    """

    knob: str
    value: Any
    reference: Any
    bound: float


@dataclass(slots=True)
class Cell:
    """One stage at one combination of its axes. Written once by the planner, then only read: cells share what is
    equal in them.
    """

    ref: CellRef
    stage: Stage
    use: str
    inputs: tuple[tuple[str, CellRef, str], ...]  # (port or shared quantity, cell, variable); ports first
    looks_at: tuple[tuple[str, tuple[CellRef, ...]], ...]
    key: str
    versions: Mapping[str, str]  # of the libraries that stand in its key
    seed: bytes
    open_words: tuple[
        Any, ...
    ]  # of its seed: lines whose value a run finds (plan.words.Open), and the closed ones behind them
    input_grids: Mapping[str, Grid]
    grids: Mapping[str, Grid]
    facts: Facts
    left_out: LeftOut | None
    approximated: tuple[Approximated, ...]
    error: tuple[float | None, str]
    segment_input: tuple[CellRef, str] | None = None
    mapped: tuple[
        tuple[str, Coordinate], ...
    ] = ()  # dims in front of what is written for which the stage is run one by one

    @property
    def node(self) -> str:
        return self.ref[0]

    @property
    def index(self) -> tuple[int, ...]:
        return self.ref[1]

    @property
    def found(self) -> tuple[tuple[str, CellRef, str], ...]:
        """The inputs that are shared quantities."""
        quantities = quantities_of(type(self.stage))
        return tuple(one for one in self.inputs if one[0] in quantities)

    @property
    def bound(self) -> float:
        """What leaving out and approximating may add to its own output, relative to full scale."""
        return self.left_out.bound if self.left_out else sum(one.bound for one in self.approximated)


def told_by(grids: Mapping[str, Grid], input_grids: Mapping[str, Grid]) -> tuple[int, int]:
    """What tells the grids of a cell from those of others. Cells of a plan have one of equal ones, and hold it: so it
    is its identity, which takes no comparing.
    """
    return id(grids), id(input_grids)


def scene_of(cells: Mapping[CellRef, Cell], cell: Cell) -> Cell:
    """The source cell at the start of what a cell reads first."""
    while cell.inputs:
        cell = cells[cell.inputs[0][1]]
    return cell


def is_whole(cells: Mapping[CellRef, Cell], cell: Cell) -> bool:
    """Whether nothing stands between the scene and a transfer cell that a product of transfer functions does not
    hold.
    """
    while cell.inputs:
        if not (is_transfer(type(cell.stage)) or cell.stage.pointwise):
            return False
        cell = cells[cell.inputs[0][1]]
    return True


def pixel_of(cells: Sequence[Cell]) -> list[Cell]:
    """Of the cells that are looked at the first that sums over bands, or else the last; none of none."""
    return [c for c in cells if isinstance(c.stage, Summed)][:1] or list(cells[-1:])


def light_of(cells: Mapping[CellRef, Cell], cell: Cell) -> tuple[float, ...] | None:
    """White light by band in front of a transfer cell: that of the scene, less what filters have taken; the largest 1,
    to 12 places.

    None where the scene does not say, or a stage changes white in a way of its own.
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
    """Whether a stage reads and writes something that has a value for every band, and no place."""
    read = {declared.variable for declared in reads_of(kind).values()}
    return any(
        declared.variable in read and len(declared.dims) == 1 and banded(declared.dims)
        for declared in writes_of(kind).values()
    )


def chains(names: Sequence[str], nodes: Mapping[str, Node]) -> list[list[int]]:
    """For each of some transfer nodes in order: which of them light has passed behind it, itself last."""
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
    """Cells as numbers from 0, in the order of the plan: what is known of every cell fits in columns, of a few bytes.

    Those of a node stand one behind the other, the last axis fastest: no table of them is needed.
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
        """The numbers of the cells of a node."""
        first = self.places[node][0]
        return range(first, first + self.counts[node])

    def of(self, ref: CellRef) -> int:
        first, strides = self.places[ref[0]]
        number: int = first + sum(map(mul, ref[1], strides))
        return number


@dataclass(frozen=True)
class Plan:
    """What will be computed, in which order, with what left out and why."""

    pipeline: Pipeline
    axes: tuple[Axis, ...]
    nodes: tuple[Node, ...]
    cells: Mapping[CellRef, Cell]
    wanted: tuple[tuple[str, str], ...]  # (node, variable)
    kept: frozenset[tuple[str, str]]
    precision: str
    shared: DocumentView
    warnings: tuple[str, ...] = ()
    leaves_out: bool = True  # whether anything may be left out or approximated
    looked: float = 0.0  # seconds of looking at scenes that were never planned before
    expected: bool = False  # means in the place of draws and rounding: integer variables are floats, nothing is stored

    def node(self, name: str) -> Node:
        return self._named[name]

    def axis(self, dim: str) -> Axis:
        for axis in self.axes:
            if axis.dim == dim:
                return axis
        raise KeyError(dim)

    def of(self, name: str) -> list[Cell]:
        """The cells of a node, in order."""
        return list(self._grouped.get(name, ()))

    @cached_property
    def numbers(self) -> Numbers:
        return Numbers(self.nodes, {axis.dim: len(axis.values) for axis in self.axes})

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
        """The stage behind a cell and the distribution it is of: ``STAGE of DISTRIBUTION 0.1.0``."""
        cell = self.cells[ref]
        one = next(a for a in self.node(ref[0]).alternatives if a.kind is type(cell.stage) and a.use == cell.use)
        return f"{one.use} of {one.distribution} {one.version}"

    def labels(self, ref: CellRef) -> dict[str, Any]:
        """Axis values of a cell by dim."""
        node = self.node(ref[0])
        return {dim: self.axis(dim).values[i] for dim, i in zip(node.axes, ref[1], strict=True)}
