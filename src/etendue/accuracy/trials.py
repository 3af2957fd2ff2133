"""Run a pipeline at settings of its knobs, each combination once, and record errors and seconds.

In:  a pipeline, and the knobs to try.
Out: a ``Trial`` for a combination of settings, a ``Curve`` for a knob alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from etendue.accuracy.differences import difference
from etendue.accuracy.measuring import GlobalError, Measurement, shown_names
from etendue.accuracy.orders import ROUNDING, Convergence, law_of, remaining
from etendue.accuracy.reference import PipelineKnob, ReferencePipeline, reference_of, with_settings
from etendue.accuracy.sampling import limits, moved
from etendue.accuracy.timing import COLD, WARM, Timing, samples_of
from etendue.compute.tables import TABLES
from etendue.contract.arrays.dims import banded
from etendue.contract.arrays.variables import variable as known_variable
from etendue.contract.registry import Registry
from etendue.errors import RequestError
from etendue.pipeline.file import PipelineFile
from etendue.plan.ancestry import behind
from etendue.plan.expansion.search import Goal, Search, Settings, Trial, Value
from etendue.plan.model import Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.session import Collected, Options, collect

PRECISION = "precision"
STAGE = ""  # key of the stage's own error among the errors by variable
COARSEST = Goal(0.5)  # once a setting exceeds this error, cheaper ones are not tried
Told = Callable[[str], None]
Grids = tuple[tuple[str, Value], ...]  # settings of discretisations that differ from the file
Work = tuple[object, ...]  # a stage, and the settings of the knobs that affect it


@dataclass(frozen=True)
class SettingTrial(Trial):
    """A trial with the error of the worst wanted variable: rms relative to full scale, including the error of the grid.

    Knobs that are not named are at their reference; discretisations that are not named are as in the file.
    """

    variable: str  # name of the worst variable
    # By knob: error at the first picture or metrics after its stage, on this grid.
    stage_errors: Mapping[str, float | None]
    computed: Mapping[str, float]  # by variable: difference from the reference on this grid
    timing: Timing
    why: str = ""  # set if it could not be run
    parts: Mapping[str, float] = field(default_factory=dict)  # parts of the error by knob (`splitting`)

    def setting(self, knob: PipelineKnob) -> Value:
        return self.settings.get(knob.key, knob.reference)

    @property
    def cost(self) -> float:
        return self.timing.least()


@dataclass(frozen=True)
class SettingCurve:
    """One knob, varied alone from its cheapest to its finest setting; errors are relative to the finest setting."""

    knob: PipelineKnob
    measured_at: str  # variable at which the error of the stage is measured
    trials: tuple[SettingTrial, ...]
    affected: frozenset[str]  # stages whose computation it may change
    convergence: Convergence
    # By setting and variable, including the one at which the stage is measured.
    changes: Mapping[Value, Mapping[str, float]]

    def error(self, trial: SettingTrial) -> tuple[float | None, str]:
        """Return the largest error of the wanted variables at this trial's setting, and the name of the variable."""
        own = self.changes.get(trial.setting(self.knob), {})
        name = max((n for n in own if n in trial.computed), key=lambda n: own[n], default="")
        return own.get(name), name

    def stage_error(self, trial: SettingTrial) -> float | None:
        return self.changes.get(trial.setting(self.knob), {}).get(STAGE)


