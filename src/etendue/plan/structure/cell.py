"""A cell: one stage at one combination of its axes.

Cells of a stage share their common properties in one ``Settled`` object. A cell itself has its place, its facts and,
once they are requested, its key, its seed and the cells that it reads. This saves memory: a plan may have a million
cells, few of which differ in more.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from etendue.contract.arrays.facts import Facts
from etendue.contract.arrays.grid import Coordinate, Grid
from etendue.contract.stage import Stage, quantities_of

if TYPE_CHECKING:
    from etendue.plan.expansion.seed_words import Open

CellRef = tuple[str, tuple[int, ...]]
Inputs = tuple[tuple[str, CellRef, str], ...]  # (port or shared quantity, cell, variable); ports first
Looks = tuple[tuple[str, tuple[CellRef, ...]], ...]
Start = tuple[CellRef, str] | None
Drawn = tuple[bytes, "tuple[Open, ...]"]  # seed, and the lines of it that a run finds (``seed_words.Open``)
PositionMap = Callable[[tuple[int, ...]], tuple[int, ...]]  # maps the position of a cell to that of a cell it reads
# never written to; plain dicts, since a mapping proxy cannot be pickled
ALL_DIGITS: Mapping[str, int | None] = {}
NO_STEPS: Mapping[str, float] = {}


@dataclass(frozen=True)
class LeftOut:
    """The reason why a cell is left out, and the error bound of this omission, relative to the full scale of its
    variable.

    ``apart``: the bound of the worst band, relative to the full scale of that band; 0 if it is not larger than the
    other bound. Later stages that use single bands use ``apart``.
    """

    bound: float
    why: str
    apart: float = 0.0


@dataclass(frozen=True)
class Approximated:
    """A knob that the plan has set, its value in the reference, and a bound on the error that the difference adds to
    the output of the cell.
    """

    knob: str
    value: Any
    reference: Any
    bound: float


class Reading(NamedTuple):
    """Where an alternative of a node takes its inputs from, and the stages that it looks at."""

    inputs: tuple[tuple[str, str, str, PositionMap], ...]  # port or shared quantity, node, variable, where
    looks_at: tuple[tuple[str, tuple[tuple[str, PositionMap], ...]], ...]
    ports: frozenset[str]
    quantities: frozenset[str]
    alike: bool  # whether the decisions about a cell follow from its stage and the grids and facts of its inputs
    asked: tuple[tuple[str, PositionMap], ...]  # the stages it looks at as transfer functions
    segment: int  # number of transfer nodes of its segment, up to itself


class Recipe(Protocol):
    """Finds the key and the seed of the cells of a plan."""

    cells: Mapping[CellRef, Cell]

    def key(self, ref: CellRef) -> str: ...

    def drawn(self, ref: CellRef) -> Drawn: ...


@dataclass(slots=True, eq=False)
class Settled:
    """The properties that several cells of a stage have in common. Compared by identity."""

    stage: Stage
    use: str
    reading: Reading
    recipe: Recipe
    head: str  # common first part of their keys
    versions: Mapping[str, str]  # versions of the libraries that are in their keys
    draws: bool  # whether they have a seed, which is part of their keys
    input_grids: Mapping[str, Grid]
    grids: Mapping[str, Grid]
    mapped: tuple[tuple[str, Coordinate], ...]  # leading dims of the output; the stage runs once per value
    left_out: LeftOut | None
    approximated: tuple[Approximated, ...]
    error: tuple[float | None, str]
    # by variable whose digits follow the tolerance: the exponent of the step it is rounded to; None: all digits stay
    digits: Mapping[str, int | None]

    def __reduce__(self) -> tuple[type[Settled], tuple[Hashable, ...]]:
        """Leave out the objects that find keys, seeds and inputs: all of these are found before cells are sent."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        values |= {"reading": self.reading._replace(inputs=(), looks_at=(), asked=()), "recipe": Sent()}
        return Settled, tuple(values.values())


class Sent:
    """The recipe of cells that were sent to another process: their keys, seeds and inputs are known already."""

    cells: Mapping[CellRef, Cell] = {}

    def key(self, ref: CellRef) -> str:
        return ""

    def drawn(self, ref: CellRef) -> Drawn:
        return NOT_DRAWN


def _in_common(name: str) -> Any:
    """Return a property of ``Cell`` that reads this name from ``settled``."""
    return property(attrgetter(f"settled.{name}"))


