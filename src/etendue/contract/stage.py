"""A stage: a frozen value that states what it reads, writes and needs, and computes on plain arrays.

In:  class attributes and methods of ``Stage``.
Out: declarations, parameters and arguments of a class, each determined once.

A stage class is a frozen, keyword-only dataclass deriving from ``Stage``. Capabilities beyond ``run`` are declared by
the typed bases in ``capabilities``, never by the name of an attribute.
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

from etendue.contract.arrays.dims import UNDECLARED, dim
from etendue.contract.arrays.facts import UNKNOWN, Facts
from etendue.contract.arrays.grid import Coordinate, Grid
from etendue.contract.arrays.variables import Declaration, parse_declaration
from etendue.contract.values.names import unfit_variable
from etendue.contract.values.parameter import Parameter
from etendue.plugins import discovery
from etendue.plugins.discovery import table_file

if TYPE_CHECKING:
    from etendue.types.arrays import Array

_Function = TypeVar("_Function", bound=Callable[..., Any])


def per_kind(function: _Function) -> _Function:
    """Cache a function of a class."""
    return cache(function)  # type: ignore[return-value]


COORDINATES = frozenset({"y", "x", "y_um", "x_um", "channel", "stage"})  # of dims that need no declaration
SPECIAL = frozenset({"asked", "prepared", "rng"})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Stage:
    """Base of all stages. Class attributes are the declaration; every method except ``run`` has a usable default.

    Required: ``reads`` and ``writes`` (port to ``"dims [unit]"``), ``run``, parameters (``param``, ``quantity``),
    ``role``.

    ``run(self, <ports>, <coordinates>, prepared, rng, asked) -> {variable: array}`` names the arguments it needs,
    including fixed patterns (``etendue_patterns``). A port whose argument has a default is optional. ``asked``: the
    optional variables that are requested. A stage is mapped over dims that it does not declare.

    Attributes
    ----------
    role : a name shared by stages that can replace each other (``"sharpening"``, ``"glare"``, ``"resolution"``). Stages
        that read and write the same variables are offered as replacements only within one role; for a stage with the
        role '', only the variables that it reads and writes are compared
    creates : coordinates of output dims that no input has, such as ``{"channel": RGB}``, if ``grid`` adds nothing
    gain : the largest factor by which an error can grow from input to output, both relative to full scale, for every
        allowed parameter value; None: unknown, so no error bound is given after this stage
    nan, negative : treatment of undefined and of negative input: ``error`` (default), ``keep``, or ``clip`` (negative
        only)
    libraries : distributions whose version can change the result
    nanoseconds : time per value written, used until it has been measured
    working : memory used while computing, apart from input and output, as a multiple of the larger of the two in floats
        of the run
    pointwise : the stage multiplies light by factors that vary slowly over the frame, and does not move light. Transfer
        functions before and after it may therefore be multiplied as if it were absent
    elementwise : every value depends only on values at its own position, so ``run`` may receive many frames at once
    once : physics that should occur once along a path (``"diffraction"``, ``"fall-off"``); the plan has a note if a
        second stage declares the same
    decides : the stage rounds, counts or chooses, so that a small change of its input may change its output strongly;
        or {parameter: values with which the stage does so}. For any other stage the conformance kit reports jumps
    handed : the stage treats left and right, or up and down, differently, as a stage does that moves or shears the
        picture. For any other stage the kit requires the mirrored result for mirrored input
    keeps : properties of the output that the conformance kit tests: ``"order"`` (no value falls if the input rises),
        ``"sum"`` (the sum over the frame stays the same)
    unseen : by metric that the stage writes, the roles of stages that affect the subject of the metric but cannot be
        included in the metric. Tables, plots and reports name such stages of a pipeline beside the metric
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
    decides: ClassVar[bool | Mapping[str, tuple[Any, ...]]] = False
    handed: ClassVar[bool] = False
    keeps: ClassVar[tuple[str, ...]] = ()
    unseen: ClassVar[Mapping[str, tuple[str, ...]]] = {}

    @property
    def common_draws(self) -> bool | str:
        """Whether the stage draws the same random numbers for all parameter values; a text selects one of many such
        sets of numbers."""
        return False

    def grid(self, inputs: Mapping[str, Grid]) -> Mapping[str, Grid]:
        """Return {variable: Grid} for variables whose grid changes, from {port: Grid}."""
        return {}

    def prepare(self, coordinates: Mapping[str, Array]) -> Any:
        """Return tables and matrices, computed once per (parameters, coordinates)."""
        return None

    def carry(self, facts: Mapping[str, Facts], grid: Mapping[str, Grid]) -> Facts:
        """Return the facts of the stage's output, from {port: Facts} and {port: Grid} of its inputs."""
        return UNKNOWN

    def growth(self, facts: Mapping[str, Facts]) -> float:
        """Return the largest factor by which a change grows from input (relative to the largest input value) to output
        (relative to full scale); ``facts``: known properties of the inputs by port. Clipping and gains make the factor
        larger than 1. ``inf``: there is no bound.
        """
        return 1.0

    def error(self, facts: Any, grid: Mapping[str, Grid], precision: str) -> tuple[float | None, str]:
        """Return an error bound relative to full scale, and its basis: proved, fitted, measured. For constants:
        ``error = proved(2e-7, 4e-16)``.
        """
        return None, "unknown"

    def warn(self, facts: Facts, grids: Mapping[str, Grid]) -> list[str]:
        """Return notes for the user about these parameter values, facts and grids."""
        return []

    def warn_among(self, others: Mapping[str, type[Stage]]) -> list[str]:
        """Return notes about the other stages of the pipeline, given as classes by the name under which they
        are used.
        """
        return []

    def assumes(self) -> Mapping[str, Hashable]:
        """Return the assumptions of the stage, a value for each topic; the plan has a note if an earlier stage assumes
        another value for the same topic.
        """
        return {}