@dataclass(frozen=True)
class Effort:
    """The budget of a search, and the function that is informed of its progress."""

    cells: int  # places of the sweep
    repeat: int  # cold and warm runs of each trial
    told: Told
    by: str = WARM  # the time that is compared


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
        try:
            base.plan(reference_of(pipeline, registry, [k for k in knobs if k.stage]).pipeline)
        except RequestError:
            knobs = tuple(k if k.key in given or k.discretisation else base.within(k) for k in knobs)
        self.pipeline, self.knobs, self.given = pipeline, knobs, given
        reference = self._reference_beside(base)
        axes = base.pipeline
        plan = base.plan(
            replace(reference.pipeline, sweep=axes.sweep, zipped=axes.zipped, rows=axes.rows, design=axes.design)
        )
        self.own = {k.key: own_variables(plan, k.stage) if k.stage else () for k in knobs}
        self.also = tuple(dict.fromkeys(place for places in self.own.values() for place in places))
        self.reference = reference
        self.grids: dict[Grids, Measurement] = {}
        self.measurement = self.on({})
        self.exact = self.measurement.reference.pipeline
        self.affected = {k.key: affected(plan, k) for k in knobs}
        self.search = Search(self.evaluate, {k.key: k.reference for k in knobs})
        self.samples: dict[Work, dict[str, list[float]]] = {}
        self.sampled: dict[str, dict[Value, dict[str, float]]] = {}  # errors of discretisations, by knob and setting
        self.notes: list[str] = []
        self.floor = 0.0

    def _reference_beside(self, base: Measurement) -> ReferencePipeline:
        """Return the reference, including the knobs that are tried. Its uncertainty comes only from other knobs whose
        reference setting is finite.
        """
        tried = {one.key for one in self.knobs}
        others = [k for k in base.reference.knobs if k.key not in tried]
        found = reference_of(self.pipeline, self.registry, [*(k for k in self.knobs if k.stage), *others])
        finite = {(k.stage, k.use, k.name): k.before_reference for k in others if k.before_reference != k.reference}
        return replace(found, coarser=with_settings(found.pipeline, finite) if finite else None)

    def on(self, moved: Settings) -> Measurement:
        """Return the measurement on the grid of a combination of settings."""
        own = {k.key: moved[k.key] for k in self.knobs if k.discretisation and k.key in moved}
        name = tuple(sorted(own.items()))
        if name not in self.grids:
            written = {(k.stage, k.use, k.name): own[k.key] for k in self.knobs if k.key in own}
            coarser = self.reference.coarser and with_settings(self.reference.coarser, written)
            reference = replace(
                self.reference, pipeline=with_settings(self.reference.pipeline, written), coarser=coarser
            )
            pipeline = with_settings(self.pipeline, written)
            made = Measurement(pipeline, self.registry, self.effort.cells, self.options, reference=reference)
            made.also = self.also
            self.grids[name] = made
        return self.grids[name]

    def evaluate(self, moved: Settings) -> SettingTrial:
        """Run a combination."""
        self.effort.told(", ".join(f"{key} = {value}" for key, value in moved.items()) or "the reference")
        finer = any(k.settings.index(moved[k.key]) > k.settings.index(k.value) for k in self.sampling if k.key in moved)
        return self.run(self.combined(moved), moved, 1 if finer else self.effort.repeat)

    @property
    def sampling(self) -> list[PipelineKnob]:
        return [k for k in self.knobs if k.discretisation]

    def combined(self, moved: Settings) -> PipelineFile:
        """Return the pipeline of a combination."""
        written = {(k.stage, k.use, k.name): moved[k.key] for k in self.knobs if k.stage and k.key in moved}
        return replace(with_settings(self.exact, written), precision=str(moved.get(PRECISION, "float64")))

    def planned(self, pipeline: PipelineFile) -> SettingTrial:
        """Return a trial of the pipeline as its file has it."""
        self.effort.told("as planned")
        own = replace(
            self.measurement.pipeline,
            tolerance=pipeline.tolerance,
            leave_out=pipeline.leave_out,
            precision=pipeline.precision,
            digits=pipeline.digits,
        )
        settings = {k.key: k.value for k in self.knobs}
        return self.run(own, settings, self.effort.repeat, pooled=False)

    def run(self, pipeline: PipelineFile, settings: Settings, repeat: int, pooled: bool = True) -> SettingTrial:
        measurement = self.on(
            {k.key: settings[k.key] for k in self.sampling if settings.get(k.key, k.value) != k.value}
        )
        try:
            plan = measurement.plan(pipeline)
        except RequestError as error:
            text = "; ".join(fault.message for fault in error.faults)
            shown = ", ".join(f"{key} = {value}" for key, value in settings.items())
            self.notes.append(f"{shown} is refused: {text}")
            return SettingTrial(settings, None, "", {}, {}, Timing(), text)
        found, timing = self.timed(measurement, plan, 1)
        errors = measurement.compared(plan, found).errors
        known = self.known(plan, errors)
        # A setting that is exact but not the reference only costs time.
        exact = settings.keys() - {k.key for k in self.sampling} and max(known.values(), default=1.0) < ROUNDING
        if repeat > 1 and not exact:
            timing = timing.and_(self.timed(measurement, plan, repeat - 1)[1])
        if pooled:
            self.keep(settings, timing)
        worst = max(known, key=lambda name: known[name], default="")
        stage_errors = {}
        for key, places in self.own.items():
            own_errors = [errors.get(f"{s}.{v}", errors.get(v)) for s, v in places]
            values = [e.rms for e in own_errors if e is not None and e.rms is not None]
            stage_errors[key] = max(values) if values else known.get(worst)
        made = SettingTrial(dict(settings), known.get(worst), worst, stage_errors, known, timing)
        return self.whole(made)

    def timed(self, measurement: Measurement, plan: Plan, repeat: int) -> tuple[Collected, Timing]:
        """Run a plan cold and warm in turns, as often as requested."""
        runs: dict[str, list[dict[str, float]]] = {COLD: [], WARM: []}
        for _ in range(repeat):
            TABLES.clear()
            for own in runs.values():
                found, one = measurement.run(plan), dict[str, float]()
                for (stage, _), report in found.reports.items():
                    one[stage] = one.get(stage, 0.0) + report.seconds
                own.append(one)
        return found, Timing(samples_of(runs[COLD]), samples_of(runs[WARM]), repeat, self.effort.by)

    def keep(self, settings: Settings, timing: Timing) -> None:
        """Add the measured seconds of each stage to the samples of the same work."""
        for how, samples in ((COLD, timing.cold), (WARM, timing.warm)):
            for stage, own in samples.items():
                pool = self.samples.setdefault(self.work(settings, stage), {COLD: [], WARM: []})
                pool[how].extend(own)

    def least(self, settings: Settings, stage: str) -> float | None:
        """Return the minimum seconds of a stage at these settings; None if no trial has done this work."""
        own = self.samples.get(self.work(settings, stage))
        return min(own[self.effort.by]) if own else None

    def again(self, trials: Iterable[SettingTrial]) -> None:
        """Time some trials again, in turns, so that a temporary load of the machine affects all of them."""
        every = dict.fromkeys(self.search.name(t.settings) for t in trials)
        for _ in range(self.effort.repeat):
            for key in every:
                settings = dict(key)
                measurement = self.on(settings)
                self.effort.told("timing again")
                plan = measurement.plan(self.combined(settings))
                self.keep(settings, self.timed(measurement, plan, 1)[1])
                own = self.search.tried[key]
                self.search.tried[key] = replace(own, timing=replace(own.timing, runs=own.timing.runs + 1))

    def known(self, plan: Plan, errors: Mapping[str, GlobalError]) -> dict[str, float]:
        """Return the rms errors of the wanted variables that are known; add a note for each unknown error."""
        wanted = {name: errors[name] for name in shown_names(plan).values()}
        for name, e in wanted.items():
            if e.rms is None and (note := f"{name} is not counted: {e.why}") not in self.notes:
                self.notes.append(note)
        self.floor = max([self.floor, *(e.below for e in wanted.values() if e.below < float("inf"))])
        return {name: e.rms for name, e in wanted.items() if e.rms is not None}

    def whole(self, trial: SettingTrial) -> SettingTrial:
        """Return a trial with its error, including the error of the grid as far as it is known."""
        of_grid = [self.sampled[k.key].get(trial.setting(k), {}) for k in self.sampling if k.key in self.sampled]
        errors = {name: e + sum(own.get(name, 0.0) for own in of_grid) for name, e in trial.computed.items()}
        worst = max(errors, key=lambda name: errors[name], default="")
        return replace(trial, error=errors.get(worst), variable=worst)

    def curve(self, knob: PipelineKnob, reference: SettingTrial) -> SettingCurve:
        """Return the curve of a knob. Settings are tried from the reference towards cheaper settings, until the error
        exceeds ``COARSEST``.
        """
        if knob.discretisation:
            return self.sampling_curve(knob)
        trials = [reference]
        for setting in knob.coarser(knob.reference):
            trials.insert(0, self.search.at({knob.key: setting}))
            if not COARSEST.met(max(trials[0].computed.values(), default=0.0)):
                self.notes.append(f"{knob.key}: settings cheaper than {setting} are not tried")
                break
        used = [t for t in trials if not t.why]
        shown = [t.setting(knob) for t in used]
        finite = not knob.closed_form and len(used) > 1
        law = law_of(shown, [t.stage_errors.get(knob.key) for t in used], finite)
        if finite:
            self.floor = max(self.floor, remaining(shown, max(used[-2].computed.values(), default=0.0), law))
        changes = {t.setting(knob): {**t.computed, STAGE: t.stage_errors.get(knob.key) or 0.0} for t in used}
        return SettingCurve(knob, self.place(knob), tuple(used), self.affected[knob.key], law, changes)

    def sampling_curve(self, knob: PipelineKnob) -> SettingCurve:
        """Return the curve of a discretisation: differences from its finest setting, plus the remaining error of that
        setting.
        """
        trials = [self.search.at({knob.key: setting}) for setting in knob.settings]
        used = [t for t in trials if not t.why]
        shown = [t.setting(knob) for t in used]
        finest = self.on(used[-1].settings)
        names = [f"{s}.{v}" for s, v in self.own[knob.key]]
        changes: dict[Value, dict[str, float]] = {}
        for trial in used:
            own = moved(self.on(trial.settings), finest)
            at_stage = [own[n] for name in names for n in (name, name.partition(".")[2]) if n in own]
            changes[trial.setting(knob)] = {**own, STAGE: max(at_stage or own.values(), default=0.0)}
        law = law_of(shown, [changes[one][STAGE] for one in shown], finite=True)
        if len(used) > 1:
            self.sampled[knob.key] = limits(changes, law)
        for name in sorted(set(used[0].computed) - set(changes[shown[0]])):
            self.notes.append(f"{knob.key}: its error in {name} is not known: the variable is on the grid that it sets")
        return SettingCurve(knob, self.place(knob), tuple(used), self.affected[knob.key], law, changes)

    def place(self, knob: PipelineKnob) -> str:
        """Return the variable at which the error of a stage is measured."""
        places = self.own[knob.key]
        return f"{places[0][0]}.{places[0][1]}" if len(places) == 1 else places[0][0] if places else "what is wanted"

    def settle(self) -> list[SettingTrial]:
        """Return all trials with final times and errors. The time of a stage uses the samples of all trials with the
        same settings of the knobs that affect it. Errors include the error of the grid.
        """
        for name, trial in self.search.tried.items():
            pools = {stage: self.samples[self.work(trial.settings, stage)] for stage in trial.timing.warm}
            cold, warm = ({stage: tuple(own[how]) for stage, own in pools.items()} for how in (COLD, WARM))
            self.search.tried[name] = self.whole(replace(trial, timing=replace(trial.timing, cold=cold, warm=warm)))
        return list(self.search.tried.values())

    def work(self, settings: Settings, stage: str) -> Work:
        return stage, *((k.key, settings.get(k.key, k.reference)) for k in self.knobs if stage in self.affected[k.key])

    def settled_curves(self, curves: Sequence[SettingCurve]) -> list[SettingCurve]:
        self.settle()
        return [replace(c, trials=tuple(self.search.at(t.settings) for t in c.trials)) for c in curves]

    def noise(self) -> tuple[float | None, str]:
        """Return the rms difference between one noisy frame of the last wanted picture and the expected value of this
        picture, at the reference settings.
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
    """Return the stages whose computation a knob may change: its own stage, the stages joined with it into one pass
    and, after a change of grid, all later stages.
    """
    if not knob.stage:
        return frozenset(node.name for node in plan.nodes)
    found = behind(plan, [knob.stage]) if knob.studied else {knob.stage}
    if knob.studied:  # other bands or grids also change stages that look at transfer functions
        found |= {node.name for node in plan.nodes if any(set(names) & found for _, _, names in node.looks_at)}
    joined = [set(node.segment) for node in plan.nodes if knob.stage in node.segment]
    return frozenset(found.union(*joined))


def own_variables(plan: Plan, stage: str) -> tuple[StageVariable, ...]:
    """Return the variables at which the error of a stage is measured: all metrics of a probe, otherwise the first
    variable without bands from that stage on.
    """
    reached = behind(plan, [stage])
    for node in plan.nodes:
        if node.name == stage and node.is_probe:
            return tuple((stage, name) for name in node.writes)
        for name, declaration in node.writes.items() if node.name in reached and not node.is_probe else ():
            if not banded(declaration.dims) and declaration.dims:
                return ((node.name, name),)
    return ()
