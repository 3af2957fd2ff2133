"""A job: everything needed to compute one cell, and nothing of the plan besides. A plain value that travels to another
process.

In:  what the owner of a run knows of a cell.
Out: ``Job``, with what a segment, looking at other stages, waiting for what a run finds and being run in slices add to
     it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

from etendue.contract.capabilities import Sampled, Sheet, Summed, Transfer, mean_arguments_of
from etendue.contract.grid import Coordinate, Grid
from etendue.contract.ports import Target
from etendue.contract.stage import Stage, arguments_of, looks_at_stages
from etendue.contract.variables import Declaration
from etendue.plan.model import CellRef
from etendue.plan.words import Open

if TYPE_CHECKING:
    from etendue.compute.form import Form

Found = tuple[tuple[str, CellRef, str], ...]  # shared quantities, and the cells and variables that hold them


@dataclass(eq=False)
class Segment:
    """Of a transfer function: the cell before it whose transform it goes on from, or the stages between it and the
    segment's input.
    """

    previous: CellRef | None = None
    joined: tuple[Transfer, ...] | None = None  # reads the segment's input itself
    found: tuple[Found, ...] = ()  # what each of them awaits; (): none does
    transform: bool = False  # others go on from its own
    source: str = ""  # key of the segment's input, where it is read itself


@dataclass(eq=False)
class Looking:
    """Of a stage that looks at others: through which port at what, and the transfer functions in front of it."""

    ports: tuple[
        tuple[str, str, tuple[tuple[str, CellRef], ...]], ...
    ] = ()  # port, 'transfer', 'datasheet' or variable, (stage, cell)
    sheets: tuple[Sheet, ...] = ()
    transfers: tuple[Transfer, ...] = ()
    found: tuple[Found, ...] = ()  # what each of them awaits; (): none does
    bands: tuple[float, ...] = ()
    channel_weights: Summed | None = None
    chains: tuple[
        tuple[int, ...], ...
    ] = ()  # for each of ``transfers``: which of them it stands behind, itself last; (): all before it
    whole: tuple[
        bool, ...
    ] = ()  # for each of ``transfers``: nothing else has moved light in front of it; (): so for all
    rendered: tuple[float, float] | None = None  # with what the scene in front of them was drawn
    light: tuple[float, ...] | None = None  # of white, by band, in front of the pixel
    grids: Mapping[str, tuple[Grid, ...]] = field(default_factory=dict)  # by port, of what is looked at


@dataclass(eq=False)
class Waiting:
    """What other cells find while the run goes on: quantities of the stage, and words of its random numbers."""

    found: Found = ()
    words: tuple[Open, ...] = ()
    seed: int = 0  # of the pipeline


@dataclass(eq=False)
class Mapped:
    """Dims in front of what a cell writes for which its stage is run one by one."""

    dims: tuple[tuple[str, Coordinate], ...]
    leading: Mapping[tuple[str, str], tuple[int, ...]]  # which of them lead a (stage, variable) that it depends on


class Look(Protocol):
    """What the caller makes of the arrays of a cell, where they are made."""

    def __call__(self, arrays: Mapping[str, Any]) -> dict[str, Any]: ...

    def gathering(self, variable: str, shape: tuple[int, ...]) -> Any:
        """What takes the rows of a variable in order, ``take(start, rows)``, and gives what stands in its place,
        ``made()``; or None.
        """


@dataclass(eq=False)
class Walk:
    """Cells of one large frame that are computed together, strip by strip: what only they read is never whole."""

    number: int
    members: int
    rows: int  # of a strip
    whole: tuple[str, ...] = ()  # of what this cell writes: what is kept, or read by others
    seen: tuple[str, ...] = ()  # of what this cell writes: what the caller only looks at
    places: Mapping[str, Any] = field(
        default_factory=dict
    )  # where the caller wants some of that put; in the caller's process only


@dataclass(eq=False)  # written once; freezing it would cost more than making it
class Job:
    """One cell to compute, or to load because something else reads it.

    ``task``: compute, or load (already stored; only read back, or its transform rebuilt).
    ``deliver``: the variables other jobs or the caller need as arrays, ``give``: those of the caller.
    """

    ref: CellRef
    task: str
    stage: Stage
    writes: Mapping[str, Declaration]
    grids: Mapping[str, Grid]
    input_grids: Mapping[str, Grid]
    inputs: Found
    left_out: bool
    seed: bytes
    pattern_of: bytes  # whose fixed patterns the stage is given
    precision: str
    store: tuple[str, ...]
    deliver: tuple[str, ...]
    target: Target | None
    seconds: float
    give: tuple[str, ...] | None = None  # of what is delivered: what the caller holds on to; None: all
    by_band: tuple[str, ...] = ()  # variables that are made and stored band by band
    segment: Segment | None = None
    looking: Looking | None = None
    waiting: Waiting | None = None
    mapped: Mapped | None = None
    expected: bool = False  # means in the place of draws and rounding
    walk: Walk | None = None
    look: Look | None = None  # what the caller makes of what it is given, where that is made

    form: Form | None = field(init=False, default=None, repr=False)  # once somebody asked ``run.form`` for it

    @property
    def averages(self) -> bool:
        """Whether the stage's mean stands in the place of its draw."""
        return self.expected and isinstance(self.stage, Sampled)

    @property
    def asks(self) -> tuple[str, ...]:
        """The names that ``run`` asks for."""
        kind = type(self.stage)
        return mean_arguments_of(kind) if self.expected and issubclass(kind, Sampled) else arguments_of(kind)

    @property
    def run(self) -> Any:
        """What is called with them."""
        return self.stage.mean if self.expected and isinstance(self.stage, Sampled) else self.stage.run

    @property
    def transform(self) -> bool:
        """Whether other jobs go on from its transform."""
        return self.segment is not None and self.segment.transform

    @cached_property
    def needs(self) -> tuple[CellRef, ...]:
        """The cells whose results this job reads."""
        if self.task == "load" and not self.transform:
            return ()
        refs = [ref for _, ref, _ in self.inputs]
        if self.segment and self.segment.previous is not None:
            refs[0] = self.segment.previous
        refs += self.awaited
        if self.looking:
            refs += [ref for _, what, pairs in self.looking.ports if not looks_at_stages(what) for _, ref in pairs]
        return tuple(dict.fromkeys(refs))

    @property
    def awaited(self) -> tuple[CellRef, ...]:
        """The cells that find something this job does not know yet."""
        if self.waiting is None and self.segment is None and self.looking is None:
            return ()
        every = [*(self.segment.found if self.segment else ()), *(self.looking.found if self.looking else ())]
        refs = [ref for found in every for _, ref, _ in found]
        if self.waiting:
            refs += [*(ref for _, ref, _ in self.waiting.found), *(word.ref for word in self.waiting.words)]
        return tuple(dict.fromkeys(refs))

    def without_stage(self) -> Job:
        """The same job for those who will not compute it: what its stage is cannot be said to another process."""
        return replace(self, stage=Stage(), segment=self.segment and replace(self.segment, joined=None), looking=None)
