"""The errors etendue raises, grouped by who can act on them.

EtendueError
├── RequestError        the person with the pipeline file or the command line   exit 2
├── PluginError         the author of a stage: it broke its own declaration     a failed cell, exit 3
├── ArchiveError        the person with the archive                             exit 2
│   └── ArchiveInUse    another run owns it                                     exit 4
└── MachineError        the machine is short of disk or memory, or a cluster gone   exit 5
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

MOST_SAID = 15  # faults of one request in a message; JSON has all of them
_TURNING = (
    "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"  # change the direction of what follows
)


def unprintable(text: str) -> bool:
    """Whether a text holds what does something to a terminal or a file name and is not seen: control characters,
    line ends.
    """
    return not text.isprintable() and any(
        unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") or c in _TURNING for c in text
    )


def escaped(text: str) -> str:
    """A text for a message: what cannot be seen as Python writes it, ``\\x1b``."""
    if not unprintable(text):
        return text
    return "".join(c.encode("unicode_escape").decode() if unprintable(c) else c for c in text)


def shortened(text: str, most: int) -> str:
    """A text for a message, cut where it is longer than a person reads."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


class EtendueError(Exception):
    """Root of everything raised on purpose."""

    exit_code = 1


@dataclass(frozen=True)
class Fault:
    """One thing wrong with a request: where it stands and what to do about it.

    Examples
    --------
    >>> from etendue.api import Fault
    >>> print(Fault("stage 2 'filter'", "there is no parameter 'widht'; did you mean 'width'?"))
    stage 2 'filter': there is no parameter 'widht'; did you mean 'width'?
    """

    place: str
    message: str
    line: int | None = None  # of the pipeline file, where it is known

    def __str__(self) -> str:
        place, message = shortened(self.place, 120), shortened(self.message, 700)
        return escaped(f"{place}: {message}" if place else message)


class RequestError(EtendueError):
    """What was asked for cannot be done; carries every fault found, not the first one.

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
            lines.append(f"{escaped(self.file)}: and {len(self.faults) - MOST_SAID} faults more")
        return "\n".join(lines)

    def _where(self, fault: Fault) -> str:
        line = f":{fault.line}" if fault.line else ""
        return f"{escaped(self.file)}{line}: " if self.file else ""


class PluginError(EtendueError):
    """A stage did not keep its declaration: wrong dims, units, dtype, undeclared values."""

    exit_code = 3


class ArchiveError(EtendueError):
    """An archive that cannot be used for what was asked."""

    exit_code = 2


class ArchiveInUse(ArchiveError):
    """Another run holds the archive's lock."""

    exit_code = 4


class MachineError(EtendueError):
    """The machine is short of disk or memory for this request, or the cluster that should compute it is gone."""

    exit_code = 5


class StoreLost(MachineError):
    """An object store cannot be reached, or has failed."""

    exit_code = 1


_SHORT = frozenset({errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EMFILE, errno.ENFILE})


def machine_text(error: OSError) -> str:
    """What the machine refused, and what to do; files by name."""
    name = f": {os.path.basename(str(error.filename))}" if error.filename else ""
    way_out = "run again when there is room" if error.errno in _SHORT else "run again when that is mended"
    return f"the machine refused: {error.strerror or error}{name}; the archive is intact, {way_out}"


@contextmanager
def refused_by_the_machine() -> Iterator[None]:
    """Reading and writing of an archive: what goes wrong there is nobody's but the machine's."""
    try:
        yield
    except OSError as error:
        raise MachineError(machine_text(error)) from error


def nearest(name: str, valid: Iterable[str]) -> str:
    """'; did you mean X?' for the closest valid name, else the list of valid ones when it is short."""
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
