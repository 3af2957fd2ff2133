"""``run --hold``: values of what the pipeline leaves open, and the loosest local tolerance, whose error stays within a
given one; found on pilot cells.

In:  a pipeline, and the error asked for.
Out: discretisations for what is left open (`discretising`); a local tolerance from a fixed ladder, the errors measured
     with it, and the causes if none is strict enough, or what the search would have needed to go on.
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

CHOICES = "choices"  # ``kind`` of the document with the values of what a pipeline leaves open
RUNGS = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 0.0)
LADDER = Knob("", "tolerance", RUNGS)
FIRST = 1e-3  # tolerance tried first if only metrics are to be held
MEMORY = 0.8  # share of the available memory that one of its runs may take


@dataclass(frozen=True)
class Asked:
    """The errors asked for: ``relative`` to full scale for every variable, and ``own`` of some in their own unit. With
    None for ``relative`` only these count.

    ``spent``, relative to full scale, is the error that discretisation has already; what is left holds at ``factor``
    times the error of the measured points.
    """

    relative: float | None
    own: Mapping[str, float] = field(default_factory=dict)
    spent: Mapping[str, float] = field(default_factory=dict)
    factor: float = 1.0

    def asks(self, name: str) -> bool:
        return self.relative is not None or name in self.own

    def of_scale(self, name: str, scale: float) -> float:
        """Return what is asked of a variable with this full scale, relative to it; infinite: nothing."""
        if name not in self.own:
            return math.inf if self.relative is None else self.relative
        return self.own[name] / scale if scale else 0.0

    def limit(self, name: str, error: GlobalError) -> float | None:
        """Return what is left for a variable, relative to its full scale; None: nothing is asked."""
        if not self.asks(name):
            return None
        whole = self.of_scale(name, error.scale or 0.0)
        spent = self.spent.get(name, 0.0)
        # Where discretisation takes it all, that is said; what is left out may still take its share.
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
    hopeless: bool  # every variable that is missed has a reference more uncertain than what is asked for


@dataclass(frozen=True)
class HeldTolerance:
    """The result: with ``tolerance``, the wanted variables are as far from the reference as ``measured`` says.

    ``missed`` are variables whose error is larger than asked for, or unknown; ``blame`` the stages that cause it,
    largest share first (`studies.blame`).
    """

    asked: Asked
    tolerance: float
    norm: str
    measured: MeasuredErrors
    missed: tuple[str, ...]
    blame: Mapping[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    needed: Means | None = None  # by the next run, if the search ended because it may not take that
    remembered: bool = False
    key: str = ""
    places: tuple[AxisValues, ...] = ()
    chosen: Chosen | None = None  # values of what the pipeline leaves open; None if that is nothing

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

    The search ends before a run that is expected to exceed the ``hold_seconds`` of the options together with those
    before, or a share of the available memory.

    Raises
    ------
    RequestError
        The pipeline is invalid, or wants no variable that is to be held.
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
            raise RequestError(f"--hold {name}: the pipeline wants no such variable{nearest(name, names)}{wanted}")


def _choose(
    pipeline: PipelineFile, registry: Registry, asked: Asked, options: Options, progress: Any, archive: Path | None
) -> Chosen | None:
    """Return values for what a pipeline leaves open; None if that is nothing.

    What an earlier run into the archive has chosen is kept if it was asked for the same; otherwise it is where the
    search begins.
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
    """Store the result of a whole search in an archive, which exists by now; ``plan``: that of the run."""
    if not (held.remembered or held.needed):
        remember(archive, held.key, finite({**held.document(), "measured": held.measured.document()}))
    if held.chosen and plan is not None:
        # The cells of the request: the tolerance that was found is not part of it.
        told = {"kind": CHOICES, "asked": str(held.asked), "cells": answer_key(plan)}
        remember(archive, digest(CHOICES.encode()), finite({**held.chosen.document(), **told}))


def _search(measurement: Measurement, asked: Asked, norm: str) -> HeldTolerance:
    """Loosen the tolerance as long as the error is held, or tighten it until it is.

    How uncertain the reference is does not depend on the tolerance, so none is tried for what that alone forbids.
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
            found = measurement.unknown(plan, "measuring it would exceed what --hold may take")
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
        with suppress(OverBudget):  # of what was not measured nothing is to blame
            blame = (
                {}
                if search.lacking and best.measured.worst is None
                else blamed(measurement, best.plan, best.measured, best.missed, asked.limits(best.measured), norm)
            )
    seconds = measurement.seconds
    return HeldTolerance(asked, best.tolerance, norm, best.measured, best.missed, blame, seconds, search.lacking)


def _share(value: float | None, limit: float) -> float:
    """Return an error as a share of what is asked for."""
    return value / limit if value and limit else 0.0


def missed(found: MeasuredErrors, asked: Asked, norm: str) -> tuple[str, ...]:
    """Return the variables that are not known to be within what is asked for."""
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
