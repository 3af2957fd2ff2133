"""Isolation of foreign code running in this process: it can end only itself, and its changes to the process are undone.

In:  the name of the code.
Out: umask, recursion limit and floating-point mode are restored; a child that foreign code has forked ends if it
     returns; ``os._exit`` acts as ``sys.exit``.

``discovery.foreign`` and ``run.ownership`` restore the rest of the process state: working directory, warnings, numpy
error handling.
"""

from __future__ import annotations

import os
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache, partial
from typing import Any

from etendue import interrupts
from etendue.process import SharedChange, StateBefore

# variables, so that the tests below are not computed at compile time
_ONE, _HALF, _SMALLEST, _TIE_ABOVE, _TIE_BELOW = (1.0, 0.5, sys.float_info.min, 2.0**-53, 2.0**-54)
_told: dict[Any, Any] = {}  # notes already given, each only once


class _AtWork(threading.local):
    count = 0


class _Process:
    ours = False  # a worker's


_here = _AtWork()


def is_guest(kind: type) -> bool:
    """Return True if a stage class belongs to another distribution."""
    return not is_ours(kind.__module__)


def is_ours(module: str) -> bool:
    """Return True if a module name belongs to this distribution."""
    return module.partition(".")[0] in _own_packages()


@cache
def _own_packages() -> frozenset[str]:
    from etendue.plugins.discovery import own_packages  # imported late, because it imports this module

    return own_packages()


@cache
def called(kind: type) -> str:
    """Return the name of a stage class as shown to users: ``naughty_light.Naughty``."""
    return f"{kind.__module__}.{kind.__qualname__}"


class Guest:
    """A context manager for running foreign code called ``name``; may be nested and used in several threads."""

    __slots__ = ("found", "name", "ordinary", "process", "who")

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> None:
        self.process, self.ordinary = os.getpid(), ordinary()
        self.who, self.found = _STATE.begin()
        EXIT.__enter__()
        if _ours() and not EXIT.stays:  # for threads that foreign code leaves behind
            EXIT.stays = True
            EXIT.__enter__()
        _here.count += 1

    def __exit__(self, *_: object) -> None:
        if os.getpid() != self.process:
            _say(f"note: a process that {self.name} had forked returned from it and was ended\n")
            interrupts.end_now(1)  # everything that follows belongs to its parent
        _here.count -= 1
        EXIT.__exit__()
        changed: list[str] = []
        _STATE.end(self.who, lambda: changed.extend(_put_back(*self.found)))
        if self.ordinary and not ordinary():
            changed.append("the floating-point rounding mode")
            _arithmetic_again()
        if changed:
            text = f"{self.name} changed {' and '.join(changed)}; restored"
            warnings.warn_explicit(text, RuntimeWarning, __file__, 0, registry=_told)


def in_a_worker() -> None:
    """Mark this process as a worker of etendue: a call of ``os._exit`` in it then comes from a plugin."""
    _Process.ours = True


def abandon() -> None:
    """Give up on foreign code that will never end; later guests restore the present state."""
    _STATE.abandon()


# -- process state --------------------------------------------------------------------------------------------------


def _now() -> tuple[int, int]:
    """Return the umask and the recursion limit."""
    try:
        with open("/proc/self/status", "rb", 0) as status:
            line = status.read(256).partition(b"\nUmask:")[2].split(maxsplit=1)
    except OSError:
        line = []
    if line:
        return int(line[0], 8), sys.getrecursionlimit()
    # without /proc it can only be read by setting it; a strict value, in case a file is created meanwhile
    umask = os.umask(0o077)
    os.umask(umask)
    return umask, sys.getrecursionlimit()


_STATE = StateBefore(_now)


def _put_back(umask: int, limit: int) -> Iterator[str]:
    """Restore umask and recursion limit; yield each change in words."""
    if (left := os.umask(umask)) != umask:
        yield f"the umask to {left:03o}"
    if (left := sys.getrecursionlimit()) != limit:
        sys.setrecursionlimit(limit)
        yield f"the recursion limit to {left}"


def ordinary() -> bool:
    """Return True if this thread rounds to the nearest number, ties to even, and computes with subnormal numbers."""
    return _ONE + _TIE_ABOVE == _ONE and _ONE - _TIE_BELOW == _ONE and _SMALLEST * _HALF > 0.0


def _arithmetic_again() -> None:
    """Reset the floating-point environment of this thread to its default, if the C library supports it."""
    import ctypes

    library = ctypes.CDLL(None)
    with suppress(AttributeError, ValueError):
        if sys.platform == "darwin":
            library.fesetenv(ctypes.byref(ctypes.c_byte.in_dll(library, "_FE_DFL_ENV")))
        else:
            library.fesetenv(ctypes.c_void_p(-1))  # FE_DFL_ENV of glibc and musl


# -- ending the process ---------------------------------------------------------------------------------------------


def _say(line: str) -> None:
    with suppress(OSError):  # stderr may be closed
        os.write(2, line.encode())


def _exit_of_guests(process: int, real: Any, status: int) -> None:
    """Replace ``os._exit`` while foreign code runs. A forked child ends; a process that does not belong to etendue also
    ends, if its own code calls ``os._exit``.
    """
    if os.getpid() == process and (_here.count or _ours()):
        if interrupts.ending():  # the process is ending with the exit code of the command
            return
        if not _here.count:
            _say(f"note: a plugin called os._exit({status}) in a thread of its own; only that thread was ended\n")
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
        if os is not None and os._exit is own:  # None while the interpreter shuts down
            os._exit = real


class _Exit(SharedChange):
    stays = False  # until the process ends


EXIT = _Exit(_exit_watched)
