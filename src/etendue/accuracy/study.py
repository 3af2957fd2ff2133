"""Error against run time: each knob of a pipeline alone, and the front over their combinations.

In:  a pipeline, which knobs.
Out: an ``Accuracy``: curves, trials, the front, the cheapest setting for a list of tolerances, the noise floor.

Every trial is a run of expected values beside the reference (`measuring`); all knobs but those that are tried stand at
their reference. Seconds are thread time in one thread with no table made before, of each stage the least of all runs in
which the knobs that affect its work stand alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from etendue.accuracy.differences import difference
from etendue.accuracy.frontier import ROUNDING, Convergence, cheapest, combinations, convergence, front, remaining
from etendue.accuracy.measuring import Measurement, Wanted
from etendue.accuracy.reference import Knob, knobs_of, reference_of, with_settings
from etendue.compute.tables import TABLES
from etendue.contract.dims import banded
from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of
from etendue.contract.variables import variable as known_variable
from etendue.errors import Fault, RequestError, nearest
from etendue.pipeline.file import Pipeline
from etendue.plan.ancestry import behind
from etendue.plan.model import Plan
from etendue.plan.parameters import Unfit, resolve
from etendue.plan.planner import make_plan
from etendue.session import Collected, Options, collect

PRECISION = "precision"
TOLERANCES = tuple(10.0**-n for n in range(1, 9))
WORTH = 0.9  # by so much a slower setting betters the error, or it is not on the front
COARSEST = 0.5  # settings cheaper than one with such an error are not tried
Told = Callable[[str], None]


@dataclass(frozen=True)
class Trial:
    """One combination of settings, by knob; those that are not named stand at their reference."""

    settings: Mapping[str, Any]
    error: float | None  # rms of the wanted variable that is furthest from the reference, relative to full scale
    variable: str  # which that is
    stage_errors: Mapping[str, float | None]  # by knob: at the first picture or figures behind its stage
    seconds: Mapping[str, float]  # by stage
    why: str = ""  # where it could not be run

    def setting(self, knob: Knob) -> Any:
        return self.settings.get(knob.key, knob.reference)

    @property
    def whole(self) -> float:
        return sum(self.seconds.values())


@dataclass(frozen=True)
class Curve:
    """A knob alone, from its cheapest setting to its reference."""

    knob: Knob
    measured_at: str  # where the error of the stage is found
    trials: tuple[Trial, ...]
    affected: frozenset[str]  # stages whose work it may change
    convergence: Convergence

    def seconds(self, trial: Trial, stages: Iterable[str] | None = None) -> float:
        chosen = self.affected if stages is None else frozenset(stages)
        return sum(s for name, s in trial.seconds.items() if name in chosen)


@dataclass
class Accuracy:
    """What came of it."""

    pipeline: str
    at: Mapping[str, Any]  # axis values of the cells
    curves: list[Curve]
    trials: list[Trial]  # all, the reference first
    frontier: list[Trial]
    planned: Trial  # as the file has it
    cheapest: list[tuple[float, Trial | None]]
    floor: float  # how far the reference itself may be wrong
    noise_floor: float | None
    noise_of: str
    verified: list[tuple[float, float | None, str]] = field(
        default_factory=list
    )  # error of the cheapest settings elsewhere
    verified_at: Mapping[str, Any] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def accuracy(
    pipeline: Pipeline,
    registry: Registry,
    asked: Mapping[str, tuple[Any, ...]] = {},
    cells: int = 1,
    repeat: int = 3,
    most: int = 24,
    told: Told = lambda text: None,
    elsewhere: Pipeline | None = None,
    verify: Mapping[str, Any] = {},
) -> Accuracy:
    """Try every knob alone, then combinations.

    Parameters
    ----------
    pipeline : as read
    registry : of installed stages
    asked : by knob (``stage.knob``, also such as the file writes, and ``precision``) settings from the cheapest to the
    reference, ()
        for those that it declares; nothing: all knobs that the file does not write
    cells : places of the sweep
    repeat : runs of each trial, whose least seconds count
    most : combinations at most
    told : hears what is being tried
    elsewhere : the same stages behind another source, on which the cheapest settings are tried too; ``verify`` says
    which

    Raises
    ------
    RequestError
        The pipeline is wrong, or has no such knob.
    """
    given = frozenset(key for key, values in asked.items() if values)
    study = _Study(pipeline, registry, chosen_knobs(pipeline, registry, asked), given, cells, repeat, told)
    other = None if elsewhere is None else _Study(elsewhere, registry, study.knobs, given, cells, 1, told)
    reference = study.trial({})
    curves = [study.curve(knob, reference) for knob in study.knobs]
    for settings in combinations(study.choices(study.settled_curves(curves)), most):
        study.trial(settings)
    planned = study.planned(pipeline)
    trials = study.settled()
    done = [t for t in trials if t.error is not None]
    floor = max(study.floor, ROUNDING)

    def of(trial: Trial) -> tuple[float, float]:
        return figures(trial, floor)

    found = Accuracy(
        pipeline.name,
        dict(study.measurement.places[0]) if len(study.measurement.places) == 1 else {},
        study.settled_curves(curves),
        trials,
        front(done, of, WORTH),
        planned,
        [(t, cheapest(done, of, t)) for t in TOLERANCES],
        floor,
        *study.noise(),
        notes=study.notes,
    )
    if other is not None:
        found.verified_at = dict(verify)
        tried = {id(one): other.trial(one.settings) for _, one in found.cheapest if one}
        found.verified = [(t, tried[id(one)].error, tried[id(one)].variable) for t, one in found.cheapest if one]
    return found


def chosen_knobs(pipeline: Pipeline, registry: Registry, asked: Mapping[str, tuple[Any, ...]]) -> tuple[Knob, ...]:
    """The knobs that are tried: those that are asked for, else all that the file does not write and that change no
    grid.

    Raises
    ------
    RequestError
        There is no such knob, or its settings have no order.
    """
    known = {knob.key: knob for knob in knobs_of(pipeline, registry)}
    known[PRECISION] = Knob(
        "", "", PRECISION, ("float32", "float64"), True, pipeline.precision, pipeline.precision != "auto", False, "1"
    )
    if not asked:
        return tuple(k for k in known.values() if k.settings and not (k.written or k.studied))
    faults, chosen = [], []
    for key, values in asked.items():
        if key not in known:
            hint = nearest(key, known) or f"; it has {', '.join(known)}"
            faults.append(Fault(f"--knob {key}", f"no stage of this pipeline has such a fidelity parameter{hint}"))
            continue
        knob = known[key]
        if len(values) == 1:
            faults.append(Fault(f"--knob {key}", "expected settings from the cheapest to the reference, two or more"))
        elif not (values or knob.settings):
            faults.append(
                Fault(
                    f"--knob {key}",
                    "its settings have no order from cheap to exact; compare them: etendue compare --axis",
                )
            )
        try:
            own = _resolved(knob, values, pipeline, registry)
            chosen.append(
                replace(knob, settings=own, closed_form=own[-1] == knob.reference and knob.closed_form) if own else knob
            )
        except Unfit as error:
            faults.append(Fault(f"--knob {key}", str(error)))
    if faults:
        raise RequestError(faults, pipeline.file)
    return tuple(chosen)


def _resolved(knob: Knob, values: tuple[Any, ...], pipeline: Pipeline, registry: Registry) -> tuple[Any, ...]:
    """Settings in the unit of the knob; ``Unfit`` where it does not take one."""
    if not knob.stage:
        if not set(values) <= set(knob.settings):
            raise Unfit(f"expected {' and '.join(knob.settings)}")
        return values
    parameter, kind, _ = parameters_of(registry.load(knob.use))[knob.name]
    return tuple(resolve(value, parameter, kind, pipeline.folder) for value in values)


def figures(trial: Trial, floor: float) -> tuple[float, float]:
    """Error and seconds; errors below what the reference may be wrong by are all the same."""
    return (float("inf") if trial.error is None else max(trial.error, floor)), trial.whole


class _Study:
    def __init__(
        self,
        pipeline: Pipeline,
        registry: Registry,
        knobs: tuple[Knob, ...],
        given: frozenset[str],
        cells: int,
        repeat: int,
        told: Told,
    ) -> None:
        self.registry, self.repeat, self.told, self.options = registry, repeat, told, Options("serial")
        base = Measurement(pipeline, registry, cells, self.options)
        others = [k for k in base.reference.knobs if k.key not in {one.key for one in knobs}]
        try:
            base.plan(reference_of(pipeline, registry, [k for k in knobs if k.stage]).pipeline)
        except RequestError:
            knobs = tuple(base.within(k) if k.stage and k.key not in given else k for k in knobs)
        self.knobs = knobs
        reference = reference_of(pipeline, registry, [*(k for k in knobs if k.stage), *others])
        unstudied = {(k.stage, k.use, k.name): k.before_reference for k in others if k.before_reference != k.reference}
        coarser = with_settings(reference.pipeline, unstudied) if unstudied else None
        reference = replace(reference, coarser=coarser)
        plan = base.plan(replace(reference.pipeline, sweep=base.pipeline.sweep))
        self.own = {k.key: own_variables(plan, k.stage) if k.stage else () for k in knobs}
        also = tuple(dict.fromkeys(place for places in self.own.values() for place in places))
        self.measurement = Measurement(pipeline, registry, cells, self.options, reference=reference, also=also)
        self.exact = self.measurement.reference.pipeline
        self.affected = {k.key: affected(plan, k) for k in knobs}
        self.trials: dict[tuple[tuple[str, Any], ...], Trial] = {}
        self.notes: list[str] = []
        self.floor = 0.0

    def trial(self, settings: Mapping[str, Any]) -> Trial:
        """A combination, run once or remembered."""
        moved = {k.key: settings[k.key] for k in self.knobs if k.key in settings and settings[k.key] != k.reference}
        name = tuple(sorted(moved.items()))
        if name not in self.trials:
            self.told(", ".join(f"{key} = {value}" for key, value in moved.items()) or "the reference")
            knobs = {k.key: k for k in self.knobs}
            written = {
                (knobs[key].stage, knobs[key].use, knobs[key].name): v for key, v in moved.items() if key != PRECISION
            }
            pipeline = replace(with_settings(self.exact, written), precision=moved.get(PRECISION, "float64"))
            self.trials[name] = self.run(pipeline, moved)
        return self.trials[name]

    def planned(self, pipeline: Pipeline) -> Trial:
        """The pipeline as its file has it."""
        self.told("as planned")
        own = replace(
            self.measurement.pipeline,
            tolerance=pipeline.tolerance,
            leave_out=pipeline.leave_out,
            precision=pipeline.precision,
        )
        values = {k.key: k.value for k in self.knobs}
        return self.run(own, values)

    def run(self, pipeline: Pipeline, settings: Mapping[str, Any]) -> Trial:
        try:
            plan = self.measurement.plan(pipeline)
        except RequestError as error:
            text = "; ".join(fault.message for fault in error.faults)
            shown = ", ".join(f"{key} = {value}" for key, value in settings.items())
            self.notes.append(f"{shown} is refused: {text}")
            return Trial(settings, None, "", {}, {}, text)
        seconds: dict[str, float] = {}
        for _ in range(self.repeat):
            TABLES.clear()
            found = self.measurement.run(plan)
            own = seconds_by_stage(found)
            seconds = {name: min(s, seconds.get(name, s)) for name, s in own.items()}
        measured = self.measurement.compared(plan, found)
        names = [name for _, name in plan.wanted]
        wanted = {
            name: e for name, e in measured.errors.items() if name in names or tuple(name.split(".")) in plan.wanted
        }
        known = {name: e.rms for name, e in wanted.items() if e.rms is not None}
        worst = max(known, key=lambda name: known[name], default="")
        for name, e in wanted.items():
            if e.rms is None and (note := f"{name} is not counted: {e.why}") not in self.notes:
                self.notes.append(note)
        self.floor = max([self.floor, *(e.below for e in wanted.values() if e.below < float("inf"))])
        stage_errors = {}
        for key, places in self.own.items():
            own_errors = [measured.errors.get(f"{s}.{v}", measured.errors.get(v)) for s, v in places]
            values = [e.rms for e in own_errors if e is not None and e.rms is not None]
            stage_errors[key] = max(values) if values else known.get(worst)
        return Trial(dict(settings), known.get(worst), worst, stage_errors, seconds)

    def curve(self, knob: Knob, reference: Trial) -> Curve:
        """From the reference towards cheaper settings, as long as anything is left of the picture."""
        trials = [reference]
        for setting in reversed(knob.settings[:-1]):
            trials.insert(0, self.trial({knob.key: setting}))
            if (trials[0].error or 0.0) > COARSEST:
                self.notes.append(f"{knob.key}: settings cheaper than {setting} are not tried")
                break
        places = self.own[knob.key]
        where = f"{places[0][0]}.{places[0][1]}" if len(places) == 1 else places[0][0] if places else "what is wanted"
        used = [t for t in trials if not t.why]
        shown = [t.setting(knob) for t in used]
        finite = not knob.closed_form and len(used) > 1
        last = (
            shown[-1]
            if finite and isinstance(shown[-1], int | float) and not isinstance(shown[-1], bool) and shown[-1] > 0
            else None
        )
        power = (
            last is not None and last < shown[0]
        )  # of a width: what a finite reference lacks itself is known from the law
        counted = len(used) - (
            0 if not finite else 1 if power else 2
        )  # else one refinement before it shows half of its error
        law = convergence(shown[:counted], [t.stage_errors.get(knob.key) for t in used[:counted]], reference=last)
        if finite:
            self.floor = max(self.floor, remaining(shown, used[-2].error or 0.0, law))
        return Curve(knob, where, tuple(used), self.affected[knob.key], law)

    def choices(self, curves: Sequence[Curve]) -> dict[str, list[tuple[Any, float, float]]]:
        """By knob: settings, their error, and the seconds of the stages that it affects."""
        return {
            c.knob.key: [(t.setting(c.knob), t.error or 0.0, c.seconds(t)) for t in c.trials if t.error is not None]
            for c in curves
        }

    def settled(self) -> list[Trial]:
        """All trials. The work of a stage hangs on the knobs that affect it: where these stand alike, the least of
        its times counts.
        """
        least: dict[tuple[Any, ...], float] = {}
        for trial in self.trials.values():
            for stage, seconds in trial.seconds.items():
                work = self.work(trial, stage)
                least[work] = min(seconds, least.get(work, seconds))
        return [
            replace(t, seconds={stage: least[self.work(t, stage)] for stage in t.seconds}) for t in self.trials.values()
        ]

    def work(self, trial: Trial, stage: str) -> tuple[Any, ...]:
        return stage, *((k.key, trial.setting(k)) for k in self.knobs if stage in self.affected[k.key])

    def settled_curves(self, curves: Sequence[Curve]) -> list[Curve]:
        settled = {tuple(sorted(t.settings.items())): t for t in self.settled()}
        return [replace(c, trials=tuple(settled[tuple(sorted(t.settings.items()))] for t in c.trials)) for c in curves]

    def noise(self) -> tuple[float | None, str]:
        """How far a frame is from its mean: rms of the last wanted picture behind a draw, of the reference."""
        self.told("the noise of a frame")
        exact = self.measurement.exact
        drawing = behind(exact, (node.name for node in exact.nodes if node.is_random))
        pictures = [(s, v) for s, v in exact.wanted if s in drawing and {"y", "x"} <= set(exact.node(s).writes[v].dims)]
        if not pictures:
            return None, ""
        order = [node.name for node in exact.nodes]
        stage, name = max(
            pictures, key=lambda place: (known_variable(place[1]).shown == "encoded", order.index(place[0]))
        )
        plan = make_plan(self.exact, self.registry)
        ref = self.measurement.cells_of(plan, stage)[0][0]
        frame = collect(plan, {ref: [name]}, self.options)
        if ref not in frame.arrays or ref not in self.measurement.truth.arrays:
            return None, ""
        cell = exact.cells[ref]
        found = difference(
            frame.arrays[ref][name],
            self.measurement.truth.arrays[ref][name],
            exact.node(stage).writes[name],
            cell.stage,
        )
        return found.rms, name


def seconds_by_stage(found: Collected) -> dict[str, float]:
    seconds: dict[str, float] = {}
    for (stage, _), report in found.reports.items():
        seconds[stage] = seconds.get(stage, 0.0) + report.seconds
    return seconds


def affected(plan: Plan, knob: Knob) -> frozenset[str]:
    """The stages whose work a knob may change: its own, those that are joined with it into one pass, and behind
    another grid all.
    """
    if not knob.stage:
        return frozenset(node.name for node in plan.nodes)
    found = behind(plan, [knob.stage]) if knob.studied else {knob.stage}
    if knob.studied:  # other bands or another grid are other work for those too that look at transfer functions
        found |= {node.name for node in plan.nodes if any(set(names) & found for _, _, names in node.looks_at)}
    joined = [set(node.segment) for node in plan.nodes if knob.stage in node.segment]
    return frozenset(found.union(*joined))


def own_variables(plan: Plan, stage: str) -> tuple[Wanted, ...]:
    """Where the error of a stage is found: all figures of a probe, else the first variable without bands from the
    stage on.
    """
    reached = behind(plan, [stage])
    for node in plan.nodes:
        if node.name == stage and node.is_probe:
            return tuple((stage, name) for name in node.writes)
        for name, declaration in node.writes.items() if node.name in reached and not node.is_probe else ():
            if not banded(declaration.dims) and declaration.dims:
                return ((node.name, name),)
    return ()
