"""Limits that are checked before the goals are computed: from bounds that stages declare, or because their metrics take
little time.

In:  the plan of a trial, the limits.
Out: limits that cannot be met; limits whose metrics take at most half of the total time.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from etendue.contract.capabilities import is_random, rounds
from etendue.plan.ancestry import ancestry
from etendue.plan.cost import cell_seconds
from etendue.plan.model import CellRef, Plan
from etendue_lab.search.asked import Limit

CHEAP = 0.5  # largest share of the total time that limits computed before the goals may take


@dataclass(frozen=True)
class First:
    """The limits that a search checks before the goals. ``bounded``: whether stages declare bounds for a limit."""

    bounded: bool
    cheap: tuple[Limit, ...]


def bounded(plan: Plan, limits: Iterable[Limit]) -> dict[Limit, float]:
    """Return the smallest possible amount by which each limit is exceeded, relative to the number in the limit; 0 or
    less if the limit may be met. Limits on variables without known bounds are omitted.

    The bounds of a variable are its smallest and largest value without noise; a stage may state them for its first
    variable. They are used if no stage on which the variable depends draws random numbers or rounds. The bounds are
    widened by a margin: the tolerance times the largest bound, for each cell that the variable depends on.
    """
    found = {}
    for limit in limits:
        ends = _ends(plan, limit)
        if ends is not None:
            low, high, margin = ends
            found[limit] = limit.excess(low - margin if limit.most else high + margin)
    return found


def _ends(plan: Plan, limit: Limit) -> tuple[float, float, float] | None:
    """Return the smallest and largest value that the variable of a limit can have, and the margin of both; None if
    unknown.
    """
    for stage, variable in plan.wanted:
        if limit.metric.name not in (variable, f"{stage}.{variable}"):
            continue
        cells = plan.of(stage)
        every = [plan.cells[ref] for ref in ancestry(plan, {cell.ref for cell in cells}, set())]
        uncertain = any(is_random(type(cell.stage)) or rounds(type(cell.stage)) for cell in every)
        facts = [cell.facts for cell in cells]
        if uncertain or variable != next(iter(plan.node(stage).writes)):
            return None
        lows, highs = [own.low for own in facts if own.low is not None], [o.high for o in facts if o.high is not None]
        if not len(lows) == len(highs) == len(facts):
            return None
        return min(lows), max(highs), len(every) * plan.pipeline.tolerance * max(map(abs, (*lows, *highs)))
    return None


def cheap(plan: Plan, limits: Iterable[Limit]) -> tuple[Limit, ...]:
    """Return the limits whose metrics together take at most half of the time of all wanted variables."""
    own = {limit: {cell.ref for stage in _stages(plan, limit) for cell in plan.of(stage)} for limit in limits}
    whole = _seconds(plan, {cell.ref for stage, _ in plan.wanted for cell in plan.of(stage)})
    chosen: list[Limit] = []
    for limit in sorted(own, key=lambda one: _seconds(plan, own[one])):
        refs = set[CellRef]().union(*(own[one] for one in (*chosen, limit)))
        if _seconds(plan, refs) <= CHEAP * whole:
            chosen.append(limit)
    return tuple(chosen)


def _stages(plan: Plan, limit: Limit) -> list[str]:
    return [stage for stage, name in plan.wanted if limit.metric.name in (name, f"{stage}.{name}")]


def _seconds(plan: Plan, refs: set[CellRef]) -> float:
    return sum(
        cell_seconds(plan.node(cell.node), cell, plan.precision)
        for cell in (plan.cells[ref] for ref in ancestry(plan, refs, set()))
    )
