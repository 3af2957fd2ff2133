"""A search: settings are asked of optuna, evaluated by a session, and what was found is told.

In:  a pipeline, what is asked for, the number of trials.
Out: the trials, the best of them, or the front of several goals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from etendue.contract.registry import installed_stages
from etendue.errors import Fault, RequestError
from etendue.evaluation.session import Session
from etendue.pipeline.file import PipelineFile
from etendue.plan.identity.keys import digest, version_of
from etendue.types.documents import Document, DocumentView
from etendue_lab.search.asked import Asked, Range, read_request
from etendue_lab.search.memory import Memory

if TYPE_CHECKING:
    from etendue.builder.pipeline import Pipeline

SAMPLERS = ("tpe", "nsga2", "random")
FIRST = 15  # trials of the first, spread ones


@dataclass(frozen=True)
class Trial:
    """One evaluation. ``excess``: by how much each limit is exceeded, as a share of its bound."""

    number: int
    settings: DocumentView
    values: tuple[float, ...] = ()
    excess: tuple[float, ...] = ()
    failed: str = ""

    @property
    def allowed(self) -> bool:
        return not self.failed and all(one <= 0 for one in self.excess)


@dataclass(frozen=True)
class Found:
    """The trials of a search."""

    pipeline: str
    asked: Asked
    trials: tuple[Trial, ...]
    recalled: int = 0  # of these, the ones that an earlier call has made

    @property
    def best(self) -> list[Trial]:
        """The best trial within the limits; of several goals, those that no other beats in all, by the first goal."""
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
            "outside": sum(not one.failed and not one.allowed for one in self.trials),
            "recalled": self.recalled,
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
        if not self.best:
            yield "no trial meets all limits; more trials, other limits or wider ranges may help"


Told = Callable[[Trial, bool], None]  # called with every trial, and whether it is the best so far


def search(
    pipeline: PipelineFile,
    asked: Asked,
    trials: int,
    folder: Path | None = None,
    told: Told = lambda trial, best: None,
) -> Found:
    """Make trials, or read them from a folder where an earlier call has made them.

    Raises
    ------
    RequestError
        optuna is not installed, the folder is of another search, or a metric is not there or has several values.
    """
    optuna = _optuna()
    session = Session(pipeline)
    plan = session.plan(asked.metrics, {})  # refuses metrics that nobody writes, before any trial
    keys = digest("\n".join(plan.cells[ref].key for ref in sorted(plan.cells)).encode())
    request = {**asked.document(), "pipeline": keys, "optuna": version_of("optuna")}
    memory = Memory(folder, request)
    study = optuna.create_study(
        directions=["maximize" if goal.largest else "minimize" for goal in asked.goals],
        sampler=_sampler(optuna, asked),
    )
    made: list[Trial] = []
    recalled, leading = 0, list[Trial]()
    for number in range(trials):
        asking = study.ask()
        settings = {one.key: _suggested(asking, one) for one in asked.ranges}
        known = memory.of(number, settings)
        if known is None:
            trial = _evaluated(session, asked, number, settings)
            memory.add(asdict(trial))
        else:
            recalled += 1
            trial = replace(_as_trial(known), settings=settings)
        for limit, over in zip(asked.limits, trial.excess, strict=False):  # a failed trial has none
            asking.set_constraint(str(limit), over)
        if trial.failed:
            study.tell(asking, state=optuna.trial.TrialState.FAIL)
        else:
            study.tell(asking, list(trial.values))
        made.append(trial)
        best = Found(pipeline.name, asked, tuple([*leading, trial])).best
        told(trial, trial in best)
        leading = best
    return Found(pipeline.name, asked, tuple(made), recalled)


def _evaluated(session: Session, asked: Asked, number: int, settings: Document) -> Trial:
    (row,) = session.rows([settings], asked.metrics)
    if row.failed:
        return Trial(number, settings, failed=row.failed)
    values = tuple(goal.metric.of(row.metrics) for goal in asked.goals)
    excess = tuple(limit.excess(limit.metric.of(row.metrics)) for limit in asked.limits)
    if not all(map(math.isfinite, (*values, *excess))):
        return Trial(number, settings, failed="a metric is not a finite number")
    return Trial(number, settings, values, excess)


def _as_trial(known: DocumentView) -> Trial:
    return Trial(known["number"], known["settings"], tuple(known["values"]), tuple(known["excess"]), known["failed"])


def _suggested(asking: Any, one: Range) -> Any:
    if one.choices:
        return asking.suggest_categorical(one.key, one.choices)
    if one.whole:
        return asking.suggest_int(one.key, int(one.low), int(one.high), log=one.logarithmic)
    return asking.suggest_float(one.key, one.low, one.high, log=one.logarithmic)


def _sampler(optuna: Any, asked: Asked) -> Any:
    if asked.sampler == "random":
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
    sampler: str = "tpe",
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
        raise RequestError([Fault("sampler", f"{sampler!r} is none of {', '.join(SAMPLERS)}")])
    return sampler
