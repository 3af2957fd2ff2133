"""The errors that etendue raises, grouped by who can act on them.

EtendueError
├── RequestError        the person with the pipeline file or the command line   exit 2
├── PluginError         the author of a stage that broke its own declaration    a failed cell, exit 3
├── ArchiveError        the person with the archive                             exit 2
│   └── ArchiveInUse    another run owns it                                     exit 4
└── MachineError        out of memory or disk, or the cluster was lost          exit 5
    └── StoreLost       an object store cannot be reached, or has failed        exit 1
"""

from __future__ import annotations

import difflib
import errno
import os
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

MOST_SAID = 15  # faults of one request listed in a message; JSON has all
_TURNING = (
    # they change the writing direction of the text after them
    "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
)


def unprintable(text: str) -> bool:
    """Return whether a text contains invisible characters that affect a terminal or a file name: control characters,
    line ends, changes of direction.
    """
    return not text.isprintable() and any(
        unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") or c in _TURNING for c in text
    )


def escaped(text: str) -> str:
    """Return a text for a message, with invisible characters as Python writes them, such as ``\\x1b``."""
    if not unprintable(text):
        return text
    return "".join(c.encode("unicode_escape").decode() if unprintable(c) else c for c in text)


def shortened(text: str, most: int) -> str:
    """Return a text for a message, cut to at most ``most`` characters."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


class EtendueError(Exception):
    """Base class of all intended errors of etendue."""

    exit_code = 1


@dataclass(frozen=True)
class Fault:
    """One fault of a request: its place and a message with the remedy.

    Examples
    --------
    >>> from etendue.api import Fault
    >>> print(Fault("stage 2 'filter'", "unknown parameter 'widht'; did you mean 'width'?"))
    stage 2 'filter': unknown parameter 'widht'; did you mean 'width'?
    """

    place: str
    message: str
    line: int | None = None  # of the pipeline file, if known

    def __str__(self) -> str:
        place, message = shortened(self.place, 120), shortened(self.message, 700)
        return escaped(f"{place}: {message}" if place else message)


class RequestError(EtendueError):
    """A request that cannot be carried out. It contains every fault found, not only the first.

    Examples
    --------
    >>> from etendue.api import Fault, RequestError
    >>> RequestError([Fault("gain", "must be above 0"), Fault("seed", "must be a whole number")]).faults[1].place
    'seed'
    """

    exit_code = 2

    def __init__(self, faults: Iterable[Fault] | str, file: str = "") -> None:
        self.faults = [Fault("", faults)] if isinstance(faults, str) else list(faults)
        self.file = file
        super().__init__(str(self))

    def __str__(self) -> str:
        lines = [f"{self._where(fault)}{fault}" for fault in self.faults[:MOST_SAID]]
        if len(self.faults) > MOST_SAID:
            lines.append(f"{escaped(self.file)}: and {len(self.faults) - MOST_SAID} more faults")
        return "\n".join(lines)

    def _where(self, fault: Fault) -> str:
        line = f":{fault.line}" if fault.line else ""
        return f"{escaped(self.file)}{line}: " if self.file else ""


class PluginError(EtendueError):
    """A stage violated its declaration: wrong dims, units or dtype, or undeclared values."""

    exit_code = 3


class ArchiveError(EtendueError):
    """An archive cannot be used for the request."""

    exit_code = 2


class ArchiveInUse(ArchiveError):
    """Another run holds the archive's lock."""

    exit_code = 4


class MachineError(EtendueError):
    """The machine is out of memory or disk for this request, or the cluster that should compute it was lost."""

    exit_code = 5


class StoreLost(MachineError):
    """An object store cannot be reached, or has failed."""

    exit_code = 1


_SHORT = frozenset({errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EMFILE, errno.ENFILE})


def machine_text(error: OSError) -> str:
    """Return a message that names the refused operation and a remedy; files are given without their folders."""
    name = f": {os.path.basename(str(error.filename))}" if error.filename else ""
    way_out = "free some and run again" if error.errno in _SHORT else "run again once that is fixed"
    return f"the machine refused: {error.strerror or error}{name}; the archive is intact, {way_out}"


@contextmanager
def refused_by_the_machine() -> Iterator[None]:
    """Convert an ``OSError`` during reading or writing of an archive into a ``MachineError``."""
    try:
        yield
    except OSError as error:
        raise MachineError(machine_text(error)) from error


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return '; did you mean X?' for the closest valid name, else a list of valid names if it is short, else ''."""
    names = sorted(set(valid))
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if not close and len(name) > 2:
        close = [valid_name for valid_name in names if name.lower() in valid_name.lower()]
    if close:
        return f"; did you mean {close[0]!r}?"
    text = ", ".join(names)
    if names and len(text) <= 120:
        return f"; valid: {text}"
    return ""
