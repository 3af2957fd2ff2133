"""Format errors of foreign code for display: the code that failed and the line, without terminal control characters.

In:  exceptions of plugins and libraries, texts of files and plugins.
Out: plain text without control characters and without folders of this machine.
"""

from __future__ import annotations

import linecache
import os
import re
import sys
import unicodedata
from typing import TYPE_CHECKING, Literal

from etendue.errors import EtendueError, PluginError
from etendue.interrupts import is_ours

if TYPE_CHECKING:
    from types import TracebackType

MOST_LINES = 20
LONGEST_LINE = 500
WIDEST, LONGEST_SAID = 200, 1500
FRAMES = 3
# the packages of this distribution
_OURS = re.compile(re.escape(os.path.dirname(os.path.realpath(__file__))) + r"(?:_[a-z]+)?[/\\]")
_BIDI = frozenset("\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069\u2028\u2029")
_PATH = re.compile(r"(?<![\w.:/~\-])/[^\s/'\":;,()<>|\[\]]+(?:/[^\s/'\":;,()<>|\[\]]+)+/?")


def printable(text: str) -> str:
    """Return a text without characters that control a terminal or change the text's direction; line ends stay."""
    if text.isascii() and text.isprintable():
        return text
    text = text.replace("\r\n", "\n").replace("\t", "    ")
    obeyed = {c for c in set(text) - {"\n"} if unicodedata.category(c) in ("Cc", "Cs") or c in _BIDI}
    return "".join(c for c in text if c not in obeyed)


def plain(text: str) -> str:
    """Return at most 20 lines of bounded length, printable, with files named relative to the working directory."""
    lines = without_folders(printable(text[: 4 * MOST_LINES * LONGEST_LINE])).strip("\n").split("\n")
    lines = [
        line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]}... ({len(line)} characters)" for line in lines
    ]
    whole = 1 + text.strip("\n").count("\n")
    if whole > MOST_LINES:  # keep the last line: it usually says most
        last = text.strip("\n").rpartition("\n")[2][:LONGEST_LINE]
        lines = [
            *lines[: MOST_LINES - 2],
            f"... ({whole - MOST_LINES + 1} more lines)",
            without_folders(printable(last)),
        ]
    return "\n".join(lines)


def refusal(text: str) -> str:
    """Return the text that a command shows for an error: about 20 lines of 200 characters, long lines cut."""
    lines: list[str] = []
    room = MOST_LINES - 1
    whole = printable(text).strip("\n").split("\n")
    for number, line in enumerate(whole):
        short = line if len(line) <= LONGEST_SAID else f"{line[:LONGEST_SAID]}... ({len(line)} characters)"
        room -= 1 + len(short) // WIDEST
        if room < 0:
            return "\n".join([*lines, f"... and {len(whole) - number} more lines"])
        lines.append(short)
    return "\n".join(lines)


def without_folders(text: str) -> str:
    """Return a text with absolute paths of this machine made relative to the working directory, or to file names."""
    return _PATH.sub(lambda found: shown_path(found.group()), text) if "/" in text else text


def shown_path(path: str) -> str:
    """Return a path relative to the working directory or to a package folder, else its name."""
    if not os.path.isdir("/" + path.split("/")[1]):
        return path  # a unit such as W m-2/nm, or a path of another machine
    for folder in (here(), *sorted(filter(os.path.isabs, sys.path), key=len, reverse=True)):
        if folder not in ("", "/") and path.startswith(folder.rstrip("/") + "/"):
            return path[len(folder.rstrip("/")) + 1 :]
    return os.path.basename(path.rstrip("/"))


def here() -> str:
    """Return the working directory; '' if it has been removed."""
    try:
        return os.getcwd()
    except OSError:
        return ""


def said(error: BaseException) -> str:
    """Return type and text of an exception. Its ``__str__`` is foreign code too, and may fail."""
    try:
        text = str(error)
    except BaseException as worse:
        if is_ours(worse):
            raise
        text = f"(its text is not available: {type(worse).__name__})"
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        text = f"{error.strerror}: {os.path.basename(str(error.filename))}"
    return f"{type(error).__name__}: {plain(text)}".removesuffix(": ")


def told(error: BaseException) -> str:
    """Return file and line of the innermost frames of an exception's traceback, followed by its type and text."""
    lines = []
    trace = error.__traceback__
    frames = []
    while trace is not None:
        frames.append((trace.tb_frame.f_code, trace.tb_lineno))
        trace = trace.tb_next
    for code, line in frames[-FRAMES:]:
        source = linecache.getline(code.co_filename, line).strip()
        lines.append(
            f"  {plain(shown_path(os.path.abspath(code.co_filename)))}:{line} in "
            f"{code.co_name}{f': {source}' if source else ''}"
        )
    return "\n".join((*(plain(line) for line in lines), said(error)))


class foreign:
    """Guard for code of a plugin: an exception that it raises becomes a ``PluginError`` that names the failed part.

    This does not apply to signals from the user, to errors of etendue, and to ``ValueError``, by which a stage refuses
    its parameters or input.
    """

    __slots__ = ("what",)

    def __init__(self, what: str) -> None:
        self.what = what

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> Literal[False]:
        if error is not None and not isinstance(error, EtendueError | ValueError) and not is_ours(error):
            raise PluginError(f"{self.what} failed: {where(error)}{said(error)}") from error
        return False


def where(error: BaseException) -> str:
    """Return 'file.py:12, ' for the innermost code outside this package in which an exception was raised; '' if there
    is none.
    """
    trace, found = error.__traceback__, ""
    while trace is not None:
        file = trace.tb_frame.f_code.co_filename
        if not file.startswith("<") and not _OURS.match(os.path.realpath(file)):
            found = f"{os.path.basename(file)}:{trace.tb_lineno}, "
        trace = trace.tb_next
    return found


def human_seconds(seconds: float) -> str:
    """Return a duration in a readable unit, such as 1.5 s."""
    if seconds >= 59.995:  # rounds to a minute or more
        minutes, rest = divmod(round(seconds), 60)
        return f"{minutes} min {rest} s"
    return f"{seconds:.2f} s" if seconds >= 0.99995 else f"{1e3 * seconds:.1f} ms"


def human_bytes(count: float) -> str:
    """Return a number of bytes in a readable unit, such as 1.5 MB."""
    for unit in ("B", "kB", "MB", "GB", "TB"):
        said = f"{count:.0f}" if unit == "B" else f"{count:.1f}"
        if float(said) < 1000 or unit == "TB":
            return f"{said} {unit}"
        count /= 1000
    return ""
