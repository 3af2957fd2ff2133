"""Ports between packages that do not import each other: the destination of results, and the objects to notify.

``run`` computes and passes results to a ``Target`` of the run's ``Keeper``; ``archive`` implements both, on disk and in
memory; ``present`` draws a ``ContactSheet``; ``session`` joins them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    import xarray

    from etendue.plan.model import Cell, CellRef, Plan
    from etendue.plan.resume import Work
    from etendue.types.arrays import Array, CellArrays


@dataclass(frozen=True, slots=True)
class WrittenChunk:
    """One stored chunk: its slot in a shard, and the place of its bytes."""

    path: str  # of the shard, relative to the archive
    slot: int  # number of the chunk in the shard
    part: str  # name of the unfinished file next to the shard to which the bytes were appended
    offset: int
    size: int
    digest: int  # crc32c, which also follows the bytes in the file


class Target(Protocol):
    """The destination of the variables of one cell. Picklable, because it is sent with the work."""

    def write(self, arrays: Mapping[str, Any]) -> tuple[WrittenChunk, ...]: ...

    def read(self, variable: str) -> Array: ...

    def read_band(self, variable: str, band: int) -> Array: ...

    def settle(self) -> None:
        """Called after the last cell of a batch: everything written must be in its files before the batch is
        reported.
        """


@dataclass(slots=True)  # never changed after creation; freezing it would cost more than creating it
class CellReport:
    """The report of one cell."""

    stage: str
    index: tuple[int, ...]
    status: str  # done | left_out | failed | skipped
    seconds: float = 0.0
    written: tuple[WrittenChunk, ...] = ()
    message: str = ""
    clipped: float = 0.0
    clipped_flux: float = 0.0
    floored: float = 0.0  # sum of the counted variables
    platform: str = ""  # the earlier platform on which it was computed, if accepted
    size: int = 0  # bytes written, if the single chunks are no longer listed


class Progress(Protocol):
    """Notified by the owner of a run, never by a worker."""

    def begin(self, cells: int) -> None: ...

    def starting(self, stages: tuple[str, ...]) -> None: ...

    def finished(self, reports: tuple[CellReport, ...]) -> None: ...

    def end(self) -> None: ...


@dataclass(frozen=True)
class ContactSheet:
    """Pictures of one cell of each stage: as a table of the archive (empty if the table of an earlier run is kept), and
    a function that draws them into one PNG.
    """

    table: Document
    draw: Callable[[Path], None]
    shown: tuple[CellRef, ...]
    at: str  # their axis values


Seen = dict[str, Any]  # small pictures and metrics of a cell, by variable
Look = Callable[[Mapping[str, Any]], Seen]  # from the arrays of a cell to what is shown of it


class Keeper(Protocol):
    """The store of the results of a run and of earlier runs. The owner of the run uses it as a context manager.

    Attributes
    ----------
    folder : the folder of the store; None if it has no folder
    keeps_arrays : whether the arrays of all cells must be passed to ``finished``; if not, cells write them to their
        ``target``
    draws : whether the run makes pictures of one cell of each stage (``ContactSheet.shown``)
    mark : path and content of a file in the store, by which every process that writes results checks that it sees the
        same folder; valid after ``begin``; None if nothing is written to a folder
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
        """Return an array into which a variable can be written piece by piece; None if the variable is to be passed
        when complete.
        """

    def starting(self, refs: Iterable[CellRef]) -> None: ...

    def finished(
        self, reports: Sequence[CellReport], arrays: Mapping[CellRef, CellArrays]
    ) -> Mapping[CellRef, CellArrays]:
        """Take the reports of cells, in any thread; return their arrays as held by the store from now on."""

    def earlier(self, refs: Iterable[CellRef]) -> Iterable[CellReport]: ...

    def stored(
        self, refs: Iterable[CellRef], figures_only: bool = False, named: frozenset[str] | None = None
    ) -> dict[CellRef, dict[str, Array]]: ...

    def standing(self, others: Mapping[CellRef, dict[str, Array]]) -> Mapping[CellRef, dict[str, Array]]:
        """Return, at the end, the arrays of all cells received, and of the cells in ``others``, which the store does
        not keep.
        """

    def lacks_pictures(self, shown: Iterable[CellRef]) -> bool: ...

    def look_at(self, ref: CellRef, look: Look) -> Seen:
        """Return the value of the caller's function ``look`` for the arrays of a finished cell."""

    def interrupted(self, tables: DocumentView, abandoned: bool) -> None: ...

    def close(
        self, tables: Document, sheet: ContactSheet | None, failed: bool
    ) -> tuple[xarray.DataTree | None, list[Path]]:
        """End a run normally; return the tree of results if it is in memory, and the files of pictures."""


class Passing:
    """Base of stores that find no results of earlier runs and leave none for later runs."""

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

    def look_at(self, ref: CellRef, look: Look) -> Seen:
        return look(self.stored([ref]).get(ref, {}))

    def interrupted(self, tables: DocumentView, abandoned: bool) -> None: ...
