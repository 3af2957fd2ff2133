"""``run --hold``: the loosest local tolerance whose global error stays within a given one, found on pilot cells.

In:  a pipeline, the global error that is asked for.
Out: a local tolerance from a fixed ladder, what was measured with it, and who is to blame where none is strict enough.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from etendue.accuracy.blame import blamed
from etendue.accuracy.measuring import Measured, Measurement, from_document
from etendue.accuracy.pilot import MOST
from etendue.archive.remembered import recall, remember
from etendue.contract.registry import Registry
from etendue.pipeline.file import Pipeline
from etendue.plan.keys import digest
from etendue.plan.model import Plan
from etendue.result_files import finite
from etendue.session import Options
from etendue.types.documents import Document, DocumentView, Place

LADDER = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 0.0)


@dataclass(frozen=True)
class Held:
    """What was found: with ``tolerance`` the wanted variables are as far from the reference as ``measured`` says.

    ``missed`` are variables whose error is larger than asked for, or not known; ``blame`` the stages that this is due
    to, the largest share first (`studies.blame`).
    """

    asked: float
    tolerance: float
    norm: str
    measured: Measured
    missed: tuple[str, ...]
    blame: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    remembered: bool = False
    key: str = ""
    places: tuple[Place, ...] = ()

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
    pipeline: Pipeline,
    registry: Registry,
    asked: float,
    cells: int = MOST,
    options: Options | None = None,
    progress: Any = None,
    archive: Path | None = None,
) -> Held:
    """Find the tolerance for a pipeline. What ``keep`` has put into an archive is used until a cell that it was found
    on changes.

    Raises
    ------
    RequestError
        The pipeline is wrong.
    """
    pipeline = replace(pipeline, tolerance=_rung(asked))
    measurement = Measurement(pipeline, registry, cells, options, progress)
    key = digest(f"hold {asked:g} {pipeline.norm} {measurement.key()}".encode())
    known = _remembered(recall(archive, key), asked, pipeline.norm) if archive is not None else None
    found = known or replace(_search(measurement, asked, pipeline.norm), key=key)
    return replace(found, places=measurement.places)


def keep(held: Held, archive: Path) -> None:
    """Remember in an archive that exists now what was found for it."""
    if not held.remembered:
        remember(archive, held.key, finite({**held.document(), "measured": held.measured.document()}))


def _rung(asked: float) -> float:
    """The strictest rung of the ladder that is no stricter than what is asked for."""
    return min((rung for rung in LADDER if rung >= asked), default=LADDER[0])


def _search(measurement: Measurement, asked: float, norm: str) -> Held:
    """Up the ladder as long as the error is held, down it until it is."""
    tried: dict[float, Measured] = {}
    plans: dict[float, Plan] = {}

    def measured(rung: float) -> Measured:
        plans[rung] = measurement.plan(replace(measurement.pipeline, tolerance=rung))
        same = next((other for other in tried if _equal(plans[rung], plans[other])), None)
        tried[rung] = measurement.errors(rung) if same is None else tried[same]
        return tried[rung]

    at = LADDER.index(_rung(asked))
    if not missed(measured(LADDER[at]), asked, norm):
        while at > 0 and not missed(measured(LADDER[at - 1]), asked, norm):
            at -= 1
        return Held(asked, LADDER[at], norm, tried[LADDER[at]], (), seconds=measurement.seconds)
    while at + 1 < len(LADDER):
        at += 1
        if not missed(measured(LADDER[at]), asked, norm):
            return Held(asked, LADDER[at], norm, tried[LADDER[at]], (), seconds=measurement.seconds)
    best = min(tried, key=lambda rung: (len(missed(tried[rung], asked, norm)), tried[rung].worst or 0.0, -rung))
    lacking = missed(tried[best], asked, norm)
    blame = blamed(measurement, plans[best], tried[best], lacking, asked, norm)
    return Held(asked, best, norm, tried[best], lacking, blame, measurement.seconds)


def missed(found: Measured, asked: float, norm: str) -> tuple[str, ...]:
    """The variables of which it is not known that they are within what is asked for."""
    return tuple(name for name, error in found.errors.items() if error.held(asked, norm) is not True)


def _equal(one: Plan, other: Plan) -> bool:
    return one.precision == other.precision and all(cell.key == other.cells[ref].key for ref, cell in one.cells.items())


def _remembered(document: DocumentView | None, asked: float, norm: str) -> Held | None:
    """What an earlier run has found; None where it is no such thing."""
    try:
        if document is None:
            return None
        measured = from_document(document["measured"])
        if measured is None:
            return None
        return Held(
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
