"""A job: everything needed to compute one cell, independent of the plan. A plain value that can be sent to another
process.

In:  the plan of a cell, in the process that owns the run.
Out: ``Job``, with additions for segments, looking at other stages, waiting for values found during the run, and running
     in slices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

from etendue.contract.arrays.grid import Coordinate, Grid
from etendue.contract.arrays.variables import Declaration
from etendue.contract.capabilities import Sampled, Sheet, Summed, Transfer, mean_arguments_of
from etendue.contract.ports import Target
from etendue.contract.stage import Stage, arguments_of, looks_at_stages
from etendue.plan.expansion.seed_words import Open
from etendue.plan.model import CellRef
from etendue.types.arrays import CellArrays

# (quantity, cell, variable): where the value of a shared quantity is found
if TYPE_CHECKING:
    from etendue.compute.form import StageForm

Found = tuple[tuple[str, CellRef, str], ...]


@dataclass(eq=False)
class Segment:
    """How a cell of a transfer function is computed: from the transform of the preceding cell, or from the segment's
    input and the stages between that input and the cell.
    """

    previous: CellRef | None = None
    joined: tuple[Transfer, ...] | None = None  # set if it reads the segment's input itself
    found: tuple[Found, ...] = ()  # values found during the run, for each of these; () if there are none
    transform: bool = False  # whether other cells continue from its transform
    source: str = ""  # key of the segment's input, if that is read itself
    seen: bool = False  # whether the caller only reduces its large array, band by band


@dataclass(eq=False)
class Looking:
    """For a stage that looks at other stages: the variables or transfer functions that it sees through each port."""

    ports: tuple[
        tuple[str, str, tuple[tuple[str, CellRef], ...]], ...
    ] = ()  # port, 'transfer', 'datasheet' or variable, (stage, cell)
    sheets: tuple[Sheet, ...] = ()
    transfers: tuple[Transfer, ...] = ()
    found: tuple[Found, ...] = ()  # values found during the run, for each of these; () if there are none
    bands: tuple[float, ...] = ()
    channel_weights: Summed | None = None
    chains: tuple[
        tuple[int, ...], ...
    ] = ()  # for each of ``transfers``: the ones up to it, itself last; (): all before it
    whole: tuple[
        bool, ...
    ] = ()  # for each of ``transfers``: whether nothing else has moved light before it; (): True for all
    rendered: tuple[float, float] | None = None  # softness and cell with which the scene was rendered
    light: tuple[float, ...] | None = None  # light of a white surface, by band, in front of the pixel
    grids: Mapping[str, tuple[Grid, ...]] = field(default_factory=dict)  # by port: the grids of the variables looked at


@dataclass(eq=False)
class Waiting:
    """Values that other cells find during the run: quantities of the stage, and words of its random seed."""

    found: Found = ()
    words: tuple[Open, ...] = ()
    seed: int = 0  # of the pipeline


@dataclass(eq=False)
class Mapped:
    """Leading dims of the outputs of a cell, over which its stage is run slice by slice."""

    dims: tuple[tuple[str, Coordinate], ...]
    leading: Mapping[tuple[str, str], tuple[int, ...]]  # positions of those that lead a (stage, variable) it depends on


class CellObserver(Protocol):
    """The caller's reduction of the arrays of a cell, applied where they are computed."""

    def __call__(self, arrays: Mapping[str, Any]) -> CellArrays: ...

    def gathering(self, variable: str, shape: tuple[int, ...]) -> Any:
        """Return an object that reduces a variable row by row: ``take(start, rows)`` receives its rows in order,
        ``made()`` returns the reduced variable. Return None if the whole variable is needed at once.
        """


@dataclass(eq=False)
class Walk:
    """Cells of one large frame that are computed together, strip by strip. Arrays that only these cells read are never
    held as a whole.
    """

    number: int
    members: int
    rows: int  # of a strip
    whole: tuple[str, ...] = ()  # outputs of this cell that are stored, or read from outside the walk
    seen: tuple[str, ...] = ()  # outputs of this cell of which the caller needs only a reduction
    places: Mapping[str, Any] = field(
        default_factory=dict
    )  # the caller's arrays for some of these; in the caller's process only


