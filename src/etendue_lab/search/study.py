"""A search: optuna chooses settings, a session evaluates them, and optuna receives the results.

In:  a pipeline, the request, the number of trials.
Out: the trials, and the best trial or, for several goals, the Pareto front.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue.contract.registry import installed_stages
from etendue.errors import Fault, RequestError
from etendue.evaluation.session import Session
from etendue.pipeline.file import PipelineFile
from etendue.plan.identity.code import code_at
from etendue.plan.identity.keys import digest, version_of
from etendue.types.documents import Document, DocumentView
from etendue_lab.search import bounds
from etendue_lab.search.asked import Asked, Limit, Range, read_request
from etendue_lab.search.memory import Memory
from etendue_lab.search.model import Model, Process

if TYPE_CHECKING:
    from etendue.builder.pipeline import Pipeline

SAMPLERS = ("model", "tpe", "nsga2", "random")
FIRST = 15  # number of initial trials, spread over the ranges
NEVER = 1e6  # excess that is reported for a failed trial
SAMPLES = 1024  # sampled settings, over all ranges, from which importance is computed
FEW = 30  # with fewer trials, importance is not computed


@dataclass(frozen=True)
class Trial:
    """One evaluation. ``excess``: the amount by which each limit is exceeded, relative to the number in the limit.
    ``spared``: the limit that is certainly exceeded, so that the goals were not computed.
    """

    number: int
    settings: DocumentView
    values: tuple[float, ...] = ()
    excess: tuple[float, ...] = ()
    failed: str = ""
    spared: str = ""

    @property
    def allowed(self) -> bool:
        return not (self.failed or self.spared) and all(one <= 0 for one in self.excess)


@dataclass(frozen=True)
class Found:
    """The trials of a search."""

    pipeline: str
    asked: Asked
    trials: tuple[Trial, ...]
    recalled: int = 0  # number of trials made by an earlier call
    importance: Mapping[str, float] = field(default_factory=dict)  # of each setting for the first goal; sum 1

    @property
    def best(self) -> list[Trial]:
        """The best trial within the limits; for several goals, the trials that no other trial beats in all goals,
        sorted by the first goal.
        """
        allowed = [one for one in self.trials if one.allowed]
        front = [one for one in allowed if not any(self._beats(other, one) for other in allowed)]
        first = self.asked.goals[0]
        front.sort(key=lambda one: -one.values[0] if first.largest else one.values[0])
        return front[:1] if len(self.asked.goals) == 1 else front

    def _beats(self, one: Trial, other: Trial) -> bool:
        pairs = list(zip(self.asked.goals, one.values, other.values, strict=True))
        return not any(goal.better(b, a) for goal, a, b in pairs) and any(goal.better(a, b) for goal, a, b in pairs)

    def document(self) -> Document:
        """Return what ``etendue optimise --json`` prints."""
        return {
            "pipeline": self.pipeline,
            **self.asked.document(),
            "trials": [asdict(one) | {"allowed": one.allowed} for one in self.trials],
            "best": [self._row(one) for one in self.best],
            "failed": sum(bool(one.failed) for one in self.trials),
            "spared": sum(bool(one.spared) for one in self.trials),
            "outside": sum(not one.failed and not one.allowed for one in self.trials),
            "recalled": self.recalled,
            "importance": dict(self.importance),
            "notes": [*self.asked.notes, *self._why()],
        }

    def _row(self, one: Trial) -> Document:
        values = zip(self.asked.goals, one.values, strict=True)
        return {
            "number": one.number,
            "settings": dict(one.settings),
            "values": {str(goal.metric): value for goal, value in values},
        }

    def _why(self) -> Iterator[str]:
        reasons = dict.fromkeys(one.failed for one in self.trials if one.failed)
        yield from (f"failed: {text}" for text in list(reasons)[:3])
        spared = Counter(one.spared for one in self.trials if one.spared)
        yield from (f"{count} trials: {text}; other variables were not computed" for text, count in spared.items())
        if not self.best:
            yield "no trial meets all limits; more trials, other limits or wider ranges may help"


Told = Callable[[Trial, bool], None]  # called with each trial, and whether this trial is the best so far


def search(
    pipeline: PipelineFile,
    asked: Asked,
    trials: int,
    folder: Path | None = None,
    told: Told = lambda trial, best: None,
) -> Found:
    """Run the trials; trials that an earlier call stored in the folder are read instead.

    Raises
    ------
    RequestError
        optuna is not installed, the folder belongs to another search, or a metric does not exist or has several values.
    """
    optuna = _optuna()
    session = Session(pipeline)
    plan = session.plan(asked.metrics, {})  # before any trial, refuses metrics that no stage writes
    # for the camera as written in the file
    known_first = bounds.First(bool(bounds.bounded(plan, asked.limits)), bounds.cheap(plan, asked.limits))
    keys = digest("\n".join(plan.cells[ref].key for ref in sorted(plan.cells)).encode())
    request = {**asked.document(), "pipeline": keys, "optuna": version_of("optuna")}
    if asked.sampler == "model":
        request["code of the model"] = code_at("etendue_lab.search.model")
    memory = Memory(folder, request)
    study = optuna.create_study(
        directions=["maximize" if goal.largest else "minimize" for goal in asked.goals],
        sampler=_sampler(optuna, asked),
    )
    made: list[Trial] = []
    model = Model(sum(map(_places, asked.ranges)), asked.seed) if asked.sampler == "model" else None
    recalled, leading = 0, list[Trial]()
    for number in range(trials):
        if model is not None:
            study.enqueue_trial(_modelled(model, asked, made))
        asking = study.ask()
        settings = {one.key: _suggested(asking, one) for one in asked.ranges}
        known = memory.of(number, settings)
        if known is None:
            trial = _evaluated(session, asked, known_first, number, settings)
            memory.add(asdict(trial))
        else:
            recalled += 1
            values, excess = tuple(known["values"]), tuple(known["excess"])
            trial = Trial(**{**known, "settings": settings, "values": values, "excess": excess})
        for limit, over in zip(asked.limits, trial.excess, strict=False):  # a failed trial has none
            asking.set_constraint(str(limit), over)
        # A failed trial is reported as far beyond a limit. Samplers learn nothing from trials marked as failed and
        # would repeat similar settings. Of a trial beyond a limit they use only the excess, not the values.
        asking.set_constraint("failed", NEVER if trial.failed else 0.0)
        study.tell(asking, list(trial.values) or [0.0] * len(asked.goals))
        made.append(trial)
        best = Found(pipeline.name, asked, tuple([*leading, trial])).best
        told(trial, trial in best)
        leading = best
    return Found(pipeline.name, asked, tuple(made), recalled, _importance(made, asked))


def _importance(made: list[Trial], asked: Asked) -> dict[str, float]:
    """Return the importance of each setting for the first goal, largest first. The importance is the total Sobol' index
    over the ranges, from a model of the trials, scaled to a sum of 1. Empty if there are few trials.
    """
    whole = [one for one in made if one.values]
    if len(whole) < FEW or len(asked.ranges) < 2:
        return {}
    points = np.array([_point(asked, one.settings) for one in whole])
    process = Process()
    process.fit(points, np.array([one.values[0] for one in whole]), True)
    one, other = np.random.Generator(np.random.Philox(key=[asked.seed, FEW])).random((2, SAMPLES, points.shape[1]))
    found, start = dict[str, float](), 0
    for setting in asked.ranges:
        changed, own = one.copy(), slice(start, start + _places(setting))
        changed[:, own] = other[:, own]
        found[setting.key] = float(((process.at(one)[0] - process.at(changed)[0]) ** 2).mean())
        start = own.stop
    total = sum(found.values()) or 1.0
    return {name: value / total for name, value in sorted(found.items(), key=lambda item: -item[1])}


def _evaluated(session: Session, asked: Asked, first: bounds.First, number: int, settings: Document) -> Trial:
    """Run a trial and return it: check declared bounds first, then limits that take little time, then compute
    the rest.
    """
    if first.bounded and (spared := _bounded(session, asked, number, settings)) is not None:
        return spared
    if first.cheap:
        (row,) = session.rows([settings], list(dict.fromkeys(one.metric.name for one in first.cheap)))
        if not row.failed:
            known = {one: one.excess(one.metric.of(row.metrics)) for one in first.cheap}
            if any(over > 0 for over in known.values()):
                return _spared(asked, number, settings, known, "is beyond the limit, which was computed first")
    (row,) = session.rows([settings], asked.metrics)
    if row.failed:
        return Trial(number, settings, failed=row.failed)
    values = tuple(goal.metric.of(row.metrics) for goal in asked.goals)
    excess = tuple(limit.excess(limit.metric.of(row.metrics)) for limit in asked.limits)
    if not all(map(math.isfinite, (*values, *excess))):
        return Trial(number, settings, failed="a metric is not a finite number")
    return Trial(number, settings, values, excess)


def _bounded(session: Session, asked: Asked, number: int, settings: Document) -> Trial | None:
    try:
        known = bounds.bounded(session.plan(asked.metrics, settings), asked.limits)
    except RequestError as error:
        return Trial(number, settings, failed=str(error))
    if not any(over > 0 for over in known.values()):
        return None
    return _spared(asked, number, settings, known, "cannot be met, according to the declarations of the stage")


def _spared(asked: Asked, number: int, settings: Document, known: Mapping[Limit, float], why: str) -> Trial:
    excess = tuple(known.get(limit, 0.0) for limit in asked.limits)
    if not all(map(math.isfinite, excess)):
        return Trial(number, settings, failed="a metric is not a finite number")
    worst = max(known, key=lambda limit: known[limit])
    return Trial(number, settings, (), excess, spared=f"{worst} {why}")


def _places(one: Range) -> int:
    """Return how many dimensions of the model's cube a range takes: 1 for numbers, or one for each choice."""
    return len(one.choices) or 1


