"""Measure the error of the answer after a run, by a few evaluations of one point within a budget of seconds.

In:  the plan and the reports of a run.
Out: an ``AnswerError`` for every wanted variable.

A discretisation is refined by a factor of two while all others are coarse. The change hardly depends on the others, and
the evaluation costs a fraction of the seconds of the point itself.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from etendue.accuracy.answers.error import (
    OMISSIONS,
    AnswerError,
    AnswerErrors,
    Part,
    is_number,
    part_between,
    scaled,
    worst,
)
from etendue.accuracy.answers.evaluations import PLANNED, Evaluated, Evaluations, Rates, Shown, TooDear, Which
from etendue.accuracy.answers.refinement import DRAWN, EXACT, NEARER, NOTHING, Factors, Point
from etendue.accuracy.answers.regridding import on_grid
from etendue.accuracy.pilot import chosen_places
from etendue.contract.registry import Registry
from etendue.plan.model import Plan, StageVariable
from etendue.plan.reports import Reports
from etendue.plan.shown import answers, shown_place

if TYPE_CHECKING:
    from etendue.types.arrays import Array

# With first-order convergence, the error that remains after a refinement by two equals its change, so the total is
# twice the change. For a margin, less remains.
FIRST_ORDER = 2.0
SAFETY: Mapping[str, float] = {"spacing": FIRST_ORDER, "bins": FIRST_ORDER, "margin": 1.5}
COARSENED = 1.5  # factor on the change in cheaper ways, where 1 is expected
THRIFT = 8.0  # total cost of the most expensive ways, in units of the cost of the point as planned
ELSEWHERE = 2.0  # factor for points of a sweep that were not measured
PLACES = 4  # points of a sweep that are measured, as far as the budget allows
DRAWS = 4  # number of draws of the noise
INTERVAL = 3.182  # Student's t for 95 % and three degrees of freedom
FEW_BANDS, COARSE = {"bins": -8}, {"spacing": -2}

Parts = dict[StageVariable, dict[str, Part]]
# By discretisation and name of the variable; a text is the reason why the part is unknown.
KnownParts = Mapping[str, Mapping[str, Part | str]]
Texts = dict[StageVariable, dict[str, str]]


class Way(NamedTuple):
    """Evaluations whose difference, multiplied by ``factor``, is an error."""

    which: tuple[Which, ...]
    factor: float = 1.0


class Compared(NamedTuple):
    """The evaluations of a `Way`, and its factor."""

    made: list[Evaluated]
    factor: float


def state_errors(
    plan: Plan,
    registry: Registry,
    reports: Reports | None,
    budget: float,
    shown: Shown = None,
    places: int = PLACES,
    known: KnownParts = NOTHING,
) -> AnswerErrors:
    """Return the error of every wanted variable and headline metric.

    Parameters
    ----------
    plan, reports : of the run; without reports, the predicted seconds of plans are used budget : seconds at most shown
    : returns the progress to show of a plan places : largest number of points of a sweep known : parts that need not be
    measured: the largest over these points
    """
    began, at, wanted = time.process_time(), shown_place(plan), answers(plan)
    rates, dear, longest = Rates(plan, reports), 0.0, 0.0
    found: list[dict[str, AnswerError]] = []
    for place in (at, *(place for place in chosen_places(plan.axes, places) if place != at)):
        since = time.process_time()
        if found and (dear or began + budget - since < longest):
            break
        evaluations = Evaluations(Point(plan, registry, place, wanted), rates, began + budget, shown)
        own, dear = _at_point(plan, evaluations, known)
        found.append(own)
        longest = max(longest, time.process_time() - since)
    errors = {name: worst(one[name] for one in found) for name in found[0]}
    if len(found) < math.prod(len(axis.values) for axis in plan.axes):
        errors = scaled(errors, ELSEWHERE)
    refused = {name for one in errors.values() for name in one.fixed}
    finer = Point(plan, registry, at, wanted).remedies()
    remedies = {name: text for name, text in finer.items() if name not in refused}
    return AnswerErrors(errors, found[0], at, len(found), time.process_time() - began, dear, budget, remedies=remedies)


def _at_point(plan: Plan, evaluations: Evaluations, known: KnownParts) -> tuple[dict[str, AnswerError], float]:
    """Return the errors at one point, and the predicted seconds of evaluations that exceeded the budget."""
    point = evaluations.point
    parts: Parts = {one: {} for one in point.wanted}
    missing: Texts = {one: {} for one in point.wanted}
    fixed = dict(point.fixed())
    evaluations.scarce = evaluations.left < THRIFT * evaluations.planned_seconds
    dear = _refine_all(plan, evaluations, parts, missing, fixed, known)
    pair, seconds = _attempt(evaluations, missing, OMISSIONS, point.wanted, _omitted(evaluations))
    if pair is None:
        refused = f"the reference is refused{f' ({point.refusal})' if point.refusal else ''}"
        missing = {one: {**own, OMISSIONS: refused} for one, own in missing.items()}
    elif pair.made:
        compare(parts, missing, [pair.made[0], pair.made[-1]], OMISSIONS, point.wanted, pair.factor)
    noise, more = _noise(evaluations, parts, missing)
    names = [name for _, name in point.wanted]
    errors = {}
    for stage, name in point.wanted:
        declared = plan.node(stage).writes[name]
        unit = declared.unit if is_number(declared) else ""
        own = AnswerError(
            stage, name, unit, parts[stage, name], fixed, missing[stage, name], noise=noise.get((stage, name))
        )
        errors[name if names.count(name) == 1 else f"{stage}.{name}"] = own
    return errors, dear + seconds + more


def _attempt(
    evaluations: Evaluations, missing: Texts, name: str, wanted: Iterable[StageVariable], ways: list[Way]
) -> tuple[Compared | None, float]:
    """Return the evaluations of the first way that fits into the budget, and 0. If the budget is small for this
    pipeline, start with the last way, which is the cheapest. If no way fits, return the evaluations of as many
    variables as possible (wanted and cheap ones first) and the seconds that all would take, and record the others in
    ``missing``.

    The result is None if the stages refuse every way, and contains no evaluations if none fits.
    """
    dear: list[tuple[Way, TooDear]] = []
    for way in ways[::-1] if evaluations.scarce else ways:
        try:
            found = evaluations.all_of(*way.which)
        except TooDear as error:
            dear.append((way, error))
            if evaluations.scarce:
                break  # the other ways cost more, and planning them takes time too
        else:
            if found is not None:
                return Compared(found, way.factor), 0.0
    if not dear:
        return None, 0.0
    way, least = min(dear, key=lambda one: one[1].seconds)
    made, some = list[Evaluated](), frozenset[StageVariable]()
    try:
        some = evaluations.affordable(*way.which)
        made = (evaluations.all_of(*way.which, asked=some) or []) if some else []
    except TooDear:
        some = frozenset()
    for one in wanted:
        if one not in some:
            missing[one][name] = str(least)
    return Compared(made, way.factor), least.seconds


def _refine_all(
    plan: Plan, evaluations: Evaluations, parts: Parts, missing: Texts, fixed: dict[str, str], known: KnownParts
) -> float:
    """Add the change by one refinement of each discretisation to ``parts``; return the predicted seconds of evaluations
    that exceeded the budget.
    """
    point, dear = evaluations.point, 0.0
    order = [*SAFETY, *point.names()]
    for name in sorted(point.names(), key=order.index):
        affected = point.affected(plan, name)
        for one in point.wanted:
            if one not in affected:
                parts[one][name] = Part(0.0, 0.0, "not affected")
        rest = [one for one in affected if not _take(parts, missing, one, name, known)]
        if not rest:
            continue
        pair: Compared | None = None
        seconds = 0.0
        for base in _bases(name) if _accepted(evaluations, name) else ():
            if pair is None:
                pair, seconds = _attempt(evaluations, missing, name, rest, _refined(name, base))
        dear += seconds
        if pair is None:
            fixed[name] = f"the stages accept no finer one{f' ({point.refusal})' if point.refusal else ''}"
        elif pair.made:
            compare(parts, missing, pair.made, name, rest, pair.factor)
    return dear


def _accepted(evaluations: Evaluations, name: str) -> bool:
    """Return whether the stages accept a finer discretisation with everything else as planned. This takes one plan;
    without it, a refusal would be found only after six plans. Return True if no time is left for the plan.
    """
    try:
        return evaluations.plan({name: 2}) is not None
    except TooDear:
        return True


def _take(parts: Parts, missing: Texts, one: StageVariable, name: str, known: KnownParts) -> bool:
    """Add the known part of a discretisation for a variable; return whether there is one."""
    stage, variable = one
    own = known.get(name, {})
    found = own.get(variable, own.get(f"{stage}.{variable}"))
    if isinstance(found, str):
        missing[one][name] = found
    elif found is not None:
        parts[one][name] = found
    return found is not None


def refined_pair(evaluations: Evaluations, name: str) -> list[Evaluated] | None:
    """Return two evaluations of all variables that differ by one refinement."""
    for base in _bases(name):
        if pair := evaluations.all_of((base, ""), ({**base, name: 2}, "")):
            return pair
    return None


def _bases(name: str) -> tuple[Factors, Factors]:
    """Return the factors of the other discretisations while one is refined: first coarse ones, then, if the stages
    refuse these, as planned.
    """
    return (COARSE if name == "bins" else FEW_BANDS), {}


def _refined(name: str, base: Factors) -> list[Way]:
    """Return the evaluations from which the error of a discretisation follows; ``base``: factors of the others.

    The first way is one refinement. A cheaper one is one coarsening: for convergence of first or higher order, the
    error is at most the change that it causes. A margin can also be widened on a coarser grid.
    """
    ways = [Way(((base, ""), ({**base, name: 2}, "")), SAFETY.get(name, FIRST_ORDER))]
    if name in ("spacing", "bins"):
        ways.append(Way((({**base, name: -2}, ""), (base, "")), COARSENED))
    if name == "margin" and base:
        coarse = {**base, **COARSE}
        ways.append(Way(((coarse, ""), ({**coarse, name: 2}, "")), FIRST_ORDER))
    return ways


def _omitted(evaluations: Evaluations) -> list[Way]:
    """Return the evaluations from which the error of omissions and coarser settings follows. One evaluation is as
    planned; the other is of the reference or of settings one step towards it, both perhaps with few bands. If plan and
    reference have the same cells, only the first is returned.
    """
    own = evaluations.point.base
    try:
        exact = evaluations.plan({}, EXACT)
    except TooDear:
        exact = None
    if exact and own.precision == exact.precision and _same(own, exact):
        return [Way((PLANNED,))]
    return [
        Way((PLANNED, ({}, EXACT))),
        Way((PLANNED, ({}, NEARER)), FIRST_ORDER),
        Way(((FEW_BANDS, ""), (FEW_BANDS, EXACT)), COARSENED),
        Way(((FEW_BANDS, ""), (FEW_BANDS, NEARER)), COARSENED * FIRST_ORDER),
    ]


def _same(own: Plan, exact: Plan) -> bool:
    """Return whether all cells are computed alike in two plans of a point."""
    return all(cell.left_out is None and cell.stage == exact.cells[ref].stage for ref, cell in own.cells.items())


def _noise(evaluations: Evaluations, parts: Parts, missing: Texts) -> tuple[dict[StageVariable, float], float]:
    """Return the half width of the 95 % interval about one draw of the noise, for numbers that depend on noise; and the
    predicted seconds of evaluations that exceeded the budget.

    Some numbers, such as the noise itself, are shifted by noise far more than they scatter. The errors of the
    noise-free path do not apply to them, so these errors count as not measured.
    """
    noisy = evaluations.point.noisy
    if not noisy:
        return {}, 0.0
    draws: list[Which] = [({"draw": n}, DRAWN) for n in range(DRAWS)]
    every, seconds = _attempt(evaluations, missing, "noise", noisy, [Way((PLANNED, *draws))])
    made = every.made if every else []
    found = {}
    for one in noisy if made else ():
        values = [float(np.ravel(own[one])[-1]) for _, own in made if one in own]
        if len(values) == DRAWS + 1 and all(map(math.isfinite, values)):
            mean, spread = math.fsum(values[1:]) / DRAWS, float(np.std(values[1:], ddof=1))
            found[one] = INTERVAL * spread
            if abs(values[0] - mean) > 3 * INTERVAL * spread / math.sqrt(DRAWS) + 0.3 * abs(mean):
                parts[one].clear()
                missing[one]["noise-free path"] = "noise changes this metric: it has no noise-free value"
    return found, seconds


def compare(
    parts: Parts,
    missing: Texts,
    pair: list[Evaluated],
    name: str,
    wanted: Iterable[StageVariable],
    factor: float | None = None,
) -> None:
    """Add the difference between two evaluations of some variables, multiplied by ``factor`` (None: the factor of one
    refinement), to ``parts``.
    """
    (plan, values), (other, reference) = pair
    for stage, variable in wanted:
        one = stage, variable
        if name in missing[one]:
            continue
        if one not in values or one not in reference:
            missing[one][name] = f"{stage} fails without noise, or when refined"
            continue
        cell = other.of(stage)[0]
        declared, grid = other.node(stage).writes[variable], plan.of(stage)[0].grids[variable]
        finer: Array | None = reference[one]
        if grid != cell.grids[variable]:
            finer = on_grid(reference[one], declared.dims, cell.grids[variable], grid)
        if finer is None:
            missing[one][name] = "the variable is on the grid that is refined"
            continue
        found = part_between(values[one], finer, declared, cell.stage)
        if isinstance(found, str):
            missing[one][name] = found
        else:
            parts[one][name] = found * (SAFETY.get(name, FIRST_ORDER) if factor is None else factor)
