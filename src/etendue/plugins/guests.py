"""Code of other distributions, while it is at work in this process: it ends nothing but itself, and what it changes is
put back.

In:  who is at work, by name.
Out: umask, recursion limit and arithmetic as they stood in front of all who are at work; a child that it forked and
     that comes back with it ends; ``os._exit`` is ``sys.exit``.

``discovery.foreign`` and ``run.ownership`` put back what else there is only once: the working folder, warnings, errors
of numpy.
"""

from __future__ import annotations

import os
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from typing import Any, NoReturn

from etendue import interrupts
from etendue.process import SharedChange, StateBefore

_ONE, _HALF, _SMALLEST, _TIE_ABOVE, _TIE_BELOW = (
    1.0,
    0.5,
    sys.float_info.min,
    2.0**-53,
    2.0**-54,
)  # names: nothing is computed ahead
_told: dict[Any, Any] = {}  # what has been said; once is enough


class _AtWork(threading.local):
    count = 0


class _Process:
    ours = False  # a worker's


_here = _AtWork()


def is_guest(kind: type) -> bool:
    """Whether a class of stages is another distribution's."""
    return not is_ours(kind.__module__)


def is_ours(module: str) -> bool:
    """Whether a module, by its name, is of this distribution."""
    return module.partition(".")[0] in _own_packages()


@cache
def _own_packages() -> frozenset[str]:
    from etendue.plugins.discovery import own_packages  # which asks for guests

    return own_packages()


@cache
def called(kind: type) -> str:
    """A class of stages as it is named to a user: ``naughty_light.Naughty``."""
    return f"{kind.__module__}.{kind.__qualname__}"


class Guest:
    """Use as a context manager around the code of ``name``; as often, as deep and in as many threads as there is
    some.
    """

    __slots__ = ("found", "name", "ordinary", "process", "who")

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> None:
        self.process, self.ordinary = os.getpid(), ordinary()
        self.who, self.found = _STATE.begin()
        EXIT.__enter__()
        if _ours() and not EXIT.stays:  # for threads that it leaves behind
            EXIT.stays = True
            EXIT.__enter__()
        _here.count += 1

    def __exit__(self, *_: object) -> None:
        if os.getpid() != self.process:
            _came_back(self.name)
        _here.count -= 1
        EXIT.__exit__()
        changed: list[str] = []
        _STATE.end(self.who, lambda: changed.extend(_put_back(*self.found)))
        if self.ordinary and not ordinary():
            changed.append("how numbers are rounded")
            _arithmetic_again()
        if changed:
            text = f"{self.name} has set {' and '.join(changed)}; put back"
            warnings.warn_explicit(text, RuntimeWarning, __file__, 0, registry=_told)


def in_a_worker() -> None:
    """This process is ours: nobody but plugins ends it with ``os._exit``."""
    _Process.ours = True


def abandon() -> None:
    """Somebody will never end: what stands now is what those who begin from now on put back."""
    _STATE.abandon()


# -- what is put back -----------------------------------------------------------------------------------------------


def _now() -> tuple[int, int]:
    """The umask and the recursion limit."""
    try:
        with open("/proc/self/status", "rb", 0) as status:
            line = status.read(256).partition(b"\nUmask:")[2].split(maxsplit=1)
    except OSError:
        line = []
    if line:
        return int(line[0], 8), sys.getrecursionlimit()
    umask = os.umask(
        0o077
    )  # elsewhere it is asked for by setting it: a file that is made at this instant is its owner's alone
    os.umask(umask)
    return umask, sys.getrecursionlimit()


_STATE = StateBefore(_now)


def _put_back(umask: int, limit: int) -> Iterator[str]:
    """What of them was another, in words."""
    if (left := os.umask(umask)) != umask:
        yield f"the umask to {left:03o}"
    if (left := sys.getrecursionlimit()) != limit:
        sys.setrecursionlimit(limit)
        yield f"the recursion limit to {left}"


def ordinary() -> bool:
    """Whether this thread rounds to the nearest number, ties to even, and has numbers smaller than the smallest
    normal one.
    """
    return _ONE + _TIE_ABOVE == _ONE and _ONE - _TIE_BELOW == _ONE and _SMALLEST * _HALF > 0.0


def _arithmetic_again() -> None:
    """The arithmetic with which every process begins, in this thread; where the C library has no such call it stays."""
    import ctypes

    library = ctypes.CDLL(None)
    with suppress(AttributeError, ValueError):
        if sys.platform == "darwin":
            library.fesetenv(ctypes.byref(ctypes.c_byte.in_dll(library, "_FE_DFL_ENV")))
        else:
            library.fesetenv(ctypes.c_void_p(-1))  # FE_DFL_ENV of glibc and musl


# -- who ends -------------------------------------------------------------------------------------------------------


def _came_back(name: str) -> NoReturn:
    """In a child that was forked: all that stands behind here is its parent's."""
    _say(f"note: a process that {name} had forked came back from it, and was ended\n")
    interrupts.end_now(1)


def _say(line: str) -> None:
    with suppress(OSError):  # nobody listens
        os.write(2, line.encode())


def _exit_of_guests(process: int, real: Any, status: int) -> None:
    """``os._exit`` while guests are at work. A child that was forked ends; so does the process, where somebody else
    owns it and asks.
    """
    if os.getpid() == process and (_here.count or _ours()):
        if interrupts.ending():  # the process ends, with the code of the command
            return
        if not _here.count:
            _say(f"note: a plugin called os._exit({status}) in a thread of its own, which alone was ended\n")
        raise SystemExit(f"os._exit({status})")
    real(status)


def _ours() -> bool:
    return _Process.ours or interrupts.owns()


@contextmanager
def _exit_watched() -> Iterator[None]:
    real: Any = os._exit
    own: Any = partial(_exit_of_guests, os.getpid(), real)
    os._exit = own
    try:
        yield
    finally:
        if os is not None and os._exit is own:  # None where the interpreter itself ends
            os._exit = real


class _Exit(SharedChange):
    stays = False  # until the process ends


EXIT = _Exit(_exit_watched)
