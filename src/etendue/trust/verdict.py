"""The verdict of comparing an archive with its recomputation, cell by cell and as a whole.

In:  differences of arrays, and failures.
Out: a ``CellResult`` for each variable of each cell; a ``Reproduction`` with its verdict.

On the same platform every bit must agree. On another platform a cell may differ by the errors that its stage and the
stages before it state: their sum, relative to full scale, rms.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.archive.read.comparing import Compared
from etendue.archive.read.inspection import Damage
from etendue.contract.ports import CellReport
from etendue.plan.ancestry import ancestry
from etendue.plan.model import CellRef, Plan
from etendue.trust.comparing import NotChecked
from etendue.trust.sayings import Deviation
from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    from etendue.types.documents import Scalar


@dataclass(frozen=True)
class CellResult:
    """The result for one variable of one cell."""

    stage: str
    cell: str
    variable: str
    found: str  # same | within | beyond | unknown | damaged | failed
    largest: float | None = None
    relative: float | None = None
    allowed: float | None = None
    why: str = ""


@dataclass
class Reproduction:
    """The result of reproducing an archive.

    Attributes
    ----------
    platform : the properties of the platform that differ, as (recorded, now); empty on the same platform
    software : differences between the installed stages and the archive: distributions, code, versions of libraries
    differences : other contents that were not reproduced: coordinates, units, dims, tables, records
    damages : damaged files, except those of cells
    not_checked : contents that cannot be recomputed
    """

    folder: Path
    record: DocumentView
    platform: dict[str, tuple[Scalar, Scalar]]
    software: list[Document]
    order: list[str]
    cells: list[CellResult] = field(default_factory=list)
    differences: list[Deviation] = field(default_factory=list)
    damages: list[Damage] = field(default_factory=list)
    not_checked: list[NotChecked] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def verdict(self) -> str:
        found = {cell.found for cell in self.cells}
        if self.differences or self.damages:
            return "not reproduced"
        if not found:
            return "nothing to compare"
        if found == {"same"}:
            return "the same bits"
        return "within the stated errors" if found <= {"same", "within"} else "not reproduced"

    @property
    def reproduced(self) -> bool:
        return self.verdict in ("the same bits", "within the stated errors")


def judged_cell(
    plan: Plan, ref: CellRef, name: str, report: CellReport | None, damage: str, elsewhere: bool
) -> Iterable[CellResult]:
    """Return the verdict on a cell."""
    stage = ref[0]
    if damage:
        yield CellResult(stage, name, "", "damaged", why=damage)
    elif report is None or report.status in ("failed", "skipped"):
        yield CellResult(stage, name, "", "failed", why=report.message if report else "it was not computed")
    else:
        written = [one for one in report.written if isinstance(one, Compared)]
        same = all(one.difference is not None and one.difference.same for one in written)
        allowed = _allowed(plan, ref) if elsewhere and not same else None
        yield from (judged(stage, name, one, allowed, elsewhere) for one in written)


def judged(stage: str, name: str, one: Compared, allowed: float | None, elsewhere: bool) -> CellResult:
    """Return the verdict on one variable: all bits must agree or, ``elsewhere``, the difference must be within
    ``allowed``.
    """
    found = one.difference
    if found is None:
        return CellResult(stage, name, one.path, "damaged", why=one.damage)
    if found.same:
        return CellResult(stage, name, one.path, "same", 0.0, 0.0)
    told = (stage, name, one.path)
    if found.why:
        return CellResult(*told, "beyond", why=f"shape or type: {found.why}")
    if found.undefined:
        return CellResult(
            *told,
            "beyond",
            found.largest,
            None,
            allowed,
            f"{found.undefined} values are undefined in only one of the arrays",
        )
    if not elsewhere:
        return CellResult(
            *told, "beyond", found.largest, found.relative, None, "on the same platform every bit must agree"
        )
    if allowed is None:
        return CellResult(
            *told, "unknown", found.largest, found.relative, None, "its stage, or one before it, states no error"
        )
    inside = found.relative is not None and found.relative <= allowed
    return CellResult(*told, "within" if inside else "beyond", found.largest, found.relative, allowed)


def _allowed(plan: Plan, ref: CellRef) -> float | None:
    """Return the sum of the errors stated for a cell and for all cells that it depends on, relative to full scale; None
    if one of them states no error.
    """
    stated = [plan.cells[one].error[0] for one in ancestry(plan, [ref])]
    return None if None in stated else sum(error for error in stated if error is not None)
