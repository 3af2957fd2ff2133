"""A stage: a frozen value that says what it reads, writes and needs, and computes on plain arrays.

In:  class attributes and methods of ``Stage``.
Out: declarations, parameters and arguments of a class, found out once.

A stage class is a frozen, keyword-only dataclass deriving from ``Stage``; what it can do beyond ``run`` stands in the
typed bases of ``capabilities``, never in the name of an attribute.
"""

from __future__ import annotations

import dataclasses
import inspect
import os
import stat
import typing
from collections.abc import Callable, Hashable, Mapping
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from etendue.contract.dims import UNDECLARED, dim
from etendue.contract.facts import UNKNOWN, Facts
from etendue.contract.grid import Coordinate, Grid
from etendue.contract.names import unfit_variable
from etendue.contract.parameter import Parameter
from etendue.contract.variables import Declaration, parse_declaration
from etendue.plugins import discovery
from etendue.plugins.discovery import table_file

if TYPE_CHECKING:
    from etendue.types.arrays import Array

_Function = TypeVar("_Function", bound=Callable[..., Any])


def per_kind(function: _Function) -> _Function:
    """Remember what was found out about a class."""
    return cache(function)  # type: ignore[return-value]


COORDINATES = frozenset({"y", "x", "y_um", "x_um", "channel", "stage"})  # of dims that nobody need declare
SPECIAL = frozenset({"asked", "prepared", "rng"})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Stage:
    """Base of all stages. Class attributes are the declaration; every method but ``run`` may stay as it is here.

    Must be known: ``reads`` and ``writes`` (port to ``"dims [unit]"``), ``run``, parameters (``param``, ``quantity``),
    ``role``.

    ``run(self, <ports>, <coordinates>, prepared, rng, asked) -> {variable: array}`` names what it needs, fixed patterns
    too (``etendue_patterns``). A port whose argument has a default is optional. ``asked``: the optional variables that
    are asked for. Over dims that a stage does not declare it is mapped.

    ``role``: what it is an alternative to, in a word or two that stages of one kind share (``"sharpening"``,
    ``"glare"``, ``"resolution"``). Among stages that read and write the same, those of another role are not offered in
    each other's place; '' says nothing: what it reads and writes decides alone.
    ``creates``: coordinates of dims that nothing it reads has, such as ``{"channel": RGB}``, where ``grid`` has nothing
    to add. ``gain``: the largest factor by which an error, relative to the full scale of what is read, can grow
    relative to the full scale of what is written, for every allowed parameter value. ``None``: not known, so claims end
    here. ``nan`` and ``negative`` say what happens to such input: ``error`` (default), ``keep``, or ``clip`` (negative
    only). ``libraries`` names distributions whose version can change the result.
    ``nanoseconds``: what a value it writes costs, before it has ever been measured.
    ``working``: what it holds while it computes beside what it reads and writes, in times the larger of the two as
    floats of the run. ``pointwise``: no light changes its place, and factors change slowly over the frame: transfer
    functions in front and behind may be multiplied as if it were not there.
    ``elementwise``: every value follows from the values at its own place alone, so that many frames may be given to
    ``run`` at once. ``once``: physics that is met once on the way (``"diffraction"``, ``"fall-off"``): a second stage
    with the same on the way counts it twice, which the plan notes.
    ``decides``: by its nature it rounds, counts or chooses, so that a small change of what it is given may be a large
    one of what it gives. Of any other stage the conformance kit says where it jumps.
    ``keeps``: what it promises of its values, for the conformance kit: ``"order"`` (none falls where what is read
    rises), ``"sum"`` (what leaves one place arrives at another).
    ``unseen``: by figure that it writes, the roles of stages that change what the figure is about and cannot enter it.
    Where a pipeline has such stages, tables, plots and reports name them beside the figure.
    """

    reads: ClassVar[Mapping[str, str]] = {}
    writes: ClassVar[Mapping[str, str]] = {}
    role: ClassVar[str] = ""
    run: ClassVar[Any] = None
    creates: ClassVar[Mapping[str, Coordinate]] = {}
    gain: ClassVar[float | None] = None
    nan: ClassVar[str] = "error"
    negative: ClassVar[str] = "error"
    libraries: ClassVar[tuple[str, ...]] = ()
    nanoseconds: ClassVar[float] = 30.0
    working: ClassVar[float] = 1.0
    pointwise: ClassVar[bool] = False
    elementwise: ClassVar[bool] = False
    once: ClassVar[tuple[str, ...]] = ()
    decides: ClassVar[bool] = False
    keeps: ClassVar[tuple[str, ...]] = ()
    unseen: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    @property
    def common_draws(self) -> bool:
        """Whether random numbers are the same whatever the parameter values are."""
        return False

    def grid(self, inputs: Mapping[str, Grid]) -> Mapping[str, Grid]:
        """{variable: Grid} where the grid changes, from {port: Grid}."""
        return {}

    def prepare(self, coordinates: Mapping[str, Array]) -> Any:
        """Tables and matrices, once per (parameters, coordinates)."""
        return None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """What is known of what it writes, from {port: Facts} and {port: Grid}."""
        return UNKNOWN

    def error(self, facts: Any, grid: Mapping[str, Grid], precision: str) -> tuple[float | None, str]:
        """A bound relative to full scale, and how it is known: proved, fitted, measured. Literals:
        ``error = proved(2e-7, 4e-16)``.
        """
        return None, "unknown"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        """What a user should know about these values."""
        return []

    def warn_among(self, others: Mapping[str, type[Stage]]) -> list[str]:
        """The same about the stages of the pipeline: classes by the name of their use."""
        return []

    def assumes(self) -> Mapping[str, Hashable]:
        """What it takes for granted of things that others take for granted too; the plan notes where one before it
        has another value.
        """
        return {}


