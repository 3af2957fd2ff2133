"""The errors etendue raises, grouped by who can act on them.

EtendueError
├── RequestError        the person with the pipeline file or the command line   exit 2
├── PluginError         the author of a stage: it broke its own declaration     a failed cell, exit 3
├── ArchiveError        the person with the archive                             exit 2
│   └── ArchiveInUse    another run owns it                                     exit 4
└── MachineError        the machine is short of disk or memory                  exit 5
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass


class Terminated(KeyboardInterrupt):
    """SIGTERM, answered like Ctrl-C: what is finished stays finished."""


class EtendueError(Exception):
    """Root of everything raised on purpose."""

    exit_code = 1


@dataclass(frozen=True)
class Fault:
    """One thing wrong with a request: where it stands and what to do about it."""

    place: str
    message: str
    line: int | None = None  # of the pipeline file, where it is known

    def __str__(self) -> str:
        return f"{self.place}: {self.message}" if self.place else self.message


class RequestError(EtendueError):
    """What was asked for cannot be done; carries every fault found, not the first one."""

    exit_code = 2

    def __init__(self, faults: Iterable[Fault] | str, file: str = "") -> None:
        self.faults = [Fault("", faults)] if isinstance(faults, str) else list(faults)
        self.file = file
        super().__init__(str(self))

    def __str__(self) -> str:
        return "\n".join(f"{self._where(fault)}{fault}" for fault in self.faults)

    def _where(self, fault: Fault) -> str:
        line = f":{fault.line}" if fault.line else ""
        return f"{self.file}{line}: " if self.file else ""


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
    """The machine is short of disk or memory for this request."""

    exit_code = 5


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
