"""Error against run time: each knob of a pipeline alone, and the Pareto front over their combinations.

In:  a pipeline, and the knobs to try.
Out: an ``Accuracy``: curves, trials, the front, the cheapest setting for a list of tolerances, the noise floor.

Every trial is a run of expected values compared with the reference on its grid (`measuring`); knobs that are not tried
stay at their reference. The error of the grid is measured separately (`sampling`) and added. Seconds are CPU time in
one thread, cold and warm (`timing`); for each stage they come from all runs with the same settings of the knobs that
affect it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from etendue.accuracy.measuring import Measurement
from etendue.accuracy.orders import ROUNDING
from etendue.accuracy.reference import PipelineKnob, knobs_of
from etendue.accuracy.sampling import sampling_knobs
from etendue.accuracy.splitting import Prediction, choices, split, split_as_planned
from etendue.accuracy.timing import WARM
from etendue.accuracy.trials import PRECISION, Effort, SettingCurve, SettingTrial, Told, Trials
from etendue.contract.registry import Registry
from etendue.contract.stage import parameters_of
from etendue.errors import Fault, RequestError, nearest
from etendue.pipeline.file import PipelineFile
from etendue.plan.expansion.search import Goal, Value, cheapest, error_and_cost, front
from etendue.plan.wiring.parameters import Unfit, resolve
from etendue.types.documents import AxisValues

TOLERANCES = tuple(10.0**-n for n in range(1, 9))
WORTH = 0.9  # a slower setting is on the front only if its error is below this fraction of the faster one's


@dataclass
class Accuracy:
    """The result of the study."""

    pipeline: str
    at: AxisValues  # axis values of the cells
    curves: list[SettingCurve]
    trials: list[SettingTrial]  # all trials, the reference first
    frontier: list[SettingTrial]
    planned: SettingTrial  # the pipeline as the file has it
    cheapest: list[tuple[float, SettingTrial | None]]
    floor: float  # possible error of the reference itself
    noise_floor: float | None
    noise_of: str
    # error of the cheapest settings on the other source
    verified: list[tuple[float, float | None, str]] = field(default_factory=list)
    verified_at: AxisValues = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    by: str = WARM  # the time by which settings are compared


def accuracy(
    pipeline: PipelineFile,
    registry: Registry,
    asked: Mapping[str, tuple[Any, ...]] = {},
    cells: int = 1,
    repeat: int = 3,
    most: int = 24,
    told: Told = lambda text: None,
    elsewhere: PipelineFile | None = None,
    verify: Mapping[str, Any] = {},
    by: str = WARM,
) -> Accuracy:
    """Try every knob alone, then combinations.

    Parameters
    ----------
    pipeline : pipeline as read
    registry : registry of installed stages
    asked : settings to try for each knob, from the cheapest to the reference; () tries the settings that the stage
        declares. A knob is named ``stage.knob`` or ``precision``; the file may set it. If ``asked`` is empty, all knobs
        that the file does not set and all discretisations are tried
    cells : number of points of the sweep
    repeat : number of cold and warm runs of each trial
    most : largest number of combinations
    told : called with a text before each trial
    elsewhere : the same stages with another scene, on which the cheapest settings are tried too
    verify : the values that distinguish ``elsewhere`` from the pipeline
    by : time used to compare settings: ``warm`` (tables are computed once) or ``cold``

    Raises
    ------
    RequestError
        The pipeline is invalid, or has no such knob.
    """
    given = frozenset(key for key, values in asked.items() if values)
    effort = Effort(cells, repeat, told, by)
    study = Trials(pipeline, registry, chosen_knobs(pipeline, registry, asked, cells), given, effort)
    once = replace(effort, repeat=1)
    other = None if elsewhere is None else Trials(elsewhere, registry, study.knobs, given, once)
    reference = study.search.at({})
    curves = [study.curve(knob, reference) for knob in study.knobs]
    curves = study.settled_curves(curves)
    possible = choices(study, curves)
    study.search.explored(possible, [Goal(one) for one in TOLERANCES], most, Prediction(study, curves, possible))
    planned = study.planned(pipeline)

    def of(trial: SettingTrial) -> tuple[float, float]:
        """Return error and seconds of a trial; errors below the possible error of the reference count as equal."""
        error, seconds = error_and_cost(trial)
        return max(error, max(study.floor, ROUNDING)), seconds

    done = [t for t in study.settle() if t.error is not None]
    study.again((*front(done, of, WORTH), *_cheapest(done, of)))
    trials = [split(t, study.settled_curves(curves), study.sampled) for t in study.settle()]
    done = [t for t in trials if t.error is not None]
    found = Accuracy(
        pipeline.name,
        dict(study.measurement.places[0]) if len(study.measurement.places) == 1 else {},
        study.settled_curves(curves),
        trials,
        front(done, of, WORTH),
        split_as_planned(planned, study.sampled),
        [(t, cheapest(done, of, t)) for t in TOLERANCES],
        max(study.floor, ROUNDING),
        *study.noise(),
        notes=study.notes,
        by=by,
    )
    if other is not None:
        found.verified_at = dict(verify)
        tried = [(t, other.search.at(one.settings)) for t, one in found.cheapest if one]
        found.verified = [(t, max(one.computed.values(), default=None), one.variable) for t, one in tried]
    return found


def _cheapest(trials: Sequence[SettingTrial], of: Callable[[SettingTrial], tuple[float, float]]) -> list[SettingTrial]:
    """Return the cheapest trial for every tolerance, and the next cheapest trials, which may prove cheaper when timed
    again.
    """
    found = []
    for tolerance in TOLERANCES:
        within = sorted((t for t in trials if of(t)[0] <= tolerance), key=lambda t: of(t)[1])
        found += within[:2]
    return found


def chosen_knobs(
    pipeline: PipelineFile, registry: Registry, asked: Mapping[str, tuple[Any, ...]], cells: int = 1
) -> tuple[PipelineKnob, ...]:
    """Return the knobs to try: the requested knobs, else all knobs that the file does not set and the discretisations.

    Raises
    ------
    RequestError
        A knob does not exist, or its settings have no order.
    """
    known = {knob.key: knob for knob in knobs_of(pipeline, registry)}
    written, words = pipeline.precision != "auto", ("float32", "float64")
    known[PRECISION] = PipelineKnob(
        "", PRECISION, words, use="", closed_form=True, value=pipeline.precision, written=written, studied=False
    )
    sampling = sampling_knobs(Measurement(pipeline, registry, cells))
    known |= {knob.key: knob for knob in sampling}
    if not asked:
        free = (k for k in known.values() if k.settings and not (k.written or k.studied or k.discretisation))
        return (*free, *sampling)
    faults, chosen = [], []
    for key, values in asked.items():
        if key not in known:
            hint = nearest(key, known) or f"; it has {', '.join(known)}"
            faults.append(Fault(f"--knob {key}", f"no stage of this pipeline has this fidelity parameter{hint}"))
            continue
        knob = known[key]
        if len(values) == 1:
            faults.append(Fault(f"--knob {key}", "expected two or more settings, from the cheapest to the reference"))
        elif not (values or knob.settings):
            faults.append(
                Fault(
                    f"--knob {key}",
                    "its settings have no order from cheap to exact; compare them with: etendue compare --axis",
                )
            )
        try:
            chosen.append(_with_settings(knob, values, pipeline, registry))
        except Unfit as error:
            faults.append(Fault(f"--knob {key}", str(error)))
    if faults:
        raise RequestError(faults, pipeline.file)
    return tuple(chosen)


def _with_settings(
    knob: PipelineKnob, values: tuple[Value, ...], pipeline: PipelineFile, registry: Registry
) -> PipelineKnob:
    """Return a knob with these settings, in its unit; raise ``Unfit`` if it does not accept one of them."""
    if knob.stage:
        parameter, kind, _ = parameters_of(registry.load(knob.use))[knob.name]
        values = tuple(resolve(value, parameter, kind, pipeline.folder) for value in values)
    elif not set(values) <= set(knob.settings):
        raise Unfit(f"expected {' and '.join(map(str, knob.settings))}")
    if not values:
        return knob
    if knob.discretisation:  # other knobs are tried on the grid of the file, if that is one of the settings
        return replace(knob, settings=values, value=knob.value if knob.value in values else values[-1])
    return replace(knob, settings=values, closed_form=values[-1] == knob.reference and knob.closed_form)