WORDS = frozenset(name for name in vars(Stage) if not name.startswith("_"))


def looks(declaration: Declaration) -> str:
    """Return the property of all earlier stages that a port reads: ``transfer``, ``datasheet`` or a variable; '' if the
    port reads one array.
    """
    return declaration.variable.removeprefix("*.") if declaration.variable.startswith("*.") else ""


def looks_at_stages(what: str) -> bool:
    """Return whether a port looks at the stages themselves, not at their outputs."""
    return what in ("transfer", "datasheet")


@per_kind
def reads_of(kind: type[Stage]) -> Mapping[str, Declaration]:
    return {port: parse_declaration(port, text) for port, text in kind.reads.items()}


@per_kind
def writes_of(kind: type[Stage]) -> Mapping[str, Declaration]:
    found = {port: parse_declaration(port, text) for port, text in kind.writes.items()}
    dims = {own for declaration in found.values() for own in declaration.dims}
    unfit = [f"cannot write {d.variable!r}: {why}" for d in found.values() if (why := unfit_variable(d.variable, dims))]
    if unfit:
        raise ValueError("; ".join(unfit))
    return found


@per_kind
def parameters_of(kind: type[Stage]) -> Mapping[str, tuple[Parameter, Any, Any]]:
    """Return parameter, type and default (``MISSING`` if it must be given), by name.

    Raises
    ------
    TypeError
        If a parameter has the name of an attribute of ``Stage``, such as ``gain``: its value would replace the
        declaration of the class.
    """
    taken = sorted(WORDS & {field.name for field in dataclasses.fields(kind)})
    if taken:
        raise TypeError(f"the parameter {', '.join(taken)} has the name of an attribute of Stage; give it another name")
    hints = typing.get_type_hints(kind)
    return {
        field.name: (field.metadata.get("parameter", Parameter()), hints[field.name], field.default)
        for field in dataclasses.fields(kind)
    }


@per_kind
def quantities_of(kind: type[Stage]) -> Mapping[str, Parameter]:
    """Return the shared quantities that a stage takes; they may be given, swept, or written by an earlier stage."""
    return {name: parameter for name, (parameter, _, _) in parameters_of(kind).items() if parameter.shared}


