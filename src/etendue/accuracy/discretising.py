"""Refine the parameters that a pipeline leaves open (``spacing = "auto"``) until the error of discretisation is within
its limit.

In:  a pipeline, its open parameters, and the requested errors.
Out: one value for each open parameter, for the whole pipeline; the remaining error of discretisation and, if the limit
     is not reached, the cost of a further refinement.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.accuracy.answers.comparing import KnownParts, compare
from etendue.accuracy.answers.error import Part, is_number
from etendue.accuracy.answers.evaluations import Evaluations, Rates, Shown, TooDear, costs_of
from etendue.accuracy.answers.one_at_a_time import refined_pair
from etendue.accuracy.answers.pilots import ELSEWHERE, PLACES
from etendue.accuracy.answers.refinement import Point
from etendue.accuracy.differences import scale_of
from etendue.accuracy.measuring import shown_names
from etendue.accuracy.pilot import chosen_places
from etendue.contract.discretised import Discretised
from etendue.contract.registry import Registry
from etendue.errors import EtendueError, RequestError
from etendue.pipeline.file import PipelineFile
from etendue.pipeline.form import DIGITS
from etendue.plan.machine import available_memory
from etendue.plan.model import Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.plan.shown import shown_place
from etendue.plan.wiring.automatic import Open, with_chosen
from etendue.present.terminal.answer_texts import shortened
from etendue.run.peak_memory import peak_memory
from etendue.telling import human_bytes, human_seconds, plain
from etendue.types.documents import Document

if TYPE_CHECKING:
    from etendue.accuracy.holding import Asked

SHARE = 0.8  # fraction of the requested error for discretisation; the rest is for omissions and coarser settings
# Fraction of the requested error; if parameters given in the file leave less than this, nothing is refined.
NARROW = 0.05
MEMORY = 0.8  # share of the available memory that the run may take
MOST_STEPS, FURTHEST = 40, 2  # largest number of refinements, and of steps in one refinement
Values = dict[str, dict[str, float]]  # by stage and parameter


@dataclass
class VariableError:
    """The error of discretisation of one variable, relative to its full scale or value."""

    limit: float
    parts: dict[str, float] = field(default_factory=dict)
    unknown: dict[str, str] = field(default_factory=dict)  # parts that were not measured, and why

    @property
    def total(self) -> float:
        return math.fsum(self.parts.values())


@dataclass(frozen=True)
class Chosen:
    """The values chosen for open parameters, and the error of discretisation with these values.

    ``values``: by stage and parameter. ``refined``: parameters that are finer than at the start of the search.
    ``spent``: by variable, the error of all discretisations, relative to full scale, for all points of the sweep.
    ``factor``: ratio of this error to the error of the measured points. ``missed``: variables whose discretisation
    error exceeds the requested error, with the reason. ``needed``: the cost of the next refinement; '' if none is
    needed.
    """

    values: Values
    refined: tuple[str, ...] = ()
    spent: Mapping[str, float] = field(default_factory=dict)
    factor: float = 1.0
    missed: Mapping[str, str] = field(default_factory=dict)
    needed: str = ""
    seconds: float = 0.0
    kept: bool = False  # whether the values are those of an earlier run into the archive
    parts: KnownParts = field(default_factory=dict)

    def document(self) -> Document:
        """Return the document that is stored and printed by ``--json``."""
        return {
            "values": self.values,
            "refined": list(self.refined),
            "spent": dict(self.spent),
            "factor": self.factor,
            "missed": dict(self.missed),
            "needed": self.needed,
            "seconds": self.seconds,
            "kept": self.kept,
        }


class Refinement:
    """A search for the values of open parameters.

    Parameters
    ----------
    pipeline : pipeline with a number for every open parameter
    open_ : open parameters by stage, each with its discretisation
    asked : requested errors
    seconds : CPU time (s) that the search may take
    workers : number of workers of the run that follows
    shown : returns the progress to show of a plan
    """

    def __init__(
        self,
        pipeline: PipelineFile,
        registry: Registry,
        open_: Open,
        asked: Asked,
        seconds: float,
        workers: int = 1,
        shown: Shown = None,
    ) -> None:
        self.registry, self.open, self.asked, self.workers, self.shown = registry, open_, asked, workers, shown
        self.began = time.process_time()
        self.until = self.began + seconds
        # Nothing is left out: measuring needs no decisions, and those on a finer scene would cost more than measuring.
        self.plan = make_plan(replace(pipeline, leave_out=False, digits=DIGITS[0]), registry)
        self.pipeline = self.plan.pipeline
        self.names = shown_names(self.plan)
        self.start, self.first = self.plan, self.values()
        at = shown_place(self.plan)
        self.places = [at, *(place for place in chosen_places(self.plan.axes, PLACES) if place != at)]
        self.scales: dict[StageVariable, tuple[float, bool]] = {}
        self.rates = Rates(self.plan, None)
        whole = math.prod(len(axis.values) for axis in self.plan.axes)
        self.factor = ELSEWHERE if len(self.places) < whole else 1.0
        self.needed = ""

    def found(self, refine: bool = True) -> Chosen:
        """Refine until every variable is within its limit; ``refine=False``: only measure."""
        stuck, known = set[str](), dict[str, dict[str, Part | str]]()
        for _ in range(MOST_STEPS):
            for name in self._discretisations():
                if name not in known:
                    known[name] = self._measured(name)
            own = self._errors(known)
            name, steps = self._next(own, stuck) if refine else ("", 0)
            if not name:
                break
            if self._refine(name, steps):
                del known[name]
                self.needed = ""
            else:
                stuck.add(name)
        own = self._errors(known)
        values = self.values()
        finer = tuple(f"{s}.{n}" for s, some in values.items() for n, v in some.items() if v != self.first[s][n])
        missed = {n: self._why(one) for n, one in own.items() if one.unknown or one.total > one.limit}
        spent = {name: one.total for name, one in own.items()}
        seconds = time.process_time() - self.began
        return Chosen(values, finer, spent, self.factor, missed, self.needed if missed else "", seconds, parts=known)

    def values(self) -> Values:
        """Return the present values of the open parameters, in the units of the stages."""
        entries = {entry.name: entry.values for entry in self.pipeline.stages}
        first = {stage: self.plan.of(stage)[0].stage for stage in self.open if stage in entries and self._has(stage)}
        return {s: {n: float(getattr(one, n)) for n in self.open[s]} for s, one in first.items()}

    def _has(self, stage: str) -> bool:
        return any(node.name == stage for node in self.plan.nodes)

    def _discretisations(self) -> list[str]:
        return Point(self.start, self.registry, self.places[0], tuple(self.names)).names()

    def _measured(self, name: str) -> dict[str, Part | str]:
        """Return the change by one refinement, by variable: the largest over some points, or a text if it is unknown.

        All other discretisations stay as coarse as at the start of the search: the change hardly depends on them, but
        the cost does.
        """
        found: dict[str, Part | str] = {}
        own = {s: {n: v for n, v in some.items() if self.open[s][n] == name} for s, some in self.values().items()}
        moved = {s: some for s, some in own.items() if any(v != self.first[s][n] for n, v in some.items())}
        plan = make_plan(with_chosen(self.start.pipeline, moved), self.registry) if moved else self.start
        for place in self.places:
            point = Point(plan, self.registry, place, tuple(self.names))
            affected = point.affected(plan, name)
            evaluations = Evaluations(point, self.rates, self.until, self.shown)
            parts: dict[StageVariable, dict[str, Part]] = {one: {} for one in self.names}
            missing: dict[StageVariable, dict[str, str]] = {one: {} for one in self.names}
            try:
                pair = refined_pair(evaluations, name) if affected else None
                why = f"half of this value is refused{f' ({point.refusal})' if point.refusal else ''}"
            except TooDear as error:
                pair, why = None, str(error)
                self.needed = self.needed or f"measuring {name} {why}"
            if pair:
                compare(parts, missing, pair, name, affected)
                self._scale(pair[0])
            for one in affected:
                new: Part | str = parts[one].get(name) or missing[one].get(name) or why
                old = found.get(self.names[one], Part(0.0, 0.0))
                found[self.names[one]] = _larger(old, new)
        return found

    def _scale(self, evaluated: tuple[Plan, Mapping[StageVariable, Any]]) -> None:
        """Store the full scale of every variable, and whether the variable is a number."""
        plan, values = evaluated
        for stage, name in self.names:
            if (stage, name) not in values:
                continue
            declared = plan.node(stage).writes[name]
            scale = scale_of(np.asarray(values[stage, name], np.float64), declared, plan.of(stage)[0].stage)
            largest = float(np.nanmax(scale, initial=0.0))
            number = is_number(declared)
            known = self.scales.get((stage, name), (largest or 1.0, number))[0]
            # Keep the scale for which the requested error is strictest: for pictures, whose request may be in a unit,
            # the largest; for numbers, whose request may be relative, the smallest.
            self.scales[stage, name] = (min if number else max)(known, largest or 1.0), number

    def _errors(self, known: Mapping[str, Mapping[str, Part | str]]) -> dict[str, VariableError]:
        found = {}
        for one, name in self.names.items():
            if not self.asked.asks(name):
                continue
            scale, number = self.scales.get(one, (1.0, False))
            own = found[name] = VariableError(self.asked.of_scale(name, scale))
            for part, measured in known.items():
                value = measured.get(name, Part(0.0, 0.0))
                if isinstance(value, str):
                    own.unknown[part] = value
                else:
                    size = value.rms if self.pipeline.norm == "rms" else value.max
                    own.parts[part] = self.factor * size / (scale if number else 1.0)
        return found

    def _next(self, errors: Mapping[str, VariableError], stuck: set[str]) -> tuple[str, int]:
        """Return the discretisation to refine, and the number of steps; '' if no refinement is needed or would help."""
        may = {of for some in self.open.values() for of in some.values()} - stuck
        best, most, steps = "", 0.0, 0
        for own in errors.values():
            fixed = math.fsum(value for part, value in own.parts.items() if part not in may)
            room = max(SHARE * own.limit - fixed, 0.5 * (own.limit - fixed))
            open_ = {part: value for part, value in own.parts.items() if part in may}
            if math.fsum(open_.values()) <= room or not open_ or room < NARROW * own.limit:
                continue
            name = max(open_, key=lambda part: open_[part])
            ratio = math.fsum(open_.values()) / room
            if ratio > most and open_[name] > 0:
                # Take only as many steps as a second-order method needs, because unnecessary refinement makes the whole
                # run slower.
                best, most, steps = name, ratio, min(max(1, int(math.log(ratio, 4))), FURTHEST)
        return best, steps

    def _refine(self, name: str, steps: int) -> bool:
        """Make a discretisation finer. Return False and store the reason if a stage refuses it, or memory or time is
        too short.
        """
        try:
            values = self._finer(name, steps)
        except (ValueError, TypeError) as error:
            return self._not(name, plain(str(error)))
        if not values:
            return False
        pipeline = with_chosen(self.pipeline, values)
        words = ", ".join(f"{s}.{n} = {v:.4g}" for s, some in values.items() for n, v in some.items())
        try:
            plan = make_plan(pipeline, self.registry)
            need = peak_memory(plan, self.workers, pictures=False).bytes
        except EtendueError as error:
            faults = error.faults if isinstance(error, RequestError) else ()
            return self._not(words, shortened(faults[0].message if faults else plain(str(error))))
        seconds = self.rates.seconds(costs_of(plan, plan.cells))
        if need > MEMORY * (available_memory() or math.inf):
            return self._not(words, f"the run would take about {human_bytes(need)} of memory and {_time(seconds)}")
        if seconds > self.until - self.began and steps == 1:
            return self._not(words, f"the run would take about {_time(seconds)}: more than --hold-seconds allows")
        if seconds > self.until - self.began:
            return self._refine(name, 1)
        if time.process_time() > self.until:
            return self._not(words, f"the run would take about {_time(seconds)}; the time of --hold-seconds is used up")
        self.plan, self.pipeline = plan, plan.pipeline
        return True

    def _finer(self, name: str, steps: int) -> Values:
        """Return the parameters of stages that make a discretisation finer; exceptions of the stages are passed on."""
        values: Values = {}
        for stage, some in self.open.items():
            one = self.plan.of(stage)[0].stage if self._has(stage) else None
            if not isinstance(one, Discretised) or name not in some.values() or one.discretisations().get(name, "no"):
                continue
            for _ in range(steps):
                one = replace(one, **{n: v for n, v in one.finer(name).items() if n in some})
            own = {n: float(getattr(one, n)) for n, of in some.items() if of == name}
            if own != {n: getattr(self.plan.of(stage)[0].stage, n) for n in own}:
                values[stage] = own
        return values

    def _not(self, what: str, why: str) -> bool:
        self.needed = f"{what}: {why}"
        return False

    def _why(self, own: VariableError) -> str:
        if own.unknown:
            part, why = next(iter(own.unknown.items()))
            return f"{part} unknown: {why}"
        may = {of for some in self.open.values() for of in some.values()}
        fixed = {part: value for part, value in own.parts.items() if part not in may and value > own.limit}
        if fixed:  # no refinement of an open parameter helps
            part = max(fixed, key=lambda one: fixed[one])
            return f"{_alone(part, own)}; the file does not leave it open"
        return _alone(max(own.parts, key=lambda one: own.parts[one]), own)


def _alone(part: str, own: VariableError) -> str:
    times = own.parts[part] / own.limit if own.limit else math.inf
    return f"{part} alone {own.parts[part]:.2g} of full scale, {times:.2g} times the requested limit"


def _larger(old: Part | str, new: Part | str) -> Part | str:
    if isinstance(old, str) or isinstance(new, str):
        return old if isinstance(old, str) else new
    return replace(new, rms=max(old.rms, new.rms), max=max(old.max, new.max))


def _time(seconds: float) -> str:
    return f"{human_seconds(seconds)} of CPU time"
