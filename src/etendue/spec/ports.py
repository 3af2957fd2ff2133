"""Ports between rooms that do not know each other: where results go, and who is told.

``run`` computes and hands results to a ``Target`` of the run's ``Keeper``; ``archive`` implements both, on disk and in memory;
``report`` draws a ``Sheet``; ``session`` joins them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from etendue.plan.model import Cell, CellRef, Plan
    from etendue.plan.resume import Work

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


@dataclass(frozen=True)
class Sheet:
    """Pictures of the shown cells: as a table of the archive, and drawn into one PNG."""

    table: dict[str, Any]
    draw: Callable[[Path], None]
    shown: tuple[CellRef, ...]
    at: str  # their axis values


class Keeper(Protocol):
    """Where the results of a run are kept, and what is kept from earlier ones. Used as a context manager, by the owner of the run.

    Attributes
    ----------
    folder : where, if anywhere
    keeps_arrays : whether it takes the arrays of all cells from ``finished``; else from their ``target``
    draws : whether pictures are made of the shown cells
    """

    folder: Path | None
    keeps_arrays: bool
    draws: bool

    def __enter__(self) -> Keeper: ...

    def __exit__(self, *error: object) -> None: ...

    def begin(self, asked: Plan) -> Work: ...

    def target(self, cell: Cell) -> Target | None: ...

    def starting(self, refs: Iterable[CellRef]) -> None: ...

    def finished(self, reports: Sequence[CellReport], arrays: Mapping[CellRef, dict[str, Any]]) -> Mapping[CellRef, dict[str, Any]]:
        """Take what became of cells, in any thread; gives their arrays where they stand from now on."""

    def earlier(self, refs: Iterable[CellRef]) -> dict[CellRef, CellReport]: ...

    def stored(self, refs: Iterable[CellRef], figures_only: bool = False) -> dict[CellRef, dict[str, Any]]: ...

    def lacks_pictures(self, shown: Iterable[CellRef]) -> bool: ...

    def interrupted(self, tables: Mapping[str, Any], abandoned: bool) -> None: ...

    def close(self, tables: dict[str, Any], sheet: Sheet | None, failed: bool) -> tuple[Any, list[Path]]:
        """End a run in order: the tree of its results where it is in memory, and the files of pictures."""
