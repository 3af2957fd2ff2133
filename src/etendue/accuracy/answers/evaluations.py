"""Evaluations of one point of a pipeline, each made once, within a budget of seconds and the available memory.

In:  a point (`refinement`), seconds that remain.
Out: plans and values; ``TooDear`` is raised before an evaluation that would exceed the budget.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from etendue.accuracy.answers.refinement import DRAWN, Factors, Point
from etendue.contract.ports import CellReport, Progress
from etendue.errors import MachineError
from etendue.plan.ancestry import ancestry
from etendue.plan.cost import cell_seconds
from etendue.plan.model import CellRef, Plan, StageVariable
from etendue.plan.reports import Reports
from etendue.plan.shown import shown_cells
from etendue.present.terminal.answer_texts import shortened
from etendue.run.machine import check_machine

if TYPE_CHECKING:
    from etendue.session import Outcome
    from etendue.types.arrays import Array

Which = tuple[Factors, str]
Asked = frozenset[StageVariable] | None  # None: all wanted variables
Evaluated = tuple[Plan, dict[StageVariable, "Array"]]
Costs = list[tuple[str, float | None]]  # of cells: stage and predicted seconds; None: left out
Shown = Callable[[Plan], Progress] | None
PLANNED: Which = ({}, "")
PLANNING = 0.01  # assumed seconds of a plan of one point, until one has been timed
ENGINE = 2e-4  # overhead of the engine per cell, seconds
FIXED = 0.015  # seconds; largest excess over the prediction that counts as independent of the size of a cell
ONCE = 1.0  # seconds that imports and tables of one stage may take in a run, at most
LEAST = 0.1  # smallest factor on predictions that is used; a faster cell probably used tables that existed already
EXCESS = 0.2  # fraction of the seconds spent on evaluations by which those compared with them may exceed the budget
CHOSEN = 0.9  # share of the remaining budget for chosen variables; choosing and checking them takes time as well


class TooDear(Exception):
    """An evaluation would exceed the budget, or the memory."""

    def __init__(self, seconds: float, why: str = "") -> None:
        self.seconds = seconds
        super().__init__(why or f"costs about {seconds:.2g} s")


class Rates:
    """Ratio of measured to predicted seconds for the stages of a pipeline, and the overhead of the engine per cell (s).

    A small cell takes longer than predicted because of overhead that does not depend on its size. Therefore an excess
    of up to ``FIXED`` seconds is added to predictions, and a larger excess scales them.

    Parameters
    ----------
    plan, reports : plan and reports of a run. Measured seconds include work that a stage does once per process, such as
        imports and tables. They count only if they are below the prediction, or exceed it by more than ``ONCE``.
    """

    def __init__(self, plan: Plan, reports: Reports | None) -> None:
        self.of: dict[str, tuple[float, float]] = {}  # by stage: fixed seconds, and the factor on predicted seconds
        for ref in shown_cells(plan).values():
            report = None if reports is None else reports.get(ref)
            if report is not None:
                predicted = cell_seconds(plan.node(ref[0]), plan.cells[ref], plan.precision)
                believed = min(report.seconds, max(predicted, report.seconds - ONCE))
                self.learn(plan, replace(report, seconds=believed))

    def learn(self, plan: Plan, report: CellReport) -> None:
        ref = report.stage, report.index
        if report.status == "done" and plan.cells[ref].left_out is None:
            predicted = cell_seconds(plan.node(report.stage), plan.cells[ref], plan.precision)
            fixed = min(max(report.seconds - predicted, 0.0), FIXED)
            self.of[report.stage] = fixed, max((report.seconds - fixed) / predicted, LEAST)

    def seconds(self, costs: Costs) -> float:
        """Return the expected seconds of some cells."""
        total = 0.0
        for stage, predicted in costs:
            fixed, rate = self.of.get(stage, (0.0, 1.0))
            if predicted is not None:
                total += fixed + rate * predicted
            total += ENGINE
        return total


def costs_of(plan: Plan, refs: Iterable[CellRef]) -> Costs:
    """Return the predicted costs of some cells."""
    found: Costs = []
    for ref in refs:
        cell = plan.cells[ref]
        seconds = None if cell.left_out is not None else cell_seconds(plan.node(cell.node), cell, plan.precision)
        found.append((ref[0], seconds))
    return found


class Evaluations:
    """Evaluations of one point.

    Parameters
    ----------
    point : the point to evaluate
    rates : measured seconds of the stages, see `Rates`
    until : ``time.process_time()`` at which the budget ends
    shown : returns the progress to show of a plan, or None
    run : a run whose kept results are not computed again
    """

    def __init__(
        self, point: Point, rates: Rates, until: float, shown: Shown = None, run: Outcome | None = None
    ) -> None:
        self.point, self.rates, self.until, self.shown = point, rates, until, shown
        self.planning = PLANNING
        self._plans: dict[tuple[object, ...], Plan | None] = {}
        self._values: dict[tuple[object, ...], dict[Asked, Evaluated]] = {}
        # By evaluation and asked variables: the costs of its cells; and the evaluations that fit into memory.
        self._costs: dict[tuple[object, ...], Costs] = {}
        self._fit: set[tuple[object, ...]] = set()
        self.draw = point.draw_of_run(run.kept) if run else {}
        self._start = point.computed_before(run.kept) if run else {}
        self._before_noise = {ref: own for ref, own in self._start.items() if ref in point.before_noise}

    @property
    def left(self) -> float:
        return self.until - time.process_time()

    @property
    def planned_seconds(self) -> float:
        """Return the expected seconds to compute the point as planned, without reuse of known results."""
        return self.rates.seconds(self._costs_as_planned)

    @cached_property
    def _costs_as_planned(self) -> Costs:
        base = self.point.base
        return costs_of(base, ancestry(base, set(self.point.refs(base).values())))

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

    def all_of(self, *which: Which, asked: Asked = None) -> list[Evaluated] | None:
        """Return some evaluations, for all wanted variables or for ``asked`` variables; None if the stages refuse one
        of the evaluations.

        Raises
        ------
        TooDear
            Before the first evaluation that exceeds the remaining budget, as estimated at that time. Later evaluations
            may exceed the budget by a fraction of the seconds already spent, which would otherwise be wasted.
        """
        began, plans = time.process_time(), []
        for one in which:
            plan = self.plan(*one)
            if plan is None:
                return None
            plans.append((one, plan))
        found: list[Evaluated] = []
        for number, (one, plan) in enumerate(plans):
            known = self._known(one, asked)
            if known is None:
                self._refuse(plans[number:], asked, EXCESS * (time.process_time() - began) if found else 0.0)
                known = self._evaluated(one, plan, asked)
            found.append(known)
        return found

    def most_of(self, *which: Which) -> list[Evaluated] | None:
        """Return some evaluations of as many variables as fit into the remaining budget; None if not even one fits, or
        if the stages refuse one of the evaluations.
        """
        try:
            some = self.affordable(*which)
            whole = len(some) == len(self.point.wanted)
            return self.all_of(*which, asked=None if whole else some) if some else None
        except TooDear:
            return None

    def affordable(self, *which: Which) -> frozenset[StageVariable]:
        """Return the variables whose evaluations fit into the remaining budget. Variables in the pipeline's ``wanted``
        are chosen first, and cheaper variables before more expensive ones.
        """
        plans = [(one, self.plan(*one)) for one in which]
        made = [(one, plan) for one, plan in plans if plan is not None]
        every: dict[str, list[StageVariable]] = {one[0]: [] for one in self.point.wanted}
        for variable in self.point.wanted:
            every[variable[0]].append(variable)
        chosen: list[StageVariable] = []

        def seconds(own: list[StageVariable]) -> float:
            asked = frozenset(own)
            return sum(self._seconds(one, plan, asked) for one, plan in made if self._known(one, asked) is None)

        for own in sorted(every.values(), key=lambda own: (not self.point.asked.intersection(own), seconds(own))):
            if seconds([*chosen, *own]) <= CHOSEN * self.left:
                chosen += own
        return frozenset(chosen)

    def _known(self, which: Which, asked: Asked) -> Evaluated | None:
        """Return a known evaluation that has at least the asked variables; None if there is none."""
        for own, found in self._values.get(_key(*which), {}).items():
            if own is None or (asked is not None and asked <= own):
                return found
        return None

    def _refuse(self, ahead: list[tuple[Which, Plan]], asked: Asked, excess: float) -> None:
        """Raise ``TooDear`` if an evaluation exceeds the memory, or if all together exceed the remaining budget by more
        than ``excess`` seconds.
        """
        seconds = 0.0
        for one, plan in ahead:
            if self._known(one, asked) is None:
                seconds += self._seconds(one, plan, asked)
                if (*_key(*one), asked) not in self._fit:
                    try:
                        check_machine(replace(plan, kept=frozenset(asked or self.point.wanted)), None, pictures=False)
                    except MachineError as error:
                        raise TooDear(seconds, f"needs more memory: {shortened(str(error))}") from None
                    self._fit.add((*_key(*one), asked))
        if seconds > self.left + excess:
            raise TooDear(seconds)

    def _seconds(self, which: Which, plan: Plan, asked: Collection[StageVariable] | None) -> float:
        key = (*_key(*which), None if asked is None else frozenset(asked))
        if key not in self._costs:
            known: Mapping[CellRef, object] = self._known_arrays(which)
            if which[1] == DRAWN and asked is None:  # by then the noise-free path has been computed
                known = self.point.before_noise
            cells = ancestry(plan, set(self.point.refs(plan, asked).values()), known)
            self._costs[key] = costs_of(plan, cells - known.keys())
        return self.rates.seconds(self._costs[key])

    def _known_arrays(self, which: Which) -> Mapping[CellRef, Mapping[str, Array]]:
        """Return the arrays of an evaluation that are known before it is computed."""
        if which == PLANNED:
            return self._start
        return self._before_noise if which[1] == DRAWN else {}

    def _evaluated(self, which: Which, plan: Plan, asked: Asked) -> Evaluated:
        whole, point = asked is None, self.point
        progress = self.shown(plan) if self.shown and self._seconds(which, plan, asked) > 1 else None
        more: Mapping[CellRef, Collection[str]] = {}
        if which == PLANNED and whole and point.noisy:
            more = {ref: names for ref, names in point.before_noise.items() if ref not in self._start}
        found = point.computed(plan, progress, self._known_arrays(which), more, asked)
        for report in found.reports.values():
            self.rates.learn(plan, report)
        if more:
            self._before_noise |= {ref: found.arrays[ref] for ref in more if ref in found.arrays}
        made = plan, point.values(plan, found)
        self._values.setdefault(_key(*which), {})[asked] = made
        return made


def _key(factors: Factors, how: str) -> tuple[object, ...]:
    return (*sorted(factors.items()), how)