def _modelled(model: Model, asked: Asked, made: list[Trial]) -> Document:
    """Return the settings of the next trial from the model of the earlier trials."""
    points = np.array([_point(asked, one.settings) for one in made])
    signs = [-1.0 if goal.largest else 1.0 for goal in asked.goals]
    goals = [np.multiply(signs, t.values) if t.values else np.full(len(signs), np.nan) for t in made]
    # Failure is treated as one more limit. Of a spared trial only the exceeded limits are known.
    excess = [
        [
            1.0 if t.failed else -1.0,
            *([e if t.values or e > 0 else np.nan for e in t.excess] or [np.nan] * len(asked.limits)),
        ]
        for t in made
    ]
    rows = len(made)
    found = model.next(
        points.reshape(rows, model.size),
        np.array(goals).reshape(rows, len(signs)),
        np.array(excess).reshape(rows, 1 + len(asked.limits)),
    )
    settings, start = {}, 0
    for one in asked.ranges:
        settings[one.key] = _value(one, found[start : start + _places(one)])
        start += _places(one)
    return settings


def _point(asked: Asked, settings: DocumentView) -> list[float]:
    return [place for one in asked.ranges for place in _placed(one, settings[one.key])]


def _placed(one: Range, value: Any) -> list[float]:
    if one.choices:
        return [float(value == choice) for choice in one.choices]
    low, high, value = (math.log(v) if one.logarithmic else v for v in (one.low, one.high, value))
    return [(value - low) / (high - low) if high > low else 0.5]


