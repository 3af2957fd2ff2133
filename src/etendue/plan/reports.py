"""The reports of the cells of a plan, as arrays with 18 bytes per cell, plus objects for the few cells with more to
report.

In:  the report of each cell when it ends.
Out: the reports by cell, made on request; sums over the cells of a stage.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from etendue.contract.ports import CellReport
from etendue.plan.model import CellRef, Plan

STATUSES = ("", "done", "left_out", "failed", "skipped", "loaded", "reused")  # '': no report yet
DONE, LEFT_OUT, FAILED, SKIPPED, REUSED = (
    STATUSES.index(name) for name in ("done", "left_out", "failed", "skipped", "reused")
)
Rest = tuple[float, float, float, str, str]  # clipped, clipped_flux, floored, platform, message
NOTHING: Rest = (0.0, 0.0, 0.0, "", "")


class Reports(Mapping[CellRef, CellReport]):
    """The last report of each cell, with the number of bytes instead of the files written.

    Attributes
    ----------
    status, seconds, size : by number of a cell (``plan.numbers``)
    rest : only for the cells that report a value other than ``NOTHING``
    """

    def __init__(self, plan: Plan) -> None:
        count = plan.numbers.count
        self.plan, self.number = plan, plan.numbers.of
        self.status = bytearray(count)
        self.seconds, self.size = array("d", bytes(8 * count)), array("q", bytes(8 * count))
        self.rest: dict[int, Rest] = {}

    def take(self, reports: Iterable[CellReport]) -> None:
        for one in reports:
            number = self.number((one.stage, one.index))
            self.status[number], self.seconds[number] = STATUSES.index(one.status), one.seconds
            self.size[number] = one.size if one.size else sum([file.size for file in one.written])
            rest = (one.clipped, one.clipped_flux, one.floored, one.platform, one.message)
            if rest != NOTHING:
                self.rest[number] = rest
            else:
                self.rest.pop(number, None)

    def reuse(self, refs: Iterable[CellRef]) -> None:
        """Mark cells as reused: an earlier run finished them."""
        for ref in refs:
            self.status[self.number(ref)] = REUSED

    def of(self, plan: Plan, cells: Mapping[CellRef, CellRef]) -> Reports:
        """Return the reports of the cells of another plan; ``cells`` maps them to the cells of this plan."""
        if plan.axes == self.plan.axes:
            return self
        found = Reports(plan)
        found.take(replace(self[own], index=ref[1]) for ref, own in cells.items() if own in self)
        return found

    # -- the mapping --------------------------------------------------------------------------------------------------

    def __contains__(self, ref: object) -> bool:
        return ref in self.plan.cells and self.status[self.number(ref)] > 0  # type: ignore[arg-type]

    def __getitem__(self, ref: CellRef) -> CellReport:
        if ref not in self:
            raise KeyError(ref)
        return self._at(self.number(ref), ref)

    def __iter__(self) -> Iterator[CellRef]:
        return (ref for ref, status in zip(self.plan.cells, self.status, strict=True) if status)

    def __len__(self) -> int:
        return len(self.status) - self.status.count(0)

    def _at(self, number: int, ref: CellRef) -> CellReport:
        clipped, flux, floored, platform, message = self.rest.get(number, NOTHING)
        return CellReport(
            *ref,
            STATUSES[self.status[number]],
            self.seconds[number],
            (),
            message,
            clipped,
            flux,
            floored,
            platform,
            self.size[number],
        )

    # -- over many cells
    # ------------------------------------------------------------------------------------------------

    def numbers(self, stage: str | None = None) -> range:
        """Return the numbers of the cells of a stage, or of all cells."""
        return range(len(self.status)) if stage is None else self.plan.numbers.range(stage)

    def count(self, *statuses: int, stage: str | None = None) -> int:
        """Return the number of cells with one of these statuses."""
        own = self.numbers(stage)
        return sum(self.status.count(status, own.start, own.stop) for status in statuses)

    def having(self, *statuses: int) -> list[CellReport]:
        """Return the reports of the cells with one of these statuses."""
        if not self.count(*statuses):
            return []
        return [self._at(number, ref) for number, ref in enumerate(self.plan.cells) if self.status[number] in statuses]

    def seconds_of(self, stage: str | None = None) -> float:
        """Return the CPU time in seconds of the computed cells of a stage, or of all stages."""
        return math.fsum(self.seconds[n] for n in self.numbers(stage) if self.status[n] in (DONE, LEFT_OUT))

    def bytes_of(self, stage: str) -> int:
        """Return the bytes that the cells of a stage have written."""
        own = self.numbers(stage)
        return sum(self.size[own.start : own.stop])

    def counted(self, stage: str) -> list[float]:
        """Return the counts of values raised to a floor or above saturation, for each cell of a stage with
        such counts.
        """
        own = self.numbers(stage)
        return [rest[2] for number, rest in self.rest.items() if number in own and rest[2] > 0]

    def most_clipped(self) -> CellReport | None:
        """Return the report of the cell with the most negative light clipped; None if no light was clipped."""
        worst = max(self.rest, key=lambda number: self.rest[number][1], default=None)
        if worst is None or not self.rest[worst][1] > 0:
            return None
        return next(self._at(worst, ref) for number, ref in enumerate(self.plan.cells) if number == worst)
