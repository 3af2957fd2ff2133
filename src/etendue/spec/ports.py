"""Ports between rooms that do not know each other: where results go, and who is told.

``run`` computes and hands results to a ``Target``; ``archive`` implements it; ``session`` joins them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

COUNTED = ("_floored", "_saturated")  # ends of the names of variables that the end of a run speaks of where they are above 0


@dataclass(frozen=True)
class Written:
    """One chunk file: its path below the archive, its size and the digest of its bytes."""

    path: str
    size: int
    digest: str


class Target(Protocol):
    """Where the variables of one cell are kept. Picklable: it travels with the work."""

    def write(self, arrays: Mapping[str, Any]) -> tuple[Written, ...]: ...

    def read(self, variable: str) -> Any: ...

    def read_band(self, variable: str, band: int) -> Any: ...


@dataclass(frozen=True)
class CellReport:
    """What happened to one cell."""

    stage: str
    index: tuple[int, ...]
    status: str  # done | left_out | failed | skipped
    seconds: float = 0.0
    written: tuple[Written, ...] = ()
    message: str = ""
    clipped: float = 0.0
    clipped_flux: float = 0.0
    floored: float = 0.0  # sum of the variables whose names end in COUNTED


class Progress(Protocol):
    """Told by the owner of a run, never by a worker."""

    def begin(self, cells: int) -> None: ...

    def starting(self, stages: tuple[str, ...]) -> None: ...

    def finished(self, reports: tuple[CellReport, ...]) -> None: ...

    def end(self) -> None: ...
