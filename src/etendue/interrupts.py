"""Ctrl-C, SIGTERM and SIGHUP: one line and one exit code, whenever they come.

Nothing is raised at the instant at which a signal happens to fall: an exception in the middle of an import, a lock or
somebody else's event loop leaves a traceback at best. While nothing can be lost the process ends at once. While an
archive is open the signal is noted, and answered where the run looks for it (``check``); the third one ends the process
whatever it does.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
PATIENCE = 3  # so many signals end a process that does not come to an end by itself
end_now = os._exit  # taken before any plugin can put something in its place
INTACT = "interrupted; the archive is intact, run again to go on"


class Interrupted(KeyboardInterrupt):
    """A signal that was noted, raised where it can be answered: what is finished stays finished."""

    def __init__(self, number: int) -> None:
        super().__init__(f"signal {number}")
        self.exit_code = 128 + number


class _SignalState:
    """What is known of signals in this process."""

    owner = 0  # the process whose signals are all answered here; 0: a library in somebody's process
    answered: tuple[int, ...] = ()
    line = "interrupted"
    noted = 0
    count = 0
    holding = 0
    ending = False


def install() -> None:
    """Answer signals from now on, for as long as the process lives. What the process was started to ignore it goes
    on ignoring.
    """
    _SignalState.owner = os.getpid()
    _SignalState.answered = tuple(number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN)
    _arm()


def owns() -> bool:
    """Whether this is a process of ours, all of whose signals are answered here."""
    return _SignalState.owner == os.getpid()


def ends() -> None:
    """All is done but what was asked to be done at the very end."""
    _SignalState.ending = True


def ending() -> bool:
    """Whether that is so."""
    return _SignalState.ending


def _arm() -> None:
    for number in _SignalState.answered:
        if signal.getsignal(number) is not _answer:
            signal.signal(number, _answer)


def say(line: str) -> None:
    """What is said from now on when a signal comes."""
    _SignalState.line = line


def line() -> str:
    """What is said now when a signal comes."""
    return _SignalState.line


def _answer(number: int, frame: FrameType | None) -> None:
    _SignalState.noted = _SignalState.noted or number
    _SignalState.count += 1
    if _SignalState.holding and _SignalState.count < PATIENCE:
        return
    if owns():
        leave()
    if not _SignalState.owner:
        raise KeyboardInterrupt
    end_now(128 + number)  # a child that was forked


def leave() -> None:
    """End the process now, with the line and the code of the signal that was noted."""
    try:
        os.write(2, f"{_SignalState.line}\n".encode())
    except OSError:  # nobody listens
        pass
    end_now(128 + (_SignalState.noted or signal.SIGINT))


def check() -> None:
    """Raise ``Interrupted`` if a signal was noted. In somebody else's process it is the main thread's: other threads
    go on.
    """
    if (
        _SignalState.noted
        and _SignalState.holding
        and (_SignalState.owner or threading.current_thread() is threading.main_thread())
    ):
        raise Interrupted(_SignalState.noted)


@contextmanager
def held() -> Iterator[None]:
    """Signals are noted in here. One that nobody has answered is raised at the end.

    In somebody else's process, Ctrl-C alone, and only where it has the meaning that Python gives it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)
    ours = not _SignalState.owner and not _SignalState.holding and before is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _answer)
    elif _SignalState.owner:
        _arm()  # a plugin may have taken them
    _SignalState.holding += 1
    try:
        yield
        check()
    finally:
        _SignalState.holding -= 1
        if ours:
            signal.signal(signal.SIGINT, before)
        if not _SignalState.owner and not _SignalState.holding:
            _SignalState.noted = _SignalState.count = 0


def is_ours(error: BaseException) -> bool:
    """Whether an exception is a signal of the user's, not one that a plugin has raised."""
    if isinstance(error, Interrupted):
        return True
    if not isinstance(error, KeyboardInterrupt) or threading.current_thread() is not threading.main_thread():
        return False
    return signal.getsignal(signal.SIGINT) is signal.default_int_handler