def _value(one: Range, places: Any) -> Any:
    if one.choices:
        return one.choices[int(np.argmax(places))]
    share = float(places[0])
    if one.whole:
        return round(min(max(_between(one, share), one.low), one.high))
    return min(max(_between(one, share), one.low), one.high)


def _between(one: Range, share: float) -> float:
    if one.logarithmic:
        return math.exp(math.log(one.low) + share * (math.log(one.high) - math.log(one.low)))
    return one.low + share * (one.high - one.low)


def _suggested(asking: Any, one: Range) -> Any:
    if one.choices:
        return asking.suggest_categorical(one.key, one.choices)
    if one.whole:
        return asking.suggest_int(one.key, int(one.low), int(one.high), log=one.logarithmic)
    return asking.suggest_float(one.key, one.low, one.high, log=one.logarithmic)


def _sampler(optuna: Any, asked: Asked) -> Any:
    if asked.sampler in ("random", "model"):
        return optuna.samplers.RandomSampler(seed=asked.seed)
    if asked.sampler == "nsga2":
        return optuna.samplers.NSGAIISampler(seed=asked.seed)
    return optuna.samplers.TPESampler(seed=asked.seed, n_startup_trials=FIRST, multivariate=True)


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise RequestError(
            [Fault("", "a search needs optuna, which is not installed: pip install 'etendue[optimise]'")]
        ) from None
    import warnings

    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def optimise(
    pipeline: Pipeline,
    trials: int = 100,
    output: str | Path | None = None,
    seed: int = 0,
    sampler: str = "model",
    **texts: str | Iterable[str],
) -> Found:
    """Search for settings, as ``etendue optimise`` does: ``minimise``, ``maximise``, ``subject`` and ``over`` are
    texts, or lists of them.
    """
    several = {name: [text] if isinstance(text, str) else list(text) for name, text in texts.items()}
    written = pipeline.written()
    if unknown := sorted(several.keys() - {"minimise", "maximise", "subject", "over"}):
        raise RequestError([Fault(name, "expected minimise, maximise, subject or over") for name in unknown])
    asked = replace(read_request(written, installed_stages(), **several), seed=seed, sampler=_checked(sampler))
    return search(written, asked, trials, None if output is None else Path(output))


def _checked(sampler: str) -> str:
    if sampler not in SAMPLERS:
        raise RequestError([Fault("sampler", f"{sampler!r} is unknown; allowed: {', '.join(SAMPLERS)}")])
    return sampler