class Cell:
    """One stage at one combination of its axes. The planner writes it once; then it is only read.

    ``growth`` is the largest factor by which an error of its output grows on its way to the wanted variables.
    """

    __slots__ = ("_drawn", "_inputs", "_key", "_looks_at", "_start", "facts", "growth", "ref", "settled")

    def __init__(self, ref: CellRef, settled: Settled, facts: Facts) -> None:
        self.ref, self.settled, self.facts, self.growth = ref, settled, facts, 1.0
        # found when they are asked for
        self._key: str | None = None
        self._drawn: Drawn | None = None
        self._inputs: Inputs | None = None
        self._looks_at: Looks | None = None
        self._start: tuple[Start] | None = None

    def changed(self, **changes: Any) -> Cell:
        """Return a copy with other values of some properties."""
        made = self.taken(self.settled)
        made.growth, made._looks_at, made._start = self.growth, self._looks_at, self._start
        if "ref" in changes:  # find all values now: at the new place they would differ
            made._key, made._drawn = self.key, (self.seed, self.open_words)
            made._inputs, made._looks_at, made._start = self.inputs, self.looks_at, (self.segment_input,)
        if {"seed", "open_words"} & changes.keys():
            made._drawn = changes.pop("seed", self.seed), changes.pop("open_words", self.open_words)
        if "segment_input" in changes:
            made._start = (changes.pop("segment_input"),)
        own = {"key": "_key", "inputs": "_inputs", "looks_at": "_looks_at", "ref": "ref", "facts": "facts"}
        for name, slot in {**own, "growth": "growth"}.items():
            if name in changes:
                setattr(made, slot, changes.pop(name))
        made.settled = replace(self.settled, **changes) if changes else self.settled
        return made

    def taken(self, settled: Settled) -> Cell:
        """Return the same cell for another plan. Its growth is set anew, because it depends on later cells."""
        made = Cell(self.ref, settled, self.facts)
        made._key, made._drawn, made._inputs = self._key, self._drawn, self._inputs
        return made

    def __getstate__(self) -> tuple[None, dict[str, Hashable]]:
        _ = self.segment_input, self.looks_at, self.key, self.seed, self.inputs  # found when they are asked for
        return None, {name: getattr(self, name) for name in self.__slots__}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Cell) and self._values() == other._values()

    def _values(self) -> tuple[Hashable, ...]:
        read = (self.ref, self.inputs, self.looks_at, self.segment_input, self.facts, self.growth)
        made = (self.key, self.versions, self.seed, self.open_words, self.use)
        form = (self.stage, self.input_grids, self.grids, self.mapped, self.digits)
        return *read, *made, *form, self.left_out, self.approximated, self.error

    # -- in common with other cells -----------------------------------------------------------------------------------

    stage: Stage = _in_common("stage")
    use: str = _in_common("use")
    versions: Mapping[str, str] = _in_common("versions")
    input_grids: Mapping[str, Grid] = _in_common("input_grids")
    grids: Mapping[str, Grid] = _in_common("grids")
    mapped: tuple[tuple[str, Coordinate], ...] = _in_common("mapped")
    left_out: LeftOut | None = _in_common("left_out")
    approximated: tuple[Approximated, ...] = _in_common("approximated")
    error: tuple[float | None, str] = _in_common("error")
    digits: Mapping[str, int | None] = _in_common("digits")

    # -- its own ------------------------------------------------------------------------------------------------------

    @property
    def inputs(self) -> Inputs:
        """The cells that it reads: (port or shared quantity, cell, variable); ports first."""
        if self._inputs is None:
            cells, index = self.settled.recipe.cells, self.ref[1]
            self._inputs = tuple(
                [
                    (port, cells[source, at(index)].ref, variable)
                    for port, source, variable, at in self.settled.reading.inputs
                ]
            )
        return self._inputs

    @property
    def looks_at(self) -> Looks:
        if self._looks_at is None:
            index = self.ref[1]
            self._looks_at = tuple(
                [
                    (port, tuple([(name, at(index)) for name, at in seen]))
                    for port, seen in self.settled.reading.looks_at
                ]
            )
        return self._looks_at

    @property
    def key(self) -> str:
        if self._key is None:
            self._key = self.settled.recipe.key(self.ref)
        return self._key

    @property
    def seed(self) -> bytes:
        return self._found_drawn()[0]

    @property
    def open_words(self) -> tuple[Open, ...]:
        """The lines of its seed whose values are known only in a run (``seed_words.Open``)."""
        return self._found_drawn()[1]

    def _found_drawn(self) -> Drawn:
        if self._drawn is None:
            self._drawn = self.settled.recipe.drawn(self.ref) if self.settled.draws else NOT_DRAWN
        return self._drawn

    @property
    def segment_input(self) -> Start:
        """The cell and variable that the segment of a transfer stage starts from; None for other stages."""
        if not self.settled.reading.segment:
            return None
        if self._start is None:
            _, source, variable = self.inputs[0]
            continues = self.settled.reading.segment > 1
            self._start = (self.settled.recipe.cells[source].segment_input if continues else (source, variable),)
        return self._start[0]

    def at_wanted(self, bound: float) -> float:
        """Return the error bound at the wanted variables that follows from an error bound at this cell. It is at most
        1, because values beyond full scale are clipped.
        """
        bound = max(bound, self.left_out.apart) if self.left_out else bound
        return max(bound, min(1.0, bound * self.growth)) if bound > 0 else bound

    @property
    def node(self) -> str:
        return self.ref[0]

    @property
    def index(self) -> tuple[int, ...]:
        return self.ref[1]

    @property
    def found(self) -> tuple[tuple[str, CellRef, str], ...]:
        """The inputs that are shared quantities written by earlier stages."""
        quantities = quantities_of(type(self.stage))
        return tuple(one for one in self.inputs if one[0] in quantities)

    @property
    def steps(self) -> Mapping[str, float]:
        """By variable, the step to whose multiples the variable is rounded."""
        return {n: 2.0**own for n, own in self.digits.items() if own is not None} if self.digits else NO_STEPS

    @property
    def bound(self) -> float:
        """Upper bound of the error that omission and approximation add to the output of the cell, relative to full
        scale.
        """
        return self.left_out.bound if self.left_out else max((one.bound for one in self.approximated), default=0.0)


NOT_DRAWN: Drawn = (b"", ())