WORDS = frozenset(name for name in vars(Stage) if not name.startswith("_"))


def looks(declaration: Declaration) -> str:
    """What a port looks at in all earlier stages: ``transfer``, ``datasheet``, a variable, or '' where it reads one
    array.
    """
    return declaration.variable.removeprefix("*.") if declaration.variable.startswith("*.") else ""


def looks_at_stages(what: str) -> bool:
    """Whether it is the stages themselves that a port looks at, not what they write."""
    return what in ("transfer", "datasheet")


@per_kind
def reads_of(kind: type[Stage]) -> Mapping[str, Declaration]:
    return {port: parse_declaration(port, text) for port, text in kind.reads.items()}


@per_kind
def writes_of(kind: type[Stage]) -> Mapping[str, Declaration]:
    found = {port: parse_declaration(port, text) for port, text in kind.writes.items()}
    dims = {own for declaration in found.values() for own in declaration.dims}
    unfit = [
        f"it may write no {d.variable!r}: {why}" for d in found.values() if (why := unfit_variable(d.variable, dims))
    ]
    if unfit:
        raise ValueError("; ".join(unfit))
    return found


@per_kind
def parameters_of(kind: type[Stage]) -> Mapping[str, tuple[Parameter, Any, Any]]:
    """Parameter, type and default (``MISSING`` where it must be given) by name.

    Raises
    ------
    TypeError
        A parameter has the name of a word of the contract, such as ``gain``: its value would be taken for what the
        class says.
    """
    taken = sorted(WORDS & {field.name for field in dataclasses.fields(kind)})
    if taken:
        raise TypeError(
            f"the parameter {', '.join(taken)} has the name of a word that every stage has; give it another name"
        )
    hints = typing.get_type_hints(kind)
    return {
        field.name: (field.metadata.get("parameter", Parameter()), hints[field.name], field.default)
        for field in dataclasses.fields(kind)
    }


@per_kind
def quantities_of(kind: type[Stage]) -> Mapping[str, Parameter]:
    """The shared quantities that a stage takes: arguments that may be given, swept, or written by an earlier stage."""
    return {name: parameter for name, (parameter, _, _) in parameters_of(kind).items() if parameter.shared}


