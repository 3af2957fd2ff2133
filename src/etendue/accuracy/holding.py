"""``run --hold``: the loosest local tolerance whose global error stays within a given one, found on pilot cells.

In:  a pipeline, and the global error asked for.
Out: a local tolerance from a fixed ladder, the errors measured with it, and the causes if none is strict enough.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.accuracy.blame import blamed
from etendue.accuracy.measuring import MeasuredErrors, Measurement, from_document
from etendue.accuracy.pilot import MOST
from etendue.archive.records.remembered import recall, remember
from etendue.contract.registry import Registry
from etendue.pipeline.file import PipelineFile
from etendue.plan.identity.keys import digest
from etendue.plan.model import Plan
from etendue.result_files import finite
from etendue.session import Options
from etendue.types.documents import AxisValues, Document, DocumentView

if TYPE_CHECKING:
    from etendue.contract.ports import Progress

LADDER = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 0.0)


@dataclass(frozen=True)
class HeldTolerance:
    """The result: with ``tolerance``, the wanted variables are as far from the reference as ``measured`` says.

    ``missed`` are variables whose error is larger than asked for, or unknown; ``blame`` the stages that cause it,
    largest share first (`studies.blame`).
    """

    asked: float
    tolerance: float
    norm: str
    measured: MeasuredErrors
    missed: tuple[str, ...]
    blame: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    remembered: bool = False
    key: str = ""
    places: tuple[AxisValues, ...] = ()

    @property
    def held(self) -> bool:
        return not self.missed

    def document(self) -> Document:
        return {
            "asked": self.asked,
            "tolerance": self.tolerance,
            "norm": self.norm,
            "held": self.held,
            "missed": list(self.missed),
            "blame": dict(self.blame),
            "seconds": self.seconds,
            "remembered": self.remembered,
        }


def hold(
    pipeline: PipelineFile,
    registry: Registry,
    asked: float,
    cells: int = MOST,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
    archive: Path | None = None,
) -> HeldTolerance:
    """Find the tolerance for a pipeline. A result that ``keep`` has stored in an archive is reused until one of its
    cells changes.

    Raises
    ------
    RequestError
        The pipeline is invalid.
    """
    pipeline = replace(pipeline, tolerance=_rung(asked))
    measurement = Measurement(pipeline, registry, cells, options, progress)
    key = digest(f"hold {asked:g} {pipeline.norm} {measurement.key()}".encode())
    known = _remembered(recall(archive, key), asked, pipeline.norm) if archive is not None else None
    found = known or replace(_search(measurement, asked, pipeline.norm), key=key)
    return replace(found, places=measurement.places)


def keep(held: HeldTolerance, archive: Path) -> None:
    """Store the result in an archive, which exists by now."""
    if not held.remembered:
        remember(archive, held.key, finite({**held.document(), "measured": held.measured.document()}))


def _rung(asked: float) -> float:
    """Return the strictest rung of the ladder that is no stricter than what is asked for."""
    return min((rung for rung in LADDER if rung >= asked), default=LADDER[0])


def _search(measurement: Measurement, asked: float, norm: str) -> HeldTolerance:
    """Loosen the tolerance as long as the error is held, or tighten it until it is."""
    tried: dict[float, MeasuredErrors] = {}
    plans: dict[float, Plan] = {}

    def measured(rung: float) -> MeasuredErrors:
        plans[rung] = measurement.plan(replace(measurement.pipeline, tolerance=rung))
        same = next((other for other in tried if _equal(plans[rung], plans[other])), None)
        tried[rung] = measurement.errors(rung) if same is None else tried[same]
        return tried[rung]

    at = LADDER.index(_rung(asked))
    if not missed(measured(LADDER[at]), asked, norm):
        while at > 0 and not missed(measured(LADDER[at - 1]), asked, norm):
            at -= 1
        return HeldTolerance(asked, LADDER[at], norm, tried[LADDER[at]], (), seconds=measurement.seconds)
    while at + 1 < len(LADDER):
        at += 1
        if not missed(measured(LADDER[at]), asked, norm):
            return HeldTolerance(asked, LADDER[at], norm, tried[LADDER[at]], (), seconds=measurement.seconds)
    best = min(tried, key=lambda rung: (len(missed(tried[rung], asked, norm)), tried[rung].worst or 0.0, -rung))
    lacking = missed(tried[best], asked, norm)
    blame = blamed(measurement, plans[best], tried[best], lacking, asked, norm)
    return HeldTolerance(asked, best, norm, tried[best], lacking, blame, measurement.seconds)


def missed(found: MeasuredErrors, asked: float, norm: str) -> tuple[str, ...]:
    """Return the variables that are not known to be within what is asked for."""
    return tuple(name for name, error in found.errors.items() if error.held(asked, norm) is not True)


def _equal(one: Plan, other: Plan) -> bool:
    return one.precision == other.precision and all(cell.key == other.cells[ref].key for ref, cell in one.cells.items())


def _remembered(document: DocumentView | None, asked: float, norm: str) -> HeldTolerance | None:
    """Return the result of an earlier run; None if the document has another form."""
    try:
        if document is None:
            return None
        measured = from_document(document["measured"])
        if measured is None:
            return None
        return HeldTolerance(
            asked,
            float(document["tolerance"]),
            norm,
            measured,
            tuple(document["missed"]),
            dict(document["blame"]),
            float(document["seconds"]),
            remembered=True,
        )
    except (KeyError, TypeError, ValueError):
        return None
