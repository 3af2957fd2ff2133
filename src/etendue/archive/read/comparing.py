"""A storage backend that stores nothing: it compares every computed cell with the archived cell and discards the
computed arrays.

In:  an archive, and a plan of the same cells.
Out: a ``Compared`` for every variable of every cell, in the reports of the run; no file is written.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.archive.read.differing import Difference, between, together
from etendue.archive.read.stored import Stored, StoredArrays
from etendue.archive.sharding.partition import Cutter
from etendue.archive.structure.naming import cell_name
from etendue.contract.ports import CellReport, ContactSheet, Passing, WrittenChunk
from etendue.errors import ArchiveError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.plan.resume import Work, select
from etendue.types.arrays import Array, CellArrays

if TYPE_CHECKING:
    from etendue.types.documents import Document


@dataclass(frozen=True, slots=True)
class Compared(WrittenChunk):
    """The difference between a computed and a stored variable, used in place of a written chunk; ``damage`` says why
    the stored variable cannot be read.
    """

    difference: Difference | None = None
    damage: str = ""

    @classmethod
    def of(cls, variable: str, difference: Difference | None, damage: str = "") -> Compared:
        return cls(variable, 0, "", 0, 0, 0, difference, damage)


@dataclass(frozen=True)
class Comparing:
    """The target of one cell. It compares in the worker that computed the cell, so that no array is transferred."""

    cell: StoredArrays

    def write(self, arrays: Mapping[str, Any]) -> tuple[WrittenChunk, ...]:
        """Compare arrays with the stored arrays; return a ``Compared`` for each variable."""
        found = []
        for variable in self.cell.variables:
            try:
                found.append(Compared.of(variable, self._difference(variable, arrays[variable])))
            except ArchiveError as error:
                found.append(Compared.of(variable, None, str(error)))
        return tuple(found)

    def _difference(self, variable: str, array: Any) -> Difference:
        windows, cutter = self.cell.windows(variable), Cutter(array)
        # Compare chunk by chunk where the shapes agree, so that the stored array is never held as a whole.
        if windows[0] is None or tuple(array.shape) != tuple(
            max(end for _, end in one) for one in zip(*filter(None, windows), strict=True)
        ):
            return between(self.cell.read(variable), np.asarray(array))
        return together(between(part, cutter.part(window)) for window, part in self.cell.parts(variable))

    def read(self, variable: str) -> Any:
        return self.cell.read(variable)

    def read_band(self, variable: str, band: int) -> Any:
        """Return one band of the stored array. If light does not fit into memory, the next stage reads it from here
        after the comparison.
        """
        return self.cell.read_band(variable, band)

    def settle(self) -> None: ...


class ComparingKeeper(Passing):
    """Compare computed cells with stored cells instead of storing them. Use as a context manager. ``reports``: the
    result of the comparison for each cell; ``sheet``: pictures of the cells in ``shown`` (one per stage), for the
    variables in ``drawn``."""

    keeps_arrays = False

    def __init__(
        self,
        stored: Stored,
        names: Iterable[str],
        shown: Mapping[str, CellRef] | None = None,
        drawn: Collection[tuple[str, str]] = (),
    ) -> None:
        self.stored_cells, self.asked = stored, set(names)
        self.draws, self.shown, self.drawn = bool(shown and drawn), shown or {}, frozenset(drawn)
        self.sheet: ContactSheet | None = None
        self.reports: dict[str, CellReport] = {}
        self.damaged: dict[str, str] = {}

    def begin(self, asked: Plan) -> Work:
        self.names = {ref: cell_name(asked, ref) for ref in asked.cells}
        wanted = {ref for ref, name in self.names.items() if name in self.asked}
        # Also what has no array is compared: with the array that has its values.
        whole = replace(asked, copied=asked.kept)
        return Work(whole, {ref: ref for ref in asked.cells}, select(whole, set(), wanted), shown=self.shown)

    def target(self, cell: Cell) -> Comparing | None:
        name = self.names[cell.ref]
        if name not in self.asked or name not in self.stored_cells.finished:
            return None
        try:
            found = self.stored_cells.cell(name)
            return Comparing(found) if found.chunks else None
        except ArchiveError as error:
            self.damaged[name] = str(error)
            return None

    def place(self, ref: CellRef, variable: str) -> None: ...

    def finished(
        self, reports: Sequence[CellReport], arrays: Mapping[CellRef, CellArrays]
    ) -> Mapping[CellRef, CellArrays]:
        self.reports.update({self.names[r.stage, r.index]: r for r in reports})
        return {ref: {v: one for v, one in own.items() if (ref[0], v) in self.drawn} for ref, own in arrays.items()}

    def standing(self, others: Mapping[CellRef, dict[str, Array]]) -> Mapping[CellRef, dict[str, Array]]:
        return others

    def lacks_pictures(self, shown: Iterable[CellRef]) -> bool:
        return False

    def close(self, tables: Document, sheet: ContactSheet | None, failed: bool) -> tuple[None, list[Path]]:
        self.sheet = sheet
        return None, []
