"""``run --hold``: find the loosest local tolerance, and values for the parameters that the pipeline leaves open, with
which the error stays within the requested error. The search uses pilot cells.

In:  a pipeline, and the requested error.
Out: discretisations for open parameters (`discretising`); a local tolerance from a fixed ladder, and the errors
     measured with it. If no tolerance is strict enough, the causes; if the budget ends the search, the seconds and
     bytes of the next run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.accuracy.answers.cached import answer_key
from etendue.accuracy.blame import blamed
from etendue.accuracy.discretising import SHARE, Chosen, Refinement
from etendue.accuracy.measuring import GlobalError, MeasuredErrors, Measurement, from_document, shown_names
from etendue.accuracy.pilot import MOST
from etendue.archive.records.choices import kept_choices
from etendue.archive.records.remembered import latest, recall, remember
from etendue.contract.registry import Registry
from etendue.errors import RequestError, nearest
from etendue.pipeline.file import PipelineFile
from etendue.plan.expansion.search import Goal, Knob, Means, OverBudget, Search, Settings, Trial
from etendue.plan.identity.keys import digest
from etendue.plan.machine import available_memory
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.plan.wiring.automatic import left_open, with_chosen
from etendue.result_files import finite
from etendue.run.peak_memory import workers_of
from etendue.session import Options
from etendue.types.documents import AxisValues, Document, DocumentView

if TYPE_CHECKING:
    from etendue.contract.ports import Progress

CHOICES = "choices"  # ``kind`` of the document with the values of open parameters
RUNGS = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 0.0)
LADDER = Knob("", "tolerance", RUNGS)
FIRST = 1e-3  # tolerance tried first if only errors of metrics are requested
MEMORY = 0.8  # fraction of the available memory that one run of the search may take


@dataclass(frozen=True)
class Asked:
    """The requested errors: ``relative`` to full scale for every variable, and ``own`` for some variables in their
    units. If ``relative`` is None, only the variables in ``own`` count.

    ``spent`` is the error of discretisation, relative to full scale. The remaining error must cover ``factor`` times
    the error of the measured points.
    """

    relative: float | None
    own: Mapping[str, float] = field(default_factory=dict)
    spent: Mapping[str, float] = field(default_factory=dict)
    factor: float = 1.0

    def asks(self, name: str) -> bool:
        return self.relative is not None or name in self.own

    def of_scale(self, name: str, scale: float) -> float:
        """Return the requested error of a variable, relative to its full scale ``scale``; infinite if none is
        requested.
        """
        if name not in self.own:
            return math.inf if self.relative is None else self.relative
        return self.own[name] / scale if scale else 0.0

    def limit(self, name: str, error: GlobalError) -> float | None:
        """Return the error that remains for omissions and coarser settings, relative to the full scale of the variable;
        None if no error is requested.
        """
        if not self.asks(name):
            return None
        whole = self.of_scale(name, error.scale or 0.0)
        spent = self.spent.get(name, 0.0)
        # If discretisation uses up the whole error, this is reported elsewhere; omissions may still use their fraction.
        return max(whole - spent, (1 - SHARE) * whole) / self.factor if self.spent else whole

    def limits(self, found: MeasuredErrors) -> dict[str, float]:
        every = {name: self.limit(name, error) for name, error in found.errors.items()}
        return {name: limit for name, limit in every.items() if limit is not None}

    def __str__(self) -> str:
        own = [f"{name}={value:g}" for name, value in self.own.items()]
        return " ".join(([] if self.relative is None else [f"{self.relative:g}"]) + own)


@dataclass(frozen=True)
class Rung(Trial):
    """A local tolerance, its plan, and the global errors measured with it."""

    tolerance: float
    plan: Plan
    measured: MeasuredErrors
    missed: tuple[str, ...]
    hopeless: bool  # for every missed variable, the reference is more uncertain than the requested error


@dataclass(frozen=True)
class HeldTolerance:
    """The result: a ``tolerance``, and the errors ``measured`` with it.

    ``missed``: variables whose error exceeds the requested error or is unknown. ``blame``: shares of the stages that
    cause this, largest first (`accuracy.blame`).
    """

    asked: Asked
    tolerance: float
    norm: str
    measured: MeasuredErrors
    missed: tuple[str, ...]
    blame: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    needed: Means | None = None  # cost of the next run, if the search ended because this exceeds the budget
    remembered: bool = False
    key: str = ""
    places: tuple[AxisValues, ...] = ()
    chosen: Chosen | None = None  # values of open parameters; None if the pipeline leaves none open

    @property
    def held(self) -> bool:
        return not self.missed and not (self.chosen and self.chosen.missed)

    def document(self) -> Document:
        return {
            "asked": self.asked.relative,
            "asked_of": dict(self.asked.own),
            "limits": self.asked.limits(self.measured),
            "tolerance": self.tolerance,
            "norm": self.norm,
            "held": self.held,
            "missed": list(self.missed),
            "blame": dict(self.blame),
            "seconds": self.seconds,
            "needed": asdict(self.needed) if self.needed else None,
            "remembered": self.remembered,
            "discretisation": self.chosen.document() if self.chosen else None,
        }


def hold(
    pipeline: PipelineFile,
    registry: Registry,
    asked: float | Asked,
    cells: int = MOST,
    options: Options | None = None,
    progress: Callable[[Plan], Progress] | None = None,
    archive: Path | None = None,
) -> HeldTolerance:
    """Find the tolerance for a pipeline. A result that ``keep`` has stored in an archive is reused until one of its
    cells changes.

    The search ends before a run that is expected to exceed a fraction of the available memory or, together with the
    runs before it, the ``hold_seconds`` of the options.

    Raises
    ------
    RequestError
        The pipeline is invalid, or none of its wanted variables has a requested error.
    """
    asked, options = asked if isinstance(asked, Asked) else Asked(asked), options or Options()
    chosen = _choose(pipeline, registry, asked, options, progress, archive)
    if chosen:
        pipeline = with_chosen(pipeline, chosen.values)
        asked = replace(asked, spent=chosen.spent, factor=chosen.factor)
        options = replace(options, hold_seconds=max(options.hold_seconds - chosen.seconds, 0.0))
    begin = FIRST if asked.relative is None else asked.relative
    pipeline = replace(pipeline, tolerance=min((rung for rung in RUNGS if rung >= begin), default=RUNGS[0]))
    measurement = Measurement(pipeline, registry, cells, options, progress)
    _refuse_unwanted(asked, measurement.plan(measurement.pipeline))
    spent = f" {sorted(asked.spent.items())} {asked.factor}" if asked.spent else ""
    key = digest(f"hold {asked}{spent} {pipeline.norm} {measurement.key()}".encode())
    known = _remembered(recall(archive, key), asked, pipeline.norm) if archive is not None else None
    found = known or replace(_search(measurement, asked, pipeline.norm), key=key)
    return replace(found, places=measurement.places, chosen=chosen)


def _refuse_unwanted(asked: Asked, plan: Plan) -> None:
    names = list(shown_names(plan).values())
    for name in asked.own:
        if name not in names:
            wanted = f"; wanted: {', '.join(names[:12])}{' ...' if len(names) > 12 else ''}"
            raise RequestError(f"--hold {name}: no wanted variable has this name{nearest(name, names)}{wanted}")


def _choose(
    pipeline: PipelineFile, registry: Registry, asked: Asked, options: Options, progress: Any, archive: Path | None
) -> Chosen | None:
    """Return values for the parameters that a pipeline leaves open; None if it leaves none open.

    Values that an earlier run into the archive has chosen are kept if the requested errors are the same; otherwise the
    search starts from them.
    """
    open_ = left_open(pipeline, registry)
    if not open_:
        return None
    kept = kept_choices(pipeline, registry, archive) if archive is not None else {}
    pipeline = with_chosen(pipeline, kept)
    plan = make_plan(pipeline, registry)
    _refuse_unwanted(asked, plan)
    known = (latest(archive, CHOICES) if archive is not None else None) or {}
    same = bool(kept) and known.get("asked") == str(asked) and known.get("values") == kept
    if same and known.get("cells") == answer_key(plan):
        return Chosen(kept, (), known["spent"], known["factor"], known["missed"], known["needed"], kept=True)
    workers = workers_of(options.scheduler, options.workers)
    search = Refinement(plan.pipeline, registry, open_, asked, options.hold_seconds, workers, progress)
    return replace(search.found(refine=not same), kept=same)


def keep(held: HeldTolerance, archive: Path, plan: Plan | None = None) -> None:
    """Store the result of a complete search in an archive, which exists by now. ``plan``: the plan of the run."""
    if not (held.remembered or held.needed):
        remember(archive, held.key, finite({**held.document(), "measured": held.measured.document()}))
    if held.chosen and plan is not None:
        # The key is made from the cells of the request, which does not contain the tolerance found.
        told = {"kind": CHOICES, "asked": str(held.asked), "cells": answer_key(plan)}
        remember(archive, digest(CHOICES.encode()), finite({**held.chosen.document(), **told}))


def _search(measurement: Measurement, asked: Asked, norm: str) -> HeldTolerance:
    """Loosen the tolerance as long as the error stays within the requested error, or tighten it until the error does.

    The uncertainty of the reference does not depend on the tolerance, so no tolerance is tried for variables that are
    missed for this reason alone.
    """

    def evaluate(settings: Settings) -> Rung:
        tolerance = float(settings[LADDER.key])
        plan = measurement.plan(replace(measurement.pipeline, tolerance=tolerance))
        same = next((other for other in search.tried.values() if _equal(plan, other.plan)), None)
        before = measurement.seconds
        try:
            found = same.measured if same else measurement.compared(plan, measurement.run(plan), before)
        except OverBudget:
            if search.tried:
                raise
            found = measurement.unknown(plan, "measuring it would exceed the time of --hold")
        lacking, limits = missed(found, asked, norm), asked.limits(found)
        hopeless = bool(lacking) and all(found.errors[name].below > limits[name] for name in lacking)
        error = None if lacking else max((_share(found.errors[n].value(norm), limits[n]) for n in limits), default=0.0)
        return Rung(settings, error, tolerance, plan, found, lacking, hopeless)

    budget = Means(measurement.options.hold_seconds, MEMORY * available_memory() or math.inf)
    search = Search(evaluate, budget=budget)
    measurement.before = lambda need: search.afford(need, measurement.seconds)
    best, blame = search.stepped(LADDER, measurement.pipeline.tolerance, Goal(1.0), lambda one: one.hopeless), {}
    if best is None:
        best = min(search.tried.values(), key=lambda one: (len(one.missed), one.measured.worst or 0.0, -one.tolerance))
        with suppress(OverBudget):  # errors that were not measured cannot be attributed
            blame = (
                {}
                if search.lacking and best.measured.worst is None
                else blamed(measurement, best.plan, best.measured, best.missed, asked.limits(best.measured), norm)
            )
    seconds = measurement.seconds
    return HeldTolerance(asked, best.tolerance, norm, best.measured, best.missed, blame, seconds, search.lacking)


def _share(value: float | None, limit: float) -> float:
    """Return the ratio of an error to the requested error."""
    return value / limit if value and limit else 0.0


def missed(found: MeasuredErrors, asked: Asked, norm: str) -> tuple[str, ...]:
    """Return the variables whose error is not known to be within the requested error."""
    return tuple(n for n, limit in asked.limits(found).items() if found.errors[n].held(limit, norm) is not True)


def _equal(one: Plan, other: Plan) -> bool:
    return one.precision == other.precision and all(cell.key == other.cells[ref].key for ref, cell in one.cells.items())


def _remembered(document: DocumentView | None, asked: Asked, norm: str) -> HeldTolerance | None:
    """Return the result of an earlier run; None if the document has another form."""
    measured = from_document(document.get("measured", {})) if document else None
    if document is None or measured is None:
        return None
    try:
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
