"""A keeper that keeps nothing: every cell that a run computes is held against the one an archive has, and forgotten.

In:  an archive, a plan of the same cells.
Out: a ``Compared`` for every variable of every cell, in the reports of the run; nothing is written anywhere.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from etendue.archive.differing import Difference, between, together
from etendue.archive.naming import cell_name
from etendue.archive.pieces import Cutter
from etendue.archive.stored import Stored, StoredArrays
from etendue.contract.ports import CellReport, Passing, Sheet, Written
from etendue.errors import ArchiveError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.plan.resume import Work, select
from etendue.types.arrays import Array


@dataclass(frozen=True, slots=True)
class Compared(Written):
    """In the place of a chunk written: how far a variable is from the stored one; ``damage`` where that cannot be
    read.
    """

    difference: Difference | None = None
    damage: str = ""

    @classmethod
    def of(cls, variable: str, difference: Difference | None, damage: str = "") -> Compared:
        return cls(variable, 0, "", 0, 0, 0, difference, damage)


@dataclass(frozen=True)
class Comparing:
    """The target of one cell: compares in the worker that made it, so that no array travels."""

    cell: StoredArrays

    def write(self, arrays: Mapping[str, Any]) -> tuple[Written, ...]:
        """Hold arrays against the stored ones."""
        found = []
        for variable in self.cell.variables:
            try:
                found.append(Compared.of(variable, self._difference(variable, arrays[variable])))
            except ArchiveError as error:
                found.append(Compared.of(variable, None, str(error)))
        return tuple(found)

    def _difference(self, variable: str, array: Any) -> Difference:
        windows, cutter = self.cell.windows(variable), Cutter(array)
        if windows[0] is None or tuple(array.shape) != tuple(
            max(end for _, end in one) for one in zip(*filter(None, windows), strict=True)
        ):
            return between(self.cell.read(variable), np.asarray(array))
        return together(between(part, cutter.part(window)) for window, part in self.cell.parts(variable))

    def read(self, variable: str) -> Any:
        return self.cell.read(variable)

    def read_band(self, variable: str, band: int) -> Any:
        """One band of what is stored: light that is too large to be held goes on from there, once it has been
        compared.
        """
        return self.cell.read_band(variable, band)

    def settle(self) -> None: ...


class ComparingKeeper(Passing):
    """Use as a context manager. ``reports``: what became of each cell; ``sheet``: pictures of the cells ``shown``, one
    of each stage, of the variables ``drawn``."""

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
        self.sheet: Sheet | None = None
        self.reports: dict[str, CellReport] = {}
        self.damaged: dict[str, str] = {}

    def begin(self, asked: Plan) -> Work:
        self.names = {ref: cell_name(asked, ref) for ref in asked.cells}
        wanted = {ref for ref, name in self.names.items() if name in self.asked}
        return Work(asked, {ref: ref for ref in asked.cells}, select(asked, set(), wanted), shown=self.shown)

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
        self, reports: Sequence[CellReport], arrays: Mapping[CellRef, dict[str, Any]]
    ) -> Mapping[CellRef, dict[str, Any]]:
        self.reports.update({self.names[r.stage, r.index]: r for r in reports})
        return {ref: {v: one for v, one in own.items() if (ref[0], v) in self.drawn} for ref, own in arrays.items()}

    def standing(self, others: Mapping[CellRef, dict[str, Array]]) -> Mapping[CellRef, dict[str, Array]]:
        return others

    def lacks_pictures(self, shown: Iterable[CellRef]) -> bool:
        return False

    def close(self, tables: dict[str, Any], sheet: Sheet | None, failed: bool) -> tuple[Any, list[Path]]:
        self.sheet = sheet
        return None, []
