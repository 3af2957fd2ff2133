"""Arrays that nobody can change any more, and a process that is left as it was found.

In:  an array that a stage gave back.
Out: the same values, contiguous, in memory to which nobody else holds a reference; read-only views of it for readers.

numpy lets an array that owns its memory be made writeable again by whoever holds it, a view of one that is read-only
not. So readers are given views. What a stage still holds on to, or shows a view of, is copied: nobody knows when it is
changed.
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
from etendue.types.arrays import Array

if TYPE_CHECKING:
    from etendue.contract.stage import Stage

_NOBODY = nullcontext()
_Given = ParamSpec("_Given")
_Found = TypeVar("_Found")


def for_reading(array: Array) -> Array:
    """A view that cannot be made writeable, of an array that is read-only; anything else as it is."""
    return array.view() if type(array) is np.ndarray and not array.flags.writeable else array


def handed(stage: Stage, given: dict[str, Any]) -> dict[str, Any]:
    """What the ``run`` of a stage is called with. Another distribution's gets arrays of its own: numpy's flag binds
    numpy alone.
    """
    return {name: _apart(value) for name, value in given.items()} if guests.is_guest(type(stage)) else given


def _apart(value: Any) -> Any:
    if type(value) is np.ndarray:
        return frozen(value.copy(order="C")).view()
    if type(value) is list:  # what is looked at: name, array or transfer function, grid
        return [tuple(map(_apart, one)) if type(one) is tuple else one for one in value]
    return value.apart() if hasattr(value, "apart") else value


def frozen(array: Array) -> Array:
    """Forbid writing into an array and what it is a view of."""
    at: Array | None = array
    while isinstance(at, np.ndarray):
        at.flags.writeable = False
        at = at.base
    return array


def taken(arrays: dict[str, Array], variable: str) -> Array:
    """Take an array out of what a stage gave back: contiguous, frozen, and its own where anybody else could change
    it.
    """
    array = arrays.pop(variable)
    if not array.flags.c_contiguous:  # what is read back from an archive is: sums must not depend on it
        return frozen(array.copy(order="C"))
    return frozen(array if _alone(array) else array.copy(order="C"))


def _alone(array: Array) -> bool:
    """Whether nobody but the caller's variable refers to an array, nor to what it is a view of."""
    if sys.getrefcount(array) > _HELD:
        return False
    while array.base is not None:
        array = array.base
        if type(array) is not np.ndarray or sys.getrefcount(array) > _BASE:
            return False
    return bool(array.flags.owndata)


def _calibrate() -> tuple[int, int]:
    """Reference counts of an array that nobody else holds, as ``_alone`` sees them when ``taken`` asks."""
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

    taken_like({"a": np.empty(2)[:1]}, "a")
    return seen[0], seen[1]


_HELD, _BASE = _calibrate()


def as_array(name: str, variable: str, value: Any) -> Array:
    """What a stage gave back as a plain array of numbers."""
    if isinstance(value, np.ma.MaskedArray):
        raise PluginError(
            f"{name} gave {variable} as a masked array, whose mask nobody would see; fill it, or write NaN and declare "
            f"nan"
        )
    try:
        array = np.asarray(value)
    except Exception as error:
        raise PluginError(f"{name} gave {variable} as {type(value).__name__}, which is no array: {error}") from None
    return array


def guests_of(job: Job) -> AbstractContextManager[None]:
    """Around the cell of a stage of another distribution, or one that goes on from the transfer functions of some."""
    stage, others = job.stage, job.segment.joined if job.segment else None
    if others:
        stage = next((one for one in others if guests.is_guest(type(one))), stage)
    kind: type = type(stage)
    return guests.Guest(f"{job.ref[0]!r} ({guests.called(kind)})") if guests.is_guest(kind) else _NOBODY


@contextmanager
def in_its_place() -> Iterator[None]:
    """The working directory is put back behind some cells: asking for it costs more than all else around a small
    cell.
    """
    who, folder = FOLDER.begin()
    try:
        yield
    finally:
        FOLDER.end(who, lambda: return_to(folder))


_QUIET = Context()
_QUIET.run(np.seterr, over="ignore", divide="ignore", invalid="ignore")


def undisturbed(work: Callable[_Given, _Found], *given: _Given.args, **named: _Given.kwargs) -> _Found:
    """What ``work`` gives; whatever it changes about how its process warns and handles errors of numpy is put back
    behind it.

    What is not finite is looked for in what it gives, and said once: numpy says nothing. How numpy handles errors
    stands in a context, of which every call has a fresh copy.
    """
    who, warned = WARNED.begin()
    try:
        return _QUIET.copy().run(work, *given, **named)
    finally:
        WARNED.end(who, warned.put_back)


def abandoned() -> None:
    """Cells go on that nobody waits for any more: what they change is not put back behind others."""
    FOLDER.abandon()
    guests.abandon()
    WARNED.abandon()