@dataclass(eq=False)  # never changed after creation; freezing it would cost more than creating it
class Job:
    """One cell to compute, or to load because something else reads it.

    ``task``: compute, or load (the cell is stored already: it is only read, or its transform is rebuilt).
    ``deliver``: the variables that other jobs or the caller need as arrays; ``give``: the variables that the caller
    needs.
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
    pattern_of: bytes  # owner of the fixed patterns of the stage
    precision: str
    store: tuple[str, ...]
    deliver: tuple[str, ...]
    target: Target | None
    seconds: float
    give: tuple[str, ...] | None = None  # the variables of ``deliver`` that the caller keeps; None for all
    by_band: tuple[str, ...] = ()  # variables that are computed and stored band by band
    segment: Segment | None = None
    looking: Looking | None = None
    waiting: Waiting | None = None
    mapped: Mapped | None = None
    expected: bool = False  # means instead of draws and rounding
    walk: Walk | None = None
    look: CellObserver | None = None  # the caller's reduction of its arrays, applied where they are computed
    steps: Mapping[str, float] = field(default_factory=dict)  # by variable: the step of which its floats are multiples
    # the caller's arrays for some of ``give``, where it has them; in the caller's process only
    places: Mapping[str, Any] = field(default_factory=dict)
    passes: tuple[str, ...] = ()  # for a left-out cell: its variables that are arrays of its input

    form: StageForm | None = field(init=False, default=None, repr=False)  # set on first use by ``compute.form``

    @property
    def averages(self) -> bool:
        """Whether the stage returns its mean instead of a random draw."""
        return self.expected and isinstance(self.stage, Sampled)

    @property
    def asks(self) -> tuple[str, ...]:
        """The argument names of ``run``."""
        kind = type(self.stage)
        return mean_arguments_of(kind) if self.expected and issubclass(kind, Sampled) else arguments_of(kind)

    @property
    def run(self) -> Any:
        """The function to call with these arguments."""
        return self.stage.mean if self.expected and isinstance(self.stage, Sampled) else self.stage.run

    @property
    def transform(self) -> bool:
        """Whether other jobs continue from its transform."""
        return self.segment is not None and self.segment.transform

    @cached_property
    def needs(self) -> tuple[CellRef, ...]:
        """The cells whose results this job reads."""
        if self.task == "load" and not (self.transform or self.passes):
            return ()
        refs = [ref for _, ref, _ in self.inputs]
        if self.segment and self.segment.previous is not None:
            refs = [self.segment.previous, *refs[1:]]
        refs += self.awaited
        if self.looking:
            refs += [ref for _, what, pairs in self.looking.ports if not looks_at_stages(what) for _, ref in pairs]
        return tuple(dict.fromkeys(refs))

    @property
    def reads(self) -> frozenset[tuple[CellRef, str]]:
        """The variables that this job reads, each with its cell."""
        if not self.needs:
            return frozenset()
        continues = self.segment is not None and self.segment.previous is not None
        found = {(ref, variable) for _, ref, variable in self.inputs[continues:]}
        if self.looking:
            found |= {(ref, w) for _, w, pairs in self.looking.ports if not looks_at_stages(w) for _, ref in pairs}
        every = [*(self.segment.found if self.segment else ()), *(self.looking.found if self.looking else ())]
        if self.waiting:
            every.append(self.waiting.found)
            found |= {(word.ref, word.variable) for word in self.waiting.words}
        return frozenset(found | {(ref, variable) for one in every for _, ref, variable in one})

    @property
    def awaited(self) -> tuple[CellRef, ...]:
        """The cells that find values this job does not know yet."""
        if self.waiting is None and self.segment is None and self.looking is None:
            return ()
        every = [*(self.segment.found if self.segment else ()), *(self.looking.found if self.looking else ())]
        refs = [ref for found in every for _, ref, _ in found]
        if self.waiting:
            refs += [*(ref for _, ref, _ in self.waiting.found), *(word.ref for word in self.waiting.words)]
        return tuple(dict.fromkeys(refs))

    def without_stage(self) -> Job:
        """Return the job without its stage, for processes that will not compute it; a stage may not be picklable."""
        return replace(self, stage=Stage(), segment=self.segment and replace(self.segment, joined=None), looking=None)
