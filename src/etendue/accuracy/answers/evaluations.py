"""Evaluations of one point of a pipeline, each made once, as long as a budget of seconds and the memory last.

In:  a point (`refinement`), seconds that remain.
Out: plans and values; ``TooDear`` before one that would exceed the budget.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from etendue.accuracy.answers.refinement import Factors, Point
from etendue.contract.ports import Progress
from etendue.errors import MachineError
from etendue.plan.model import Plan, StageVariable
from etendue.present.terminal.answer_texts import shortened
from etendue.run.machine import check_machine

if TYPE_CHECKING:
    from etendue.types.arrays import Array

Evaluated = tuple[Plan, dict[StageVariable, "Array"]]
Shown = Callable[[Plan], Progress] | None
PLANNING = 0.02  # seconds of a plan of one point, until one was made


class TooDear(Exception):
    """An evaluation would exceed the budget, or the memory."""

    def __init__(self, seconds: float, why: str = "") -> None:
        self.seconds = seconds
        super().__init__(why or f"costs about {seconds:.2g} s")


class Evaluations:
    """Evaluations of one point.

    Parameters
    ----------
    point : what is evaluated
    rate : measured over predicted seconds
    until : ``time.process_time()`` at which the budget ends
    shown : returns the progress to show of a plan, or None
    """

    def __init__(self, point: Point, rate: float, until: float, shown: Shown = None) -> None:
        self.point, self.rate, self.until, self.shown = point, rate, until, shown
        self.planning = PLANNING
        self._plans: dict[tuple[object, ...], Plan | None] = {}
        self._values: dict[tuple[object, ...], Evaluated] = {}

    @property
    def left(self) -> float:
        return self.until - time.process_time()

    def plan(self, factors: Factors, how: str = "") -> Plan | None:
        """Return the plan of an evaluation; None if the stages refuse it."""
        key = _key(factors, how)
        if key not in self._plans:
            if self.left < self.planning:
                raise TooDear(self.planning)
            began = time.process_time()
            self._plans[key] = self.point.planned(factors, how)
            self.planning = time.process_time() - began
        return self._plans[key]

    def all_of(self, *which: tuple[Factors, str]) -> list[Evaluated] | None:
        """Return some evaluations; None if the stages refuse one.

        Raises
        ------
        TooDear
            Before the first, if they do not fit into what is left.
        """
        seconds, plans = 0.0, []
        for one in which:
            plan = self.plan(*one)
            if plan is None:
                return None
            plans.append(plan)
            if _key(*one) not in self._values:
                seconds += self.rate * self.point.seconds(plan)
                try:
                    check_machine(replace(plan, kept=frozenset(plan.wanted)), None, pictures=False)
                except MachineError as error:
                    raise TooDear(seconds, f"needs more memory: {shortened(str(error))}") from None
        if seconds > self.left:
            raise TooDear(seconds)
        return [self._of(one, plan) for one, plan in zip(which, plans, strict=True)]

    def _of(self, which: tuple[Factors, str], plan: Plan) -> Evaluated:
        key = _key(*which)
        if key not in self._values:
            began = time.process_time()
            progress = self.shown(plan) if self.shown and self.rate * self.point.seconds(plan) > 1 else None
            self._values[key] = plan, self.point.values(plan, progress)
            took = time.process_time() - began
            self.rate = max(self.rate, 0.5 * took / max(self.point.seconds(plan), 1e-9))
        return self._values[key]


def _key(factors: Factors, how: str) -> tuple[object, ...]:
    return (*sorted(factors.items()), how)
