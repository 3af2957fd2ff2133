"""Run a pipeline at settings of its knobs, each combination once, and record errors and seconds.

In:  a pipeline, and the knobs to try.
Out: a ``Trial`` for a combination of settings, a ``Curve`` for a knob alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from etendue.accuracy.differences import difference
from etendue.accuracy.measuring import GlobalError, Measurement, shown_names
from etendue.accuracy.orders import Convergence, law_of, remaining
from etendue.accuracy.reference import PipelineKnob, reference_of, with_settings
from etendue.compute.tables import TABLES
from etendue.contract.arrays.dims import banded
from etendue.contract.arrays.variables import variable as known_variable
from etendue.contract.registry import Registry
from etendue.errors import RequestError
from etendue.pipeline.file import PipelineFile
from etendue.plan.ancestry import behind
from etendue.plan.expansion.search import Goal, Search, Setting, Settings, Trial, Value
from etendue.plan.model import Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.session import Options, collect

PRECISION = "precision"
COARSEST = Goal(0.5)  # settings cheaper than one that misses it are not tried
Told = Callable[[str], None]


@dataclass(frozen=True)
class SettingTrial(Trial):
    """A trial whose error is the rms of the worst wanted variable, relative to full scale; knobs that are not named are
    at their reference.
    """

    variable: str  # name of the worst variable
    stage_errors: Mapping[str, float | None]  # by knob: at the first picture or metrics after its stage
    seconds: Mapping[str, float]  # by stage
    why: str = ""  # set if it could not be run

    def setting(self, knob: PipelineKnob) -> Value:
        return self.settings.get(knob.key, knob.reference)

    @property
    def cost(self) -> float:
        return sum(self.seconds.values())


@dataclass(frozen=True)
class SettingCurve:
    """A knob alone, from its cheapest setting to its reference."""

    knob: PipelineKnob
    measured_at: str  # where the error of the stage is measured
    trials: tuple[SettingTrial, ...]
    affected: frozenset[str]  # stages whose computation it may change
    convergence: Convergence

    def seconds(self, trial: SettingTrial) -> float:
        return sum(s for name, s in trial.seconds.items() if name in self.affected)


@dataclass(frozen=True)
class Effort:
    """How much is run, and who is informed."""

    cells: int  # places of the sweep
    repeat: int  # runs of each trial
    told: Told


class Trials:
    """All trials of a pipeline, compared with its reference."""

    def __init__(
        self,
        pipeline: PipelineFile,
        registry: Registry,
        knobs: tuple[PipelineKnob, ...],
        given: frozenset[str],
        effort: Effort,
    ) -> None:
        self.registry, self.effort, self.options = registry, effort, Options("serial")
        base = Measurement(pipeline, registry, effort.cells, self.options)
        others = [k for k in base.reference.knobs if k.key not in {one.key for one in knobs}]
        try:
            base.plan(reference_of(pipeline, registry, [k for k in knobs if k.stage]).pipeline)
        except RequestError:
            knobs = tuple(k if k.key in given else base.within(k) for k in knobs)
        self.knobs = knobs
        reference = reference_of(pipeline, registry, [*(k for k in knobs if k.stage), *others])
        finite = {(k.stage, k.use, k.name): k.before_reference for k in others if k.before_reference != k.reference}
        reference = replace(reference, coarser=with_settings(reference.pipeline, finite) if finite else None)
        plan = base.plan(replace(reference.pipeline, sweep=base.pipeline.sweep))
        self.own = {k.key: own_variables(plan, k.stage) if k.stage else () for k in knobs}
        self.measurement = Measurement(pipeline, registry, effort.cells, self.options, reference=reference)
        self.measurement.also = tuple(dict.fromkeys(place for places in self.own.values() for place in places))
        self.exact = self.measurement.reference.pipeline
        self.affected = {k.key: affected(plan, k) for k in knobs}
        self.search = Search(self.evaluate, {k.key: k.reference for k in knobs})
        self.notes: list[str] = []
        self.floor = 0.0

    def evaluate(self, moved: Settings) -> SettingTrial:
        """Run a combination."""
        self.effort.told(", ".join(f"{key} = {value}" for key, value in moved.items()) or "the reference")
        written = {(k.stage, k.use, k.name): moved[k.key] for k in self.knobs if k.stage and k.key in moved}
        pipeline = replace(with_settings(self.exact, written), precision=str(moved.get(PRECISION, "float64")))
        return self.run(pipeline, moved)

    def planned(self, pipeline: PipelineFile) -> SettingTrial:
        """Return a trial of the pipeline as its file has it."""
        self.effort.told("as planned")
        own = replace(
            self.measurement.pipeline,
            tolerance=pipeline.tolerance,
            leave_out=pipeline.leave_out,
            precision=pipeline.precision,
        )
        return self.run(own, {k.key: k.value for k in self.knobs})

    def run(self, pipeline: PipelineFile, settings: Settings) -> SettingTrial:
        try:
            plan = self.measurement.plan(pipeline)
        except RequestError as error:
            text = "; ".join(fault.message for fault in error.faults)
            shown = ", ".join(f"{key} = {value}" for key, value in settings.items())
            self.notes.append(f"{shown} is refused: {text}")
            return SettingTrial(settings, None, "", {}, {}, text)
        seconds: dict[str, float] = {}
        for _ in range(self.effort.repeat):
            TABLES.clear()
            found = self.measurement.run(plan)
            own: dict[str, float] = {}
            for (stage, _), report in found.reports.items():
                own[stage] = own.get(stage, 0.0) + report.seconds
            seconds = {name: min(s, seconds.get(name, s)) for name, s in own.items()}
        errors = self.measurement.compared(plan, found).errors
        known = self.known(plan, errors)
        worst = max(known, key=lambda name: known[name], default="")
        stage_errors = {}
        for key, places in self.own.items():
            own_errors = [errors.get(f"{s}.{v}", errors.get(v)) for s, v in places]
            values = [e.rms for e in own_errors if e is not None and e.rms is not None]
            stage_errors[key] = max(values) if values else known.get(worst)
        return SettingTrial(dict(settings), known.get(worst), worst, stage_errors, seconds)

    def known(self, plan: Plan, errors: Mapping[str, GlobalError]) -> dict[str, float]:
        """Return the rms errors of the wanted variables that are known; add a note for each unknown one."""
        wanted = {name: errors[name] for name in shown_names(plan).values()}
        for name, e in wanted.items():
            if e.rms is None and (note := f"{name} is not counted: {e.why}") not in self.notes:
                self.notes.append(note)
        self.floor = max([self.floor, *(e.below for e in wanted.values() if e.below < float("inf"))])
        return {name: e.rms for name, e in wanted.items() if e.rms is not None}

    def curve(self, knob: PipelineKnob, reference: SettingTrial) -> SettingCurve:
        """Return the curve of a knob, from the reference towards cheaper settings while the picture is recognisable."""
        trials = [reference]
        for setting in knob.coarser(knob.reference):
            trials.insert(0, self.search.at({knob.key: setting}))
            if not COARSEST.met(trials[0].error or 0.0):
                self.notes.append(f"{knob.key}: settings cheaper than {setting} are not tried")
                break
        places = self.own[knob.key]
        where = f"{places[0][0]}.{places[0][1]}" if len(places) == 1 else places[0][0] if places else "what is wanted"
        used = [t for t in trials if not t.why]
        shown = [t.setting(knob) for t in used]
        finite = not knob.closed_form and len(used) > 1
        law = law_of(shown, [t.stage_errors.get(knob.key) for t in used], finite)
        if finite:
            self.floor = max(self.floor, remaining(shown, used[-2].error or 0.0, law))
        return SettingCurve(knob, where, tuple(used), self.affected[knob.key], law)

    def choices(self, curves: Sequence[SettingCurve]) -> dict[str, list[Setting]]:
        """Return, by knob, settings with their error and the seconds of the stages that the knob affects."""
        return {
            c.knob.key: [
                Setting(c.knob, t.setting(c.knob), t.error, c.seconds(t)) for t in c.trials if t.error is not None
            ]
            for c in curves
        }

    def settle(self) -> list[SettingTrial]:
        """Return all trials. The time of a stage depends on the knobs that affect it; among trials with the same
        settings of these, the minimum counts.
        """
        least: dict[tuple[Any, ...], float] = {}
        for trial in self.search.tried.values():
            for stage, seconds in trial.seconds.items():
                work = self.work(trial, stage)
                least[work] = min(seconds, least.get(work, seconds))
        for name, trial in self.search.tried.items():
            settled = {stage: least[self.work(trial, stage)] for stage in trial.seconds}
            self.search.tried[name] = replace(trial, seconds=settled)
        return list(self.search.tried.values())

    def work(self, trial: SettingTrial, stage: str) -> tuple[Any, ...]:
        return stage, *((k.key, trial.setting(k)) for k in self.knobs if stage in self.affected[k.key])

    def settled_curves(self, curves: Sequence[SettingCurve]) -> list[SettingCurve]:
        self.settle()
        return [replace(c, trials=tuple(self.search.at(t.settings) for t in c.trials)) for c in curves]

    def noise(self) -> tuple[float | None, str]:
        """Return the distance of one frame from its mean: rms of the last wanted picture after a draw, at the
        reference.
        """
        self.effort.told("the noise of a frame")
        exact = self.measurement.exact
        drawing = behind(exact, (node.name for node in exact.nodes if node.is_random))
        pictures = [(s, v) for s, v in exact.wanted if s in drawing and {"y", "x"} <= set(exact.node(s).writes[v].dims)]
        if not pictures:
            return None, ""
        order = [node.name for node in exact.nodes]
        stage, name = max(pictures, key=lambda at: (known_variable(at[1]).shown == "encoded", order.index(at[0])))
        plan = make_plan(self.exact, self.registry)
        ref = self.measurement.cells_of(plan, stage)[0][0]
        frame = collect(plan, {ref: [name]}, self.options)
        if ref not in frame.arrays or ref not in self.measurement.truth.arrays:
            return None, ""
        mean = self.measurement.truth.arrays[ref][name]
        declared = exact.node(stage).writes[name]
        return difference(frame.arrays[ref][name], mean, declared, exact.cells[ref].stage).relative, name


def affected(plan: Plan, knob: PipelineKnob) -> frozenset[str]:
    """Return the stages whose computation a knob may change: its own, those joined with it into one pass, and after a
    change of grid all later ones.
    """
    if not knob.stage:
        return frozenset(node.name for node in plan.nodes)
    found = behind(plan, [knob.stage]) if knob.studied else {knob.stage}
    if knob.studied:  # other bands or grids also change stages that look at transfer functions
        found |= {node.name for node in plan.nodes if any(set(names) & found for _, _, names in node.looks_at)}
    joined = [set(node.segment) for node in plan.nodes if knob.stage in node.segment]
    return frozenset(found.union(*joined))


def own_variables(plan: Plan, stage: str) -> tuple[StageVariable, ...]:
    """Return where the error of a stage is measured: at all metrics of a probe, else at the first variable without
    bands from that stage on.
    """
    reached = behind(plan, [stage])
    for node in plan.nodes:
        if node.name == stage and node.is_probe:
            return tuple((stage, name) for name in node.writes)
        for name, declaration in node.writes.items() if node.name in reached and not node.is_probe else ():
            if not banded(declaration.dims) and declaration.dims:
                return ((node.name, name),)
    return ()
