"""Search the settings of knobs: what may be set, what was tried, and which setting reaches a goal at the least cost.

In:  knobs with their settings from the cheapest to the finest, and a function that evaluates a combination of settings.
Out: trials, each combination evaluated once, within a budget; the front of error and cost.

What evaluates a combination differs, the search does not: a plan asks a stage for its bounds (`approximate`),
``--hold`` measures errors of a whole pipeline (`accuracy.holding`), ``etendue accuracy`` measures errors and seconds
(`accuracy.trials`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, TypeVar

Value = bool | int | float | str
Settings = Mapping[str, Value]  # by key of the knob
Choices = Mapping[str, Sequence["Setting"]]  # by key of the knob, from the cheapest to the finest
Name = tuple[tuple[str, Value], ...]  # of a trial: the settings that it moves
Predicted = Callable[[Settings], tuple[float, float]]  # error and cost of a combination; infinite: not to be tried
MANY = 300  # combinations; of more, only neighbours are looked at
DOUBT = 1.1  # of predicted costs
SAVED = 0.01  # of the cost of the whole; settings that save less are not combined
_Point = TypeVar("_Point")


@dataclass(frozen=True)
class Knob:
    """What may be set. A knob without a stage is of the whole pipeline, as its precision is."""

    stage: str
    name: str
    settings: tuple[Value, ...]  # from the cheapest to the finest; () if they have no order
    units: str = "1"

    @property
    def key(self) -> str:
        return f"{self.stage}.{self.name}" if self.stage else self.name

    def finer(self, value: Value) -> tuple[Value, ...]:
        """Return the finer settings, the next one first."""
        return self.settings[self.settings.index(value) + 1 :]

    def coarser(self, value: Value) -> tuple[Value, ...]:
        """Return the coarser settings, the next one first."""
        return self.settings[: self.settings.index(value)][::-1]


@dataclass(frozen=True)
class Setting:
    """One setting of a knob, with the error that it brings by itself and what it costs."""

    knob: Knob
    value: Value
    error: float  # a bound or measured, in the units of the goal
    cost: float  # in any unit that adds up over knobs


@dataclass(frozen=True)
class Goal:
    """The largest error allowed: relative to full scale, or in ``units``."""

    most: float
    units: str = "1"

    def met(self, error: float | None) -> bool:
        return error is not None and error <= self.most


@dataclass(frozen=True)
class Trial:
    """A combination of settings and what it gave; knobs that are not named are where the search starts."""

    settings: Settings
    error: float | None  # None: unknown, or the combination is refused

    @property
    def cost(self) -> float:
        return 0.0


@dataclass(frozen=True)
class Means:
    """What evaluations take, or may take: seconds of thread time in total, bytes of memory at once."""

    seconds: float
    bytes: float


class OverBudget(Exception):
    """An evaluation was not begun because it is expected to exceed the budget."""


_Tried = TypeVar("_Tried", bound=Trial)


class Search(Generic[_Tried]):
    """Evaluates combinations of settings, each once, as long as the budget lasts.

    Parameters
    ----------
    evaluate : returns the trial of a combination
    start : settings of knobs that a combination does not name
    budget : what it may spend; an evaluation that knows what it is going to take asks for it (``afford``)

    Attributes
    ----------
    tried : every trial, in the order of evaluation
    most : number of trials that it may reach
    lacking : what was needed next and not begun; None as long as the budget allows all
    """

    most = math.inf
    lacking: Means | None = None

    def __init__(
        self,
        evaluate: Callable[[Settings], _Tried],
        start: Mapping[str, Value] = {},
        budget: Means = Means(math.inf, math.inf),
    ) -> None:
        self.evaluate, self.start, self.budget = evaluate, start, budget
        self.tried: dict[Name, _Tried] = {}

    def at(self, settings: Settings) -> _Tried:
        """Return the trial of a combination; raise ``OverBudget`` if the budget does not allow it."""
        name = self.name(settings)
        if name not in self.tried:
            if len(self.tried) >= self.most:
                raise OverBudget
            self.tried[name] = self.evaluate(dict(name))
        return self.tried[name]

    def name(self, settings: Settings) -> Name:
        """Return the settings that differ from where the search starts, by which a trial is known."""
        return tuple(sorted((key, value) for key, value in settings.items() if value != self.start.get(key)))

    def afford(self, need: Means, spent: float) -> None:
        """Raise ``OverBudget`` if the budget does not allow what is needed after so many seconds are spent."""
        if spent + need.seconds > self.budget.seconds or need.bytes > self.budget.bytes:
            self.lacking = need
            raise OverBudget

    def loosened(
        self, knobs: Iterable[Knob], goal: Goal, start: Mapping[str, Value] = {}
    ) -> tuple[_Tried, list[Setting]]:
        """Set one knob after the other to its cheapest setting that meets the goal, where its finest does.

        Bisection finds it: for errors that never grow towards finer settings. Each setting is returned with what it
        adds to the error of the finest.
        """
        own, chosen = dict(start), []
        for knob in knobs:
            finest = best = self.at({**own, knob.key: knob.settings[-1]})
            if finest.error is None or not goal.met(finest.error):
                continue
            low, high, added = 0, len(knob.settings) - 1, 0.0
            while low < high:
                middle = (low + high) // 2
                trial = self.at({**own, knob.key: knob.settings[middle]})
                if trial.error is not None and goal.met(trial.error):
                    high, best, added = middle, trial, trial.error - finest.error
                else:
                    low = middle + 1
            own[knob.key] = knob.settings[high]
            chosen.append(Setting(knob, own[knob.key], added, best.cost))
        return self.at(own), chosen

    def stepped(
        self, knob: Knob, start: Value, goal: Goal, hopeless: Callable[[_Tried], bool] = lambda trial: False
    ) -> _Tried | None:
        """Return the cheapest setting that meets a goal, step by step: coarser as long as it does, else finer until it
        does. None: none did before the budget, the settings or hope ended.
        """
        found: _Tried | None = None
        with suppress(OverBudget):
            trial = self.at({knob.key: start})
            for value in knob.coarser(start) if goal.met(trial.error) else ():
                found, trial = trial, self.at({knob.key: value})
                if not goal.met(trial.error):
                    return found
            for value in () if goal.met(trial.error) else knob.finer(start):
                if hopeless(trial):
                    return None
                trial = self.at({knob.key: value})
                if goal.met(trial.error):
                    break
            return trial if goal.met(trial.error) else None
        return found

    def explored(self, choices: Choices, goals: Sequence[Goal], most: int, predicted: Predicted) -> None:
        """Try at most so many combinations: all if they are no more. Else for every goal, in turns, the one predicted
        to meet it at the least cost, as long as that is less than the cheapest trial that does. What is left is spent
        on neighbours in one setting that cost hardly more than that, as predictions may be wrong.

        Half of the trials are combinations that are the best at a price of error, to begin from.
        """
        self.most = len(self.tried) + most
        with suppress(OverBudget):
            if math.prod(map(len, choices.values())) <= most:
                every = itertools.product(*([(key, one.value) for one in own] for key, own in choices.items()))
                for own in every:
                    self.at(dict(own))
                return
            worth = worthwhile(choices, self.at({}).cost)
            for settings in combinations(worth, most // 2):
                if predicted(settings)[1] < math.inf:
                    self.at(settings)
            for some, at_once, doubt in ((worth, 2, 1.0), (choices, 1, DOUBT)):
                open_ = list(goals)
                while open_:
                    for goal in tuple(open_):
                        near = self._promising(some, goal, predicted, at_once, doubt)
                        if near is None:
                            open_.remove(goal)
                        else:
                            self.at(near)

    def _promising(
        self, choices: Choices, goal: Goal, predicted: Predicted, at_once: int, doubt: float
    ) -> Settings | None:
        """Return the untried combination that is predicted to meet a goal at the least cost; None if none is predicted
        to cost less than the cheapest trial that does, times ``doubt``.

        Of many combinations only neighbours of that trial count, else of the one with the least error: they have other
        settings of as many knobs as ``at_once``.
        """
        best = cheapest(self.tried.values(), error_and_cost, goal.most)
        least = doubt * best.cost if best else math.inf
        best = best or min(self.tried.values(), key=error_and_cost)
        moves = [[(key, one.value) for one in own] for key, own in choices.items()]
        if at_once > 1 and math.prod(map(len, moves)) <= MANY:
            some: Iterable[Sequence[tuple[str, Value]]] = itertools.product(*moves)
        else:
            some = itertools.chain(*(_moved(moves, 1 + n) for n in range(at_once)))
        found: Settings | None = None
        for changed in some:
            near: Settings = {**best.settings, **dict(changed)}
            if self.name(near) not in self.tried:
                error, cost = predicted(near)
                if cost < least and goal.met(error):
                    found, least = near, cost
        return found


def _moved(moves: Sequence[Sequence[_Point]], count: int) -> Iterable[tuple[_Point, ...]]:
    """Return one move of each of so many knobs, in every way."""
    return itertools.chain(*(itertools.product(*some) for some in itertools.combinations(moves, count)))


def error_and_cost(trial: Trial) -> tuple[float, float]:
    return (math.inf if trial.error is None else trial.error), trial.cost


def front(points: Iterable[_Point], of: Callable[[_Point], tuple[float, float]], worth: float = 1.0) -> list[_Point]:
    """Return the points that no other point beats in both (error, cost), the cheapest first; each has less than
    ``worth`` times the error of the one before."""
    chosen: list[_Point] = []
    for point in sorted(points, key=lambda p: (of(p)[1], of(p)[0])):
        if not chosen or of(point)[0] < worth * of(chosen[-1])[0]:
            chosen.append(point)
    return chosen


def cheapest(points: Iterable[_Point], of: Callable[[_Point], tuple[float, float]], most: float) -> _Point | None:
    """Return the point of least cost whose error is within ``most``; None if there is none."""
    within = [point for point in points if of(point)[0] <= most]
    return min(within, key=lambda point: (of(point)[1], of(point)[0]), default=None)


def worthwhile(choices: Choices, whole: float) -> Choices:
    """Return the settings that save a share of the cost of the whole against all finer ones."""
    found: dict[str, list[Setting]] = {}
    for key, own in choices.items():
        kept = [own[-1]]
        for one in own[-2::-1]:
            if one.cost < min(other.cost for other in kept) - SAVED * whole or one.error <= min(o.error for o in kept):
                kept.insert(0, one)
        found[key] = kept
    return found


def combinations(choices: Choices, most: int) -> list[Settings]:
    """Return combinations of settings worth a trial, from the finest to the cheapest, without duplicates.

    For every price of error each knob takes the setting with the least cost + price x error: if errors and costs add
    up, these are the corners of the front's convex hull. Between them are combinations in which every knob takes its
    cheapest setting with an error within one tolerance.
    """
    found: list[tuple[Setting, ...]] = []
    for number in range(201):
        price = 10.0 ** (16 - 0.1 * number)
        costs = [[one.cost + price * one.error for one in own] for own in choices.values()]
        cheap = (len(own) - 1 - own[::-1].index(min(own)) for own in costs)  # of equal ones the finest
        found.append(tuple(own[i] for own, i in zip(choices.values(), cheap, strict=True)))
    for number in range(20):
        most_of_one = 10.0 ** (number / 2 - 10)
        within = ([one for one in own if one.error <= most_of_one] for own in choices.values())
        least = (
            own or [min(whole, key=lambda one: one.error)] for own, whole in zip(within, choices.values(), strict=True)
        )
        found.append(tuple(min(own, key=lambda one: one.cost) for own in least))
    every = sorted(dict.fromkeys(found), key=lambda own: sum(one.error for one in own))
    if len(every) > most:
        every = [every[round(i * (len(every) - 1) / max(most - 1, 1))] for i in range(most)]
    return [{one.knob.key: one.value for one in own} for own in every]
