"""Error against run time: each knob of a pipeline alone, and the Pareto front over their combinations.

In:  a pipeline, and the knobs to try.
Out: an ``Accuracy``: curves, trials, the front, the cheapest setting for a list of tolerances, the noise floor.

Every trial is a run of expected values compared with the reference (`measuring`); knobs that are not tried stay at
their reference. Seconds are thread time in one thread without cached tables; for each stage, the minimum over all runs
with the same settings of the knobs that affect it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from etendue.accuracy.orders import ROUNDING
from etendue.accuracy.reference import PipelineKnob, knobs_of
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
    verified: list[tuple[float, float | None, str]] = field(
        default_factory=list
    )  # error of the cheapest settings on the other source
    verified_at: AxisValues = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


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
) -> Accuracy:
    """Try every knob alone, then combinations.

    Parameters
    ----------
    pipeline : as read
    registry : of installed stages
    asked : by knob (``stage.knob``, including those that the file writes, and ``precision``) settings from the cheapest
        to the reference, () for those that it declares; if empty, all knobs that the file does not write
    cells : places of the sweep
    repeat : runs of each trial; the fastest counts
    most : largest number of combinations
    told : called with what is being tried
    elsewhere : the same stages with another source, on which the cheapest settings are tried too; ``verify`` names it

    Raises
    ------
    RequestError
        The pipeline is invalid, or has no such knob.
    """
    given = frozenset(key for key, values in asked.items() if values)
    effort = Effort(cells, repeat, told)
    study = Trials(pipeline, registry, chosen_knobs(pipeline, registry, asked), given, effort)
    once = replace(effort, repeat=1)
    other = None if elsewhere is None else Trials(elsewhere, registry, study.knobs, given, once)
    reference = study.search.at({})
    curves = [study.curve(knob, reference) for knob in study.knobs]
    study.search.explored(study.choices(study.settled_curves(curves)), map(Goal, TOLERANCES), most)
    planned = study.planned(pipeline)
    trials = study.settle()
    done = [t for t in trials if t.error is not None]
    floor = max(study.floor, ROUNDING)

    def of(trial: SettingTrial) -> tuple[float, float]:
        """Errors below the possible error of the reference count as equal."""
        error, seconds = error_and_cost(trial)
        return max(error, floor), seconds

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
        tried = [(t, other.search.at(one.settings)) for t, one in found.cheapest if one]
        found.verified = [(t, one.error, one.variable) for t, one in tried]
    return found


def chosen_knobs(
    pipeline: PipelineFile, registry: Registry, asked: Mapping[str, tuple[Any, ...]]
) -> tuple[PipelineKnob, ...]:
    """Return the knobs to try: those asked for, else all that the file does not write and that change no grid.

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
    if not asked:
        return tuple(k for k in known.values() if k.settings and not (k.written or k.studied))
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
            own = _resolved(knob, values, pipeline, registry)
            chosen.append(
                replace(knob, settings=own, closed_form=own[-1] == knob.reference and knob.closed_form) if own else knob
            )
        except Unfit as error:
            faults.append(Fault(f"--knob {key}", str(error)))
    if faults:
        raise RequestError(faults, pipeline.file)
    return tuple(chosen)


def _resolved(
    knob: PipelineKnob, values: tuple[Value, ...], pipeline: PipelineFile, registry: Registry
) -> tuple[Value, ...]:
    """Return settings in the unit of the knob; raise ``Unfit`` if it does not accept one."""
    if not knob.stage:
        if not set(values) <= set(knob.settings):
            raise Unfit(f"expected {' and '.join(map(str, knob.settings))}")
        return values
    parameter, kind, _ = parameters_of(registry.load(knob.use))[knob.name]
    return tuple(resolve(value, parameter, kind, pipeline.folder) for value in values)
