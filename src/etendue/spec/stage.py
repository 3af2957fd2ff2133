"""A stage: a frozen value that says what it reads, writes and needs, and computes on plain arrays.

A stage class is a frozen, keyword-only dataclass deriving from ``Stage``. Optional methods say more about it; the
engine looks for them by name and treats their absence as "not known":

    describe(self) -> (Facts, {variable: Grid})          sources only: what it will write, before any array
    grid(self, inputs) -> {variable: Grid}               stages that change the grid; ``inputs``: {port: Grid}
    prepare(self, coordinates) -> anything               tables and matrices, once per (parameters, coordinates)
    transfer(self, fy, fx, wavelength) -> array          linear shift-invariant stages, instead of ``run``
    weights(self, prepared) -> (channel, wavelength)     a transfer stage that ends in a sum over wavelength
    by_band(self, prepared, bands) -> prepared           its run may be given some bands: what is prepared for them
    constants(self, prepared) -> {variable: array}       sources with by_band: what they write that has no place
    segment_error(self, before, grid, precision)         an end of a segment: its error behind the stages joined before it
    warn(self, facts, grids) -> [text]                   what a user should know about these values
    warn_among(self, kinds) -> [text]                    the same, about the stages of the pipeline: {name: class}; ask for roles and bases
    assumes(self) -> {what: value}                       what it takes for granted of things that other stages take for granted too;
                                                         where a stage in front of it has another value, the plan notes it
    run(self, <ports...>, <coordinates...>, prepared, rng, rng_sensor) -> {variable: array}
    negligible(self, facts, grid) -> float | None        how wrong leaving it out is, in units of its variable
    carry(self, facts, grid) -> Facts                    facts of what it writes, from facts of what it reads
    error(self, facts, grid, precision) -> (bound, how)  relative to full scale; how: proved | fitted | measured
    gain                                                 see below

Any stage may read ``"*.transfer [1]"``: its port is given the transfer functions of the camera in front of it, see ``Probe``.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import os
import stat
import typing
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, ClassVar, TypeVar

from etendue.spec.grid import Bands, Labels, Line
from etendue.spec.names import unfit_variable
from etendue.spec.variables import Declaration, parse_declaration

MISSING = dataclasses.MISSING
_Function = TypeVar("_Function", bound=Callable[..., Any])


def per_kind(function: _Function) -> _Function:
    """Remember what was found out about a class."""
    return cache(function)  # type: ignore[return-value]


@per_kind
def has_method(kind: type[Stage], name: str) -> bool:
    """Whether a class of stages has a method of this name.

    A parameter of that name is none, even where its default stands on the class: what a stage can do is said by its methods, and
    the names of its parameters are its author's own.
    """
    return name not in _fields(kind) and callable(getattr(kind, name, None))


def word_of(stage: Stage | type[Stage], name: str, default: Any) -> Any:
    """What a stage or its class says under a name; a parameter of that name says nothing."""
    kind = stage if isinstance(stage, type) else type(stage)
    return default if name in _fields(kind) else getattr(stage, name, default)


@per_kind
def _fields(kind: type[Stage]) -> frozenset[str]:
    return frozenset(field.name for field in dataclasses.fields(kind))


COORDINATES = frozenset(
    f"{prefix}{name}" for prefix in ("", "out_") for name in ("wavelength", "wavelength_edges", "y", "x", "y_um", "x_um", "channel")
) | {"stage"}
SPECIAL = frozenset({"prepared", "rng", "rng_sensor"})


@dataclasses.dataclass(frozen=True)
class Parameter:
    """What is allowed for one parameter, beside its type."""

    units: str = "1"
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    choices: tuple[str, ...] | None = None
    camera: bool = False
    fidelity: bool = False
    reference: str = ""
    file: bool = False  # the path of a file
    folder: bool = False  # of a file or a folder
    table: bool = False  # a name, or the path of a CSV file
    along: str = ""  # mapped over this dim, a stage has the label of its slice in the place of the value
    held: tuple[float, float] | None = None  # ends beyond which its stages do not compute: the plan refuses, with the reason
    length: int | None = None
    one_for_all: bool = False  # a list that may be written as the one number in it
    infinite: bool = False
    doc: str = ""

    def range_text(self) -> str:
        """The allowed range in words, '' when everything is."""
        parts = []
        for word, limit in (("above", self.above), ("at least", self.at_least), ("below", self.below), ("at most", self.at_most)):
            if limit is not None:
                parts.append(f"{word} {limit:g}")
        text = " and ".join(parts)
        return f"{text} {self.units}".strip() if text and self.units not in ("1", "") else text

    def shown_range(self) -> str:
        """The range, and within which of it the stages compute."""
        if self.held is None:
            return self.range_text()
        return f"{self.range_text()}; computed from {self.held[0]:g} to {self.held[1]:g}".removeprefix("; ")

    def allows(self, value: float) -> bool:
        return (
            (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.below is None or value < self.below)
            and (self.at_most is None or value <= self.at_most)
        )


def param(default: Any = MISSING, **allowed: Any) -> Any:
    """Declare a parameter of a stage: its default, unit, range and role (see ``Parameter``)."""
    parameter = Parameter(**allowed)
    if parameter.fidelity and not parameter.reference:
        raise TypeError("a fidelity parameter names its reference: param(..., fidelity=True, reference='...')")
    return (
        dataclasses.field(default=default, metadata={"parameter": parameter})
        if default is not MISSING
        else dataclasses.field(metadata={"parameter": parameter})
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Stage:
    """Base of all stages. Class attributes are the declaration.

    ``gain``: the largest factor by which an error, relative to the full scale of what is read, can grow relative to
    the full scale of what is written, for every allowed parameter value. ``None``: not known, so claims end here.
    ``nan`` and ``negative`` say what happens to such input: ``error`` (default), ``keep``, or ``clip`` (negative only).
    ``libraries`` names distributions whose version can change the result.
    ``radial``: the transfer function depends on the size of the frequency alone.
    ``pointwise``: no light changes its place, and factors change slowly over the frame: transfer functions in front and behind
    may be multiplied as if it were not there.
    ``role``: what it is an alternative to, in a word or two that stages of one kind share (``"demosaicing"``, ``"sharpening"``,
    ``"lens"``). Among stages that read and write the same, those of another role are not offered in each other's place; '' says
    nothing: what it reads and writes decides alone.
    ``once``: physics that is met once on the way through the camera (``"diffraction"``, ``"fall-off"``): a second stage with the same
    on the way counts it twice, which the plan notes.
    """

    reads: ClassVar[Mapping[str, str]] = {}
    writes: ClassVar[Mapping[str, str]] = {}
    gain: ClassVar[float | None] = None
    nan: ClassVar[str] = "error"
    negative: ClassVar[str] = "error"
    libraries: ClassVar[tuple[str, ...]] = ()
    radial: ClassVar[bool] = False
    pointwise: ClassVar[bool] = False
    role: ClassVar[str] = ""
    once: ClassVar[tuple[str, ...]] = ()

    @property
    def common_draws(self) -> bool:
        """Whether random numbers are the same whatever the parameter values are."""
        return False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Probe(Stage):
    """A stage that looks at all stages in order: reads ``"*.transfer"`` or ``"*.<variable>"``.

    ``run`` gets, for each such port, a list of (stage name, what it looks at): the transfer function up to and including
    that stage (``etendue.run.otf.Otf``), or the array itself; with ``with_grids`` arrays come as (stage name, array, grid).
    Nothing reads from a probe. It may write the dim ``stage``: every stage it looks at, in order, whose names ``run`` may ask
    for as ``stage``; those seen through the ports in ``beside`` alone have no place in it.
    """

    with_grids: ClassVar[bool] = False
    beside: ClassVar[tuple[str, ...]] = ()


WORDS = frozenset(name for kind in (Stage, Probe) for name in vars(kind) if not name.startswith("_"))


def looks(declaration: Declaration) -> str:
    """What a port looks at in all earlier stages: ``transfer``, a variable, or '' where it reads one array."""
    return declaration.variable.removeprefix("*.") if declaration.variable.startswith("*.") else ""


@per_kind
def reads_of(kind: type[Stage]) -> Mapping[str, Declaration]:
    return {port: parse_declaration(port, text) for port, text in kind.reads.items()}


@per_kind
def writes_of(kind: type[Stage]) -> Mapping[str, Declaration]:
    found = {port: parse_declaration(port, text) for port, text in kind.writes.items()}
    dims = {dim for declaration in found.values() for dim in declaration.dims}
    unfit = [f"it may write no {d.variable!r}: {why}" for d in found.values() if (why := unfit_variable(d.variable, dims))]
    if unfit:
        raise ValueError("; ".join(unfit))
    return found


@per_kind
def parameters_of(kind: type[Stage]) -> Mapping[str, tuple[Parameter, Any, Any]]:
    """Parameter, type and default (``MISSING`` where it must be given) by name.

    Raises
    ------
    TypeError
        A parameter has the name of a word of the contract, such as ``gain``: its value would be taken for what the class says.
    """
    taken = sorted(WORDS & {field.name for field in dataclasses.fields(kind)})
    if taken:
        raise TypeError(f"the parameter {', '.join(taken)} has the name of a word that every stage has; give it another name")
    hints = typing.get_type_hints(kind)
    return {
        field.name: (field.metadata.get("parameter", Parameter()), hints[field.name], field.default) for field in dataclasses.fields(kind)
    }


@per_kind
def quantities_of(kind: type[Stage]) -> Mapping[str, Parameter]:
    """The camera quantities that a stage takes: arguments that may be given, swept, or written by an earlier stage."""
    return {name: parameter for name, (parameter, _, _) in parameters_of(kind).items() if parameter.camera}


@per_kind
def arguments_of(kind: type[Stage]) -> tuple[str, ...]:
    """The names ``run`` asks for. ``*args`` and ``**kwargs`` are refused: an argument nobody declared cannot be given."""
    if not has_method(kind, "run"):
        return ()
    names = []
    for parameter in list(inspect.signature(kind.run).parameters.values())[1:]:  # type: ignore[attr-defined]
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            raise TypeError(f"{kind.__name__}.run takes *{parameter.name}; name every input")
        names.append(parameter.name)
    allowed = set(kind.reads) | COORDINATES | SPECIAL
    unknown = [name for name in names if name not in allowed]
    if unknown:
        raise TypeError(f"{kind.__name__}.run asks for {', '.join(unknown)}, which it does not read")
    return tuple(names)


@per_kind
def optional_ports(kind: type[Stage]) -> frozenset[str]:
    """Ports that nobody need write: their arguments of ``run`` have a default."""
    given = inspect.signature(kind.run).parameters if has_method(kind, "run") else {}  # type: ignore[attr-defined]
    return frozenset(name for name in kind.reads if name in given and given[name].default is not inspect.Parameter.empty)


def check_class(kind: type[Stage]) -> None:
    """What a class says of itself beside its ports, held against the form that the engine reads; ``TypeError`` where it is another."""
    name, gain, creates = kind.__name__, kind.gain, getattr(kind, "creates", {})
    number = isinstance(gain, int | float) and not isinstance(gain, bool) and math.isfinite(gain) and gain >= 0
    if gain is not None and not number:
        raise TypeError(f"{name}.gain is {gain!r}; allowed are None and finite numbers from 0")
    for attribute, words in (("nan", ("error", "keep")), ("negative", ("error", "keep", "clip"))):
        if getattr(kind, attribute) not in words:
            raise TypeError(f"{name}.{attribute} is {getattr(kind, attribute)!r}; allowed are {', '.join(map(repr, words))}")
    if isinstance(kind.libraries, str) or not all(isinstance(text, str) for text in kind.libraries):
        raise TypeError(f"{name}.libraries is {kind.libraries!r}; expected names of distributions, such as ('scipy',)")
    if not isinstance(creates, Mapping) or not all(isinstance(value, Line | Bands | Labels) for value in creates.values()):
        raise TypeError(f"{name}.creates is {creates!r}; expected dims and their coordinates, such as {{'channel': RGB}}")
    if not has_method(kind, "run") and not has_method(kind, "transfer"):
        raise TypeError(f"{name} has neither run nor transfer: nothing would be computed")
    rate = getattr(kind, "nanoseconds", 1.0)
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not rate > 0:
        raise TypeError(f"{name}.nanoseconds is {rate!r}; expected a number above 0")
    for attribute in ("run", "transfer", "grid", "describe", "carry", "error", "negligible", "prepare", "warn", "warn_among"):
        if hasattr(kind, attribute) and not callable(getattr(kind, attribute)):
            raise TypeError(f"{name}.{attribute} is {getattr(kind, attribute)!r}; expected a method")


def is_source(kind: type[Stage]) -> bool:
    return has_method(kind, "describe")


def is_transfer(kind: type[Stage]) -> bool:
    return has_method(kind, "transfer")


def ends_in_sum(kind: type[Stage]) -> bool:
    return has_method(kind, "weights")


def is_random(kind: type[Stage]) -> bool:
    return bool({"rng", "rng_sensor"} & set(arguments_of(kind)))


def resolved_parameters(stage: Stage) -> dict[str, Any]:
    """Every parameter with its value, in declared order."""
    return {field.name: getattr(stage, field.name) for field in dataclasses.fields(stage)}


def files_of(stage: Stage) -> dict[str, str]:
    """Paths of the files that parameters name."""
    values = {name: (parameter, getattr(stage, name)) for name, (parameter, _, _) in parameters_of(type(stage)).items()}
    return {
        name: value
        for name, (parameter, value) in values.items()
        if isinstance(value, str) and value and (parameter.file or (parameter.table and value.endswith(".csv")))
    }


def file_state(path: str) -> tuple[int, int]:
    """Time and size of a file, or of all files of a folder: what is remembered of a path is forgotten when they change."""
    try:
        found = os.stat(path)
        if not stat.S_ISDIR(found.st_mode):
            return (found.st_mtime_ns, found.st_size)
        inside = [os.stat(os.path.join(folder, name)) for folder, _, names in os.walk(path) for name in names]
    except OSError:
        return (0, 0)
    return (max((f.st_mtime_ns for f in inside), default=found.st_mtime_ns), sum(f.st_size for f in inside))


def state_of(stage: Stage) -> tuple[Stage, tuple[tuple[int, int], ...]]:
    """A stage together with the state of its files: what a cache of a process may be keyed by."""
    return stage, tuple(file_state(path) for path in files_of(stage).values())