@per_kind
def arguments_of(kind: type[Stage]) -> tuple[str, ...]:
    """The names ``run`` asks for.

    Raises
    ------
    TypeError
        It has ``*args`` or ``**kwargs``: an argument nobody declared cannot be given. It asks for fixed patterns and
        not for whose.
    """
    names = () if kind.run is None else names_asked(kind, "run")
    patterns = _patterns_among(kind, names)
    for name, identity in patterns.items():
        if identity not in quantities_of(kind):
            hint = f'write {identity}: str = quantity("{identity}") among its parameters'
            raise TypeError(
                f"{kind.__name__}.run asks for {name}, whose patterns follow {identity}, but not for that: {hint}"
            )
    if len({*patterns.values()}) > 1:
        raise TypeError(f"{kind.__name__}.run asks for {', '.join(patterns)}; allowed are patterns of one kind")
    return names


def identity_of(name: str) -> str:
    """The quantity that says whose the patterns are that an argument of this name draws; '' of what is no pattern
    generator.
    """
    brought = discovery.installed().first("patterns", name)
    return str(brought.value) if brought is not None else ""


def _patterns_among(kind: type[Stage], names: tuple[str, ...]) -> dict[str, str]:
    found = {name: identity_of(name) for name in names if name not in {*kind.reads, *COORDINATES, *SPECIAL}}
    return {name: identity for name, identity in found.items() if identity}


@per_kind
def patterns_of(kind: type[Stage]) -> Mapping[str, str]:
    """The pattern generators that ``run`` asks for, each with the quantity that says whose patterns they are."""
    return _patterns_among(kind, arguments_of(kind))


def names_asked(kind: type[Stage], method: str) -> tuple[str, ...]:
    """The names that a method asks for, of those that ``run`` may be given."""
    names = []
    for parameter in list(inspect.signature(getattr(kind, method)).parameters.values())[1:]:
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            raise TypeError(f"{kind.__name__}.{method} takes *{parameter.name}; name every input")
        names.append(parameter.name)
    allowed = set(kind.reads) | COORDINATES | SPECIAL
    dims = frozenset(dim for one in (*reads_of(kind).values(), *writes_of(kind).values()) for dim in one.dims)
    unknown = [name for name in names if not (name in allowed or _is_coordinate(name, dims) or identity_of(name))]
    if unknown:
        raise TypeError(f"{kind.__name__}.{method} asks for {', '.join(unknown)}, which it does not read")
    return tuple(names)


def _is_coordinate(name: str, dims: frozenset[str]) -> bool:
    """Whether an argument is a coordinate of a dim that the stage names or a distribution declares, as it is read or
    written (``out_``): where its points stand, on the image plane (``_um``), or its edges, where it is one of bands."""
    own = name.removeprefix("out_")
    if own in COORDINATES or own in dims or own.removesuffix("_um") in dims:
        return True
    declared = dim(own.removesuffix("_edges"))
    return declared is not UNDECLARED and (declared.bins or not own.endswith("_edges"))


@per_kind
def optional_ports(kind: type[Stage]) -> frozenset[str]:
    """Ports that nobody need write: their arguments of ``run`` have a default."""
    given = inspect.signature(kind.run).parameters if kind.run is not None else {}
    return frozenset(
        name for name in kind.reads if name in given and given[name].default is not inspect.Parameter.empty
    )


def files_of(stage: Stage) -> dict[str, str]:
    """Paths of the files that parameters stand for."""
    values = {name: (parameter, getattr(stage, name)) for name, (parameter, _, _) in parameters_of(type(stage)).items()}
    paths = {
        name: file_behind(value, parameter) for name, (parameter, value) in values.items() if isinstance(value, str)
    }
    return {name: path for name, path in paths.items() if path}


def file_behind(value: str, parameter: Parameter) -> str:
    """The file that a value stands for, as it is named; of a table that a distribution brings its path; '' for what
    is no file.
    """
    return value if parameter.file else table_file(value) if parameter.table else ""


def file_state(path: str) -> tuple[int, int]:
    """Time and size of a file, or of all files of a folder: what is remembered of a path is forgotten when they
    change.
    """
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
    return stage, tuple(map(file_state, _paths(stage)))


@lru_cache(4096)
def _paths(stage: Stage) -> tuple[str, ...]:
    return tuple(files_of(stage).values())
