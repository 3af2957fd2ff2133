"""Reserve stdout for results: plugins and their libraries may print anything.

While a command runs, file descriptor 1 and ``sys.stdout`` are stderr; ``results`` restores both while results are
written. Worker processes inherit stderr as their stdout.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO, TextIO

from etendue.telling import plain, shown_path


class _StreamState:
    kept: int | None = None  # duplicate of the real stdout while descriptor 1 is stderr
    stream: TextIO | None = None


@contextmanager
def plugins_on_stderr() -> Iterator[None]:
    """Redirect stdout to stderr inside the block, for Python and for C code; show warnings in one line each."""
    if _StreamState.stream is not None:
        yield
        return
    before, shown = sys.stdout, warnings.showwarning
    _StreamState.stream = before
    if _is_fd_1(before):
        before.flush()
        _StreamState.kept = os.dup(1)
        os.dup2(2, 1)
    sys.stdout, warnings.showwarning = sys.stderr, show_warning
    try:
        yield
    finally:
        sys.stdout, warnings.showwarning = before, shown
        if _StreamState.kept is not None:
            _flush_c()
            os.dup2(_StreamState.kept, 1)
            os.close(_StreamState.kept)
        _StreamState.kept = _StreamState.stream = None


@contextmanager
def results() -> Iterator[None]:
    """Restore stdout inside the block."""
    stream = _StreamState.stream
    if stream is None:
        yield
        return
    if _StreamState.kept is not None:
        _flush_c()
        os.dup2(_StreamState.kept, 1)
    sys.stdout = stream
    try:
        yield
        stream.flush()
    finally:
        sys.stdout = sys.stderr
        if _StreamState.kept is not None:
            os.dup2(2, 1)


def _is_fd_1(stream: IO[str]) -> bool:
    try:
        return bool(stream.fileno() == 1)
    except (OSError, ValueError, AttributeError):  # the stream is not a file
        return False


def _flush_c() -> None:
    """Flush the output of C code that its library still buffers, so that it reaches its intended stream."""
    if "numpy" not in sys.modules:  # no plugin has run
        return
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).fflush(None)


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Show a warning of a plugin or a library in one line, without folders of this machine."""
    text = " ".join(plain(str(message)).split())
    with suppress(OSError):  # stderr is closed
        (file or sys.stderr).write(
            f"note: {shown_path(os.path.abspath(filename))}:{lineno}: {category.__name__}: {text}\n"
        )
