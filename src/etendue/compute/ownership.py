"""Ensure that arrays cannot be changed by others, and that stages leave the process as they found it.

In:  an array returned by a stage.
Out: the same values, contiguous, in memory to which no other code has a reference; read-only views of it for readers.

In numpy, code that holds an array that owns its memory can make it writeable again; a view of a read-only array cannot
be made writeable. Readers therefore get views. An array that a stage still references, or returns as a view, is copied:
it could change at any time.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import Context
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from etendue.compute.job import Job
from etendue.errors import PluginError
from etendue.plugins import guests
from etendue.process import FOLDER, WARNED, return_to
from etendue.types.arrays import Array, CellArrays

if TYPE_CHECKING:
    from etendue.contract.stage import Stage

_NOBODY = nullcontext()
_Given = ParamSpec("_Given")
_Found = TypeVar("_Found")


def for_reading(array: Array) -> Array:
    """Return a read-only view of a read-only array; anything else unchanged."""
    return array.view() if type(array) is np.ndarray and not array.flags.writeable else array


def handed(stage: Stage, given: CellArrays) -> CellArrays:
    """Return the arguments for ``run`` of a stage. Stages of other distributions get copies, because code outside numpy
    can ignore numpy's read-only flag.
    """
    return {name: _apart(value) for name, value in given.items()} if guests.is_guest(type(stage)) else given


def _apart(value: Any) -> Any:
    if type(value) is np.ndarray:
        return frozen(value.copy(order="C")).view()
    if type(value) is list:  # an entry that a stage looks at: name, array or transfer function, grid
        return [tuple(map(_apart, one)) if type(one) is tuple else one for one in value]
    return value.apart() if hasattr(value, "apart") else value


def frozen(array: Array) -> Array:
    """Make an array read-only, together with the arrays of which it is a view."""
    at: Array | None = array
    while isinstance(at, np.ndarray):
        at.flags.writeable = False
        at = at.base
    return array


def taken(arrays: dict[str, Array], variable: str) -> Array:
    """Take an array out of a stage's result: contiguous and frozen, copied if anybody else could change it."""
    array = arrays.pop(variable)
    if not array.flags.c_contiguous:  # arrays read back from an archive are: the order of sums must not differ
        return frozen(array.copy(order="C"))
    return frozen(array if _alone(array) else array.copy(order="C"))


def _alone(array: Array) -> bool:
    """Return True if only the caller's variable refers to an array and to the buffer behind it."""
    if sys.getrefcount(array) > _HELD:
        return False
    while array.base is not None:
        array = array.base
        if type(array) is not np.ndarray or sys.getrefcount(array) > _BASE:
            return False
    return bool(array.flags.owndata)


def _calibrate() -> tuple[int, int]:
    """Measure the reference counts of an otherwise unreferenced array, as ``_alone`` sees them within ``taken``."""
    seen = []

    def alone(array: Array) -> bool:
        seen.append(sys.getrefcount(array))
        while array.base is not None:
            array = array.base
            seen.append(sys.getrefcount(array))
        return True

    def taken_like(arrays: dict[str, Array], variable: str) -> Array:
        array = arrays.pop(variable)
        return frozen(array if alone(array) else np.empty(0))

    # Measured instead of fixed: the counts differ between Python versions and with how the call chain holds references.
    taken_like({"a": np.empty(2)[:1]}, "a")
    return seen[0], seen[1]


_HELD, _BASE = _calibrate()


def as_array(name: str, variable: str, value: Any) -> Array:
    """Return a value that a stage returned, as a plain array of numbers."""
    if isinstance(value, np.ma.MaskedArray):
        raise PluginError(
            f"{name} gave {variable} as a masked array, whose mask would be lost; fill it, or write NaN and declare nan"
        )
    try:
        array = np.asarray(value)
    except Exception as error:
        raise PluginError(f"{name} gave {variable} as {type(value).__name__}, which is not an array: {error}") from None
    return array


def guests_of(job: Job) -> AbstractContextManager[None]:
    """Guard a cell whose stage is foreign, or which continues from transfer functions of foreign stages."""
    stage, others = job.stage, job.segment.joined if job.segment else None
    if others:
        stage = next((one for one in others if guests.is_guest(type(one))), stage)
    kind: type = type(stage)
    return guests.Guest(f"{job.ref[0]!r} ({guests.called(kind)})") if guests.is_guest(kind) else _NOBODY


@contextmanager
def in_its_place() -> Iterator[None]:
    """Restore the working directory after a group of cells. Querying it for every cell would take longer than all other
    overhead of a small cell.
    """
    who, folder = FOLDER.begin()
    try:
        yield
    finally:
        FOLDER.end(who, lambda: return_to(folder))


_QUIET = Context()
_QUIET.run(np.seterr, over="ignore", divide="ignore", invalid="ignore")


def undisturbed(work: Callable[_Given, _Found], *given: _Given.args, **named: _Given.kwargs) -> _Found:
    """Return the result of ``work``; undo any change it makes to warnings and numpy error handling of the process.

    Warnings of numpy are switched off, because non-finite results are detected and reported elsewhere. The error
    handling of numpy is a context variable; every call gets a fresh copy of the context.
    """
    who, warned = WARNED.begin()
    try:
        return _QUIET.copy().run(work, *given, **named)
    finally:
        WARNED.end(who, warned.put_back)


def abandoned() -> None:
    """Stop restoring process state: abandoned cells are still running and may change it at any time."""
    FOLDER.abandon()
    guests.abandon()
    WARNED.abandon()
