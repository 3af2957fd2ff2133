"""Handle Ctrl-C, SIGTERM and SIGHUP: one line and one exit code at any time.

No exception is raised at the place where a signal arrives: an exception in the middle of an import, a lock or a foreign
event loop leaves a traceback at best. While nothing can be lost, the process ends at once. While an archive is open,
the signal is recorded, and handled where the run checks for it (``check``). The third signal ends the process in any
case.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
PATIENCE = 3  # signals after which the process ends without waiting
end_now = os._exit  # bound before any plugin can replace it
INTACT = "interrupted; the archive is intact, run again to continue"


class Interrupted(KeyboardInterrupt):
    """A recorded signal, raised where it can be handled; finished results are kept."""

    def __init__(self, number: int) -> None:
        super().__init__(f"signal {number}")
        self.exit_code = 128 + number


class _SignalState:
    """How this process handles signals, and which signal has arrived."""

    owner = 0  # pid if this process is ours and handles all signals here; 0 if etendue is a library in another program
    answered: tuple[int, ...] = ()
    line = "interrupted"
    noted = 0
    count = 0
    holding = 0
    ending = False


def install() -> None:
    """Handle signals from now on, for the life of the process. Signals that were ignored when the process started stay
    ignored.
    """
    _SignalState.owner = os.getpid()
    _SignalState.answered = tuple(number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN)
    _arm()


def owns() -> bool:
    """Return whether this process belongs to etendue, so that all its signals are handled here."""
    return _SignalState.owner == os.getpid()


def noted() -> bool:
    """Return whether a signal has arrived that is not handled yet."""
    return bool(_SignalState.noted)


def ends() -> None:
    """Record that only the exit handlers remain."""
    _SignalState.ending = True


def ending() -> bool:
    """Return whether only the exit handlers remain."""
    return _SignalState.ending


def _arm() -> None:
    for number in _SignalState.answered:
        if signal.getsignal(number) is not _answer:
            signal.signal(number, _answer)


def say(line: str) -> None:
    """Set the line to print when a signal arrives."""
    _SignalState.line = line


def line() -> str:
    """Return the line to print when a signal arrives."""
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
    end_now(128 + number)  # a forked child


def leave() -> None:
    """End the process now, with the line and the exit code of the noted signal."""
    try:
        os.write(2, f"{_SignalState.line}\n".encode())
    except OSError:  # stderr is closed
        pass
    end_now(128 + (_SignalState.noted or signal.SIGINT))


def check() -> None:
    """Raise ``Interrupted`` if a signal was noted. In the process of another program only the main thread raises; other
    threads continue.
    """
    if (
        _SignalState.noted
        and _SignalState.holding
        and (_SignalState.owner or threading.current_thread() is threading.main_thread())
    ):
        raise Interrupted(_SignalState.noted)


@contextmanager
def held() -> Iterator[None]:
    """Record signals inside the block instead of acting on them. A recorded signal that the block has not handled is
    raised at its end.

    In another program's process this covers Ctrl-C only, and only if it has Python's default handler.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)
    ours = not _SignalState.owner and not _SignalState.holding and before is signal.default_int_handler
    if ours:
        signal.signal(signal.SIGINT, _answer)
    elif _SignalState.owner:
        _arm()  # a plugin may have replaced the handlers
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
    """Return whether an exception is a signal from the user, not a ``KeyboardInterrupt`` that a plugin raised."""
    if isinstance(error, Interrupted):
        return True
    if not isinstance(error, KeyboardInterrupt) or threading.current_thread() is not threading.main_thread():
        return False
    return signal.getsignal(signal.SIGINT) is signal.default_int_handler