@per_kind
def arguments_of(kind: type[Stage]) -> tuple[str, ...]:
    """Return the argument names of ``run``.

    Raises
    ------
    TypeError
        If ``run`` has ``*args`` or ``**kwargs``, because an argument that is not declared cannot be passed; or if it
        takes fixed patterns but not the quantity that identifies their owner.
    """
    names = () if kind.run is None else names_asked(kind, "run")
    patterns = _patterns_among(kind, names)
    for name, identity in patterns.items():
        if identity not in quantities_of(kind):
            hint = f'add {identity}: str = quantity("{identity}") to its parameters'
            raise TypeError(
                f"{kind.__name__}.run asks for {name}, whose patterns depend on {identity}, but has no such parameter: "
                f"{hint}"
            )
    if len({*patterns.values()}) > 1:
        raise TypeError(f"{kind.__name__}.run asks for {', '.join(patterns)}; allowed: patterns of one kind")
    return names


def identity_of(name: str) -> str:
    """Return the quantity that identifies the owner of the fixed patterns that an argument of this name generates; ''
    if the argument is not a pattern generator.
    """
    brought = discovery.installed().first("patterns", name)
    return str(brought.value) if brought is not None else ""


def _patterns_among(kind: type[Stage], names: tuple[str, ...]) -> dict[str, str]:
    found = {name: identity_of(name) for name in names if name not in {*kind.reads, *COORDINATES, *SPECIAL}}
    return {name: identity for name, identity in found.items() if identity}


@per_kind
def patterns_of(kind: type[Stage]) -> Mapping[str, str]:
    """Return the pattern generators among the arguments of ``run``, each with the quantity that identifies the owner of
    its patterns.
    """
    return _patterns_among(kind, arguments_of(kind))


def names_asked(kind: type[Stage], method: str) -> tuple[str, ...]:
    """Return the argument names of a method that are among the possible arguments of ``run``."""
    names = []
    for parameter in list(inspect.signature(getattr(kind, method)).parameters.values())[1:]:
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            raise TypeError(f"{kind.__name__}.{method} takes *{parameter.name}; name every argument instead")
        names.append(parameter.name)
    allowed = set(kind.reads) | COORDINATES | SPECIAL
    dims = frozenset(dim for one in (*reads_of(kind).values(), *writes_of(kind).values()) for dim in one.dims)
    unknown = [name for name in names if not (name in allowed or _is_coordinate(name, dims) or identity_of(name))]
    if unknown:
        raise TypeError(f"{kind.__name__}.{method} asks for {', '.join(unknown)}, which it does not read")
    return tuple(names)


def _is_coordinate(name: str, dims: frozenset[str]) -> bool:
    """Return whether an argument is a coordinate of a dim that the stage uses or a distribution declares: positions,
    positions on the image plane (``_um``), or edges of bands (``_edges``); ``out_`` marks coordinates of outputs.
    """
    own = name.removeprefix("out_")
    if own in COORDINATES or own in dims or own.removesuffix("_um") in dims:
        return True
    declared = dim(own.removesuffix("_edges"))
    return declared is not UNDECLARED and (declared.bins or not own.endswith("_edges"))


@per_kind
def optional_ports(kind: type[Stage]) -> frozenset[str]:
    """Return the ports that need no writer: their arguments of ``run`` have a default."""
    given = inspect.signature(kind.run).parameters if kind.run is not None else {}
    return frozenset(
        name for name in kind.reads if name in given and given[name].default is not inspect.Parameter.empty
    )


def files_of(stage: Stage) -> dict[str, str]:
    """Return the paths of the files that parameters name."""
    values = {name: (parameter, getattr(stage, name)) for name, (parameter, _, _) in parameters_of(type(stage)).items()}
    paths = {
        name: file_behind(value, parameter) for name, (parameter, value) in values.items() if isinstance(value, str)
    }
    return {name: path for name, path in paths.items() if path}


def file_behind(value: str, parameter: Parameter) -> str:
    """Return the path of the file that a value names, as a path or as a table of a distribution; '' if it names no
    file.
    """
    return value if parameter.file else table_file(value) if parameter.table else ""


def file_state(path: str) -> tuple[int, int]:
    """Return modification time and size of a file, or of all files of a folder; if they change, results cached for the
    path are invalid.
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
    """Return a stage and the state of its files, as a cache key within a process."""
    return stage, tuple(map(file_state, _paths(stage)))


@lru_cache(4096)
def _paths(stage: Stage) -> tuple[str, ...]:
    return tuple(files_of(stage).values())
