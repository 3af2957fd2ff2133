"""Evaluations of one point of a pipeline, each made once, as long as a budget of seconds and the memory last.

In:  a point (`refinement`), seconds that remain.
Out: plans and values; ``TooDear`` before one that would exceed the budget.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from etendue.accuracy.answers.refinement import AS_PLANNED, DRAWN, Factors, Point
from etendue.contract.ports import CellReport, Progress
from etendue.errors import MachineError
from etendue.plan.cost import cell_seconds
from etendue.plan.model import CellRef, Plan, StageVariable
from etendue.plan.reports import Reports
from etendue.plan.shown import shown_cells
from etendue.present.terminal.answer_texts import shortened
from etendue.run.machine import check_machine

if TYPE_CHECKING:
    from etendue.types.arrays import Array

Evaluated = tuple[Plan, dict[StageVariable, "Array"]]
Shown = Callable[[Plan], Progress] | None
PLANNING = 0.01  # seconds of a plan of one point, until one was made
ENGINE = 2e-4  # seconds that the engine adds for a cell


class TooDear(Exception):
    """An evaluation would exceed the budget, or the memory."""

    def __init__(self, seconds: float, why: str = "") -> None:
        self.seconds = seconds
        super().__init__(why or f"costs about {seconds:.2g} s")


class Rates:
    """Measured over predicted seconds of the stages of a pipeline, and what the engine adds for every cell.

    Parameters
    ----------
    plan, reports : of a run. Its seconds contain what a stage does only once in a process, imports and tables: they
        count only where they are below those predicted.
    """

    def __init__(self, plan: Plan, reports: Reports | None) -> None:
        self.of: dict[str, float] = {}
        for ref in shown_cells(plan).values():
            report = None if reports is None else reports.get(ref)
            if report is not None:
                predicted = cell_seconds(plan.node(ref[0]), plan.cells[ref], plan.precision)
                self.learn(plan, replace(report, seconds=min(report.seconds, predicted)))

    def learn(self, plan: Plan, report: CellReport) -> None:
        if report.status == "done":
            ref = report.stage, report.index
            predicted = cell_seconds(plan.node(report.stage), plan.cells[ref], plan.precision)
            self.of[report.stage] = report.seconds / predicted

    def seconds(self, plan: Plan, refs: Iterable[CellRef]) -> float:
        """Return the expected seconds of some cells."""
        cells = [plan.cells[ref] for ref in refs]
        return math.fsum(
            ENGINE + self.of.get(cell.node, 1.0) * cell_seconds(plan.node(cell.node), cell, plan.precision)
            for cell in cells
        )


class Evaluations:
    """Evaluations of one point.

    Parameters
    ----------
    point : what is evaluated
    rates : of its stages
    until : ``time.process_time()`` at which the budget ends
    shown : returns the progress to show of a plan, or None
    """

    def __init__(self, point: Point, rates: Rates, until: float, shown: Shown = None) -> None:
        self.point, self.rates, self.until, self.shown = point, rates, until, shown
        self.planning = PLANNING
        self._plans: dict[tuple[object, ...], Plan | None] = {}
        self._values: dict[tuple[object, ...], Evaluated] = {}
        self._before_noise: Mapping[CellRef, Mapping[str, Array]] = {}

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
            Before the first that does not fit into what is left, as far as the seconds are known by then.
        """
        plans = []
        for one in which:
            plan = self.plan(*one)
            if plan is None:
                return None
            plans.append(plan)
        found: list[Evaluated] = []
        for number, (one, plan) in enumerate(zip(which, plans, strict=True)):
            if _key(*one) not in self._values:
                self._refuse(list(zip(which[number:], plans[number:], strict=True)))
            found.append(self._of(one, plan))
        return found

    def _refuse(self, ahead: list[tuple[tuple[Factors, str], Plan]]) -> None:
        """Raise ``TooDear`` if evaluations exceed the memory, or together what is left of the budget."""
        seconds = 0.0
        for one, plan in ahead:
            if _key(*one) not in self._values:
                seconds += self._seconds(plan, one[1])
                try:
                    check_machine(replace(plan, kept=frozenset(self.point.wanted)), None, pictures=False)
                except MachineError as error:
                    raise TooDear(seconds, f"needs more memory: {shortened(str(error))}") from None
        if seconds > self.left:
            raise TooDear(seconds)

    def _seconds(self, plan: Plan, how: str) -> float:
        known = self.point.before_noise.keys() if how == DRAWN else ()
        return self.rates.seconds(plan, self.point.needed(plan, known))

    def _of(self, which: tuple[Factors, str], plan: Plan) -> Evaluated:
        key, how = _key(*which), which[1]
        if key not in self._values:
            progress = self.shown(plan) if self.shown and self._seconds(plan, how) > 1 else None
            known = self._before_noise if how == DRAWN else {}
            more = self.point.before_noise if how == AS_PLANNED else {}
            found = self.point.computed(plan, progress, known, more)
            for report in found.reports.values():
                self.rates.learn(plan, report)
            if how == AS_PLANNED:
                self._before_noise = {ref: found.arrays[ref] for ref in more if ref in found.arrays}
            self._values[key] = plan, self.point.values(plan, found)
        return self._values[key]


def _key(factors: Factors, how: str) -> tuple[object, ...]:
    return (*sorted(factors.items()), how)
