"""Ports between rooms that do not know each other: where results go, and who is told.

``run`` computes and hands results to a ``Target`` of the run's ``Keeper``; ``archive`` implements both, on disk and in
memory; ``report`` draws a ``Sheet``; ``session`` joins them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    from etendue.plan.model import Cell, CellRef, Plan
    from etendue.plan.resume import Work
    from etendue.types.arrays import Array


@dataclass(frozen=True, slots=True)
class Written:
    """One stored chunk: its slot in a shard, and where its bytes were put when it was written."""

    path: str  # of the shard, below the archive
    slot: int  # number of the chunk in the shard
    part: str  # name of the unfinished file beside the shard that the bytes were appended to
    offset: int
    size: int
    digest: int  # crc32c, which stands behind the bytes as well


class Target(Protocol):
    """Where the variables of one cell are kept. Picklable: it travels with the work."""

    def write(self, arrays: Mapping[str, Any]) -> tuple[Written, ...]: ...

    def read(self, variable: str) -> Array: ...

    def read_band(self, variable: str, band: int) -> Array: ...

    def settle(self) -> None:
        """Called behind the last cell of a batch: what was written stands in its files before it is reported."""


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
    floored: float = 0.0  # sum of the variables that are counted
    platform: str = ""  # an earlier one, on which it was computed and accepted
    size: int = 0  # bytes of what was written, where that is no longer told one by one


class Progress(Protocol):
    """Told by the owner of a run, never by a worker."""

    def begin(self, cells: int) -> None: ...

    def starting(self, stages: tuple[str, ...]) -> None: ...

    def finished(self, reports: tuple[CellReport, ...]) -> None: ...

    def end(self) -> None: ...


@dataclass(frozen=True)
class Sheet:
    """Pictures of the shown cells: as a table of the archive, empty where that of an earlier run stays, and drawn
    into one PNG.
    """

    table: Document
    draw: Callable[[Path], None]
    shown: tuple[CellRef, ...]
    at: str  # their axis values


class Keeper(Protocol):
    """Where the results of a run are kept, and what is kept from earlier ones. Used as a context manager, by the owner
    of the run.

    Attributes
    ----------
    folder : where, if anywhere
    keeps_arrays : whether it takes the arrays of all cells from ``finished``; else from their ``target``
    draws : whether pictures are made of the shown cells
    mark : once begun, a file that all who write the results must see, and what it holds; None where nothing is written
    """

    folder: Path | None
    keeps_arrays: bool
    draws: bool
    mark: tuple[str, bytes] | None

    def __enter__(self) -> Keeper: ...

    def __exit__(self, *error: object) -> None: ...

    def begin(self, asked: Plan) -> Work: ...

    def target(self, cell: Cell) -> Target | None: ...

    def place(self, ref: CellRef, variable: str) -> Any:
        """Where a variable that is made piece by piece may be put at once, an array to be filled; None: it is taken
        when it is whole.
        """

    def starting(self, refs: Iterable[CellRef]) -> None: ...

    def finished(
        self, reports: Sequence[CellReport], arrays: Mapping[CellRef, dict[str, Any]]
    ) -> Mapping[CellRef, dict[str, Any]]:
        """Take what became of cells, in any thread; gives their arrays where they stand from now on."""

    def earlier(self, refs: Iterable[CellRef]) -> Iterable[CellReport]: ...

    def stored(
        self, refs: Iterable[CellRef], figures_only: bool = False, named: frozenset[str] | None = None
    ) -> dict[CellRef, dict[str, Array]]: ...

    def standing(self, others: Mapping[CellRef, dict[str, Array]]) -> Mapping[CellRef, dict[str, Array]]:
        """At the end: the arrays of all cells that it has taken, and ``others``, that it was given and does not
        keep.
        """

    def lacks_pictures(self, shown: Iterable[CellRef]) -> bool: ...

    def interrupted(self, tables: DocumentView, abandoned: bool) -> None: ...

    def close(self, tables: Document, sheet: Sheet | None, failed: bool) -> tuple[Any, list[Path]]:
        """End a run in order: the tree of its results where it is in memory, and the files of pictures."""


class Passing:
    """What keepers have in common that find nothing of earlier runs and leave nothing to later ones."""

    folder: Path | None = None
    mark: tuple[str, bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None: ...

    def starting(self, refs: Iterable[CellRef]) -> None: ...

    def earlier(self, refs: Iterable[CellRef]) -> Iterable[CellReport]:
        return ()

    def stored(
        self, refs: Iterable[CellRef], figures_only: bool = False, named: frozenset[str] | None = None
    ) -> dict[CellRef, dict[str, Array]]:
        return {}

    def interrupted(self, tables: DocumentView, abandoned: bool) -> None: ...
