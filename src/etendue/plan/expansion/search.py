"""Search the settings of knobs that meet a goal at the lowest cost.

In:  knobs with their settings from the cheapest to the finest, and a function that evaluates a combination of settings.
Out: trials, each combination evaluated once, within a budget; the front of error and cost.

One search serves three evaluations of a combination: a plan uses the bounds that a stage states (`approximate`),
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
Name = tuple[tuple[str, Value], ...]  # identifies a trial: the settings that differ from the start
# Predicted error and cost of a combination; infinite if it must not be tried.
Predicted = Callable[[Settings], tuple[float, float]]
MANY = 300  # if there are more combinations than this, only neighbours are considered
DOUBT = 1.1  # factor by which a predicted cost may be too high
SAVED = 0.01  # fraction of the total cost; settings that save less are not combined
_Point = TypeVar("_Point")


@dataclass(frozen=True)
class Knob:
    """A knob and its settings. A knob without a stage belongs to the whole pipeline, such as its precision."""

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
    """One setting of a knob, with the error that it causes alone, and its cost."""

    knob: Knob
    value: Value
    error: float  # a bound or a measured value, in the units of the goal
    cost: float  # in any unit that adds up over knobs


@dataclass(frozen=True)
class Goal:
    """The largest allowed error: relative to full scale, or in ``units``."""

    most: float
    units: str = "1"

    def met(self, error: float | None) -> bool:
        return error is not None and error <= self.most


@dataclass(frozen=True)
class Trial:
    """A combination of settings and its error. Knobs that are not named have their settings at the start of the
    search.
    """

    settings: Settings
    error: float | None  # None if it is unknown or the combination is refused

    @property
    def cost(self) -> float:
        return 0.0


@dataclass(frozen=True)
class Means:
    """A cost or a budget: seconds of CPU time in total, bytes of memory at once."""

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
    budget : limits of the search; an evaluation that can estimate its cost calls ``afford`` before it starts

    Attributes
    ----------
    tried : every trial, in the order of evaluation
    most : largest number of trials
    lacking : cost of the first evaluation that exceeded the budget; None if no evaluation exceeded it
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
        """Return the settings that differ from the start of the search; they identify a trial."""
        return tuple(sorted((key, value) for key, value in settings.items() if value != self.start.get(key)))

    def afford(self, need: Means, spent: float) -> None:
        """Raise ``OverBudget`` if ``need``, after ``spent`` seconds, exceeds the budget."""
        if spent + need.seconds > self.budget.seconds or need.bytes > self.budget.bytes:
            self.lacking = need
            raise OverBudget

    def loosened(
        self, knobs: Iterable[Knob], goal: Goal, start: Mapping[str, Value] = {}
    ) -> tuple[_Tried, list[Setting]]:
        """Set one knob after the other to its cheapest setting that meets the goal. A knob whose finest setting does
        not meet it is left unchanged.

        The setting is found by bisection, which requires that errors never grow towards finer settings. Each setting is
        returned with its error minus the error of the finest setting.
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
        """Return the cheapest setting that meets a goal, found step by step: coarser as long as the goal is met,
        otherwise finer until it is met. Return None if the settings or the budget end before that, or if a trial is
        ``hopeless``.
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
        """Try at most ``most`` combinations. If there are only so many, try all. Otherwise try, for each goal in turn,
        the combination that is predicted to meet it at the lowest cost, until no predicted cost is below the cost of
        the cheapest trial that meets the goal. The remaining trials go to combinations that differ from that trial in
        one setting and cost hardly more, because predictions may be wrong.

        The first half of the trials are combinations that minimise cost + price x error for some price.
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
        """Return the untried combination that is predicted to meet a goal at the lowest cost; None if none is predicted
        to cost less than ``doubt`` times the cheapest trial that meets the goal.

        If there are many combinations, only neighbours of that trial are considered or, without such a trial, of the
        trial with the smallest error. Neighbours differ in the settings of up to ``at_once`` knobs.
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
    """Return every way to move ``count`` knobs, each by one of its moves."""
    return itertools.chain(*(itertools.product(*some) for some in itertools.combinations(moves, count)))


def error_and_cost(trial: Trial) -> tuple[float, float]:
    return (math.inf if trial.error is None else trial.error), trial.cost


def front(points: Iterable[_Point], of: Callable[[_Point], tuple[float, float]], worth: float = 1.0) -> list[_Point]:
    """Return the Pareto front of (error, cost), the cheapest point first. Each point has less than ``worth`` times the
    error of the previous point.
    """
    chosen: list[_Point] = []
    for point in sorted(points, key=lambda p: (of(p)[1], of(p)[0])):
        if not chosen or of(point)[0] < worth * of(chosen[-1])[0]:
            chosen.append(point)
    return chosen


def cheapest(points: Iterable[_Point], of: Callable[[_Point], tuple[float, float]], most: float) -> _Point | None:
    """Return the cheapest point with an error of at most ``most``; None if there is none."""
    within = [point for point in points if of(point)[0] <= most]
    return min(within, key=lambda point: (of(point)[1], of(point)[0]), default=None)


def worthwhile(choices: Choices, whole: float) -> Choices:
    """Return the settings that are cheaper than all finer settings by at least a fraction `SAVED` of the total cost."""
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

    For each price, every knob takes the setting with the smallest cost + price x error. If errors and costs add, these
    combinations are the corners of the convex hull of the front. Combinations between the corners are added, in which
    every knob takes its cheapest setting with an error within one tolerance.
    """
    found: list[tuple[Setting, ...]] = []
    for number in range(201):
        price = 10.0 ** (16 - 0.1 * number)
        costs = [[one.cost + price * one.error for one in own] for own in choices.values()]
        cheap = (len(own) - 1 - own[::-1].index(min(own)) for own in costs)  # among equal ones, take the finest
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
