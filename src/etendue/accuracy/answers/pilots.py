"""Measure the error of the answer after a run: a few evaluations of one point, within a budget of seconds.

In:  the plan and the reports of a run.
Out: an ``AnswerError`` for every wanted variable.

A discretisation is refined by two where everything else is coarse: what it changes hardly depends on the others, and
this costs a fraction of the point itself.
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
from etendue.run.memory import SELDOM_COLLECTING

if TYPE_CHECKING:
    from etendue.types.arrays import Array

# A refinement by two of first order leaves as much again as it changes. A margin twice as large leaves little.
FIRST_ORDER = 2.0
SAFETY: Mapping[str, float] = {"spacing": FIRST_ORDER, "bins": FIRST_ORDER, "margin": 1.5}
COARSENED = 1.5  # of the ways that cost less, where 1 is expected
THRIFT = 8.0  # what the dearest ways cost together, times the seconds of the point as planned
CHEAP = 4.0  # budget, times the seconds of the point as planned, at which that point serves for the bins too
ELSEWHERE = 2.0  # factor for points of a sweep that were not measured
PLACES = 4  # points of a sweep that are measured, as far as the budget allows
DRAWS = 4  # of the noise
INTERVAL = 3.182  # Student's t for 95 % and three degrees of freedom
FEW_BANDS, COARSE = {"bins": -8}, {"spacing": -2}

Parts = dict[StageVariable, dict[str, Part]]
KnownParts = Mapping[str, Mapping[str, Part | str]]  # by discretisation and name of the variable; texts: why unknown
Texts = dict[StageVariable, dict[str, str]]


class Way(NamedTuple):
    """Evaluations that tell an error, and the factor from what they differ by to that error."""

    which: tuple[Which, ...]
    factor: float = 1.0


class Compared(NamedTuple):
    """The evaluations of a way."""

    made: list[Evaluated]
    factor: float


@SELDOM_COLLECTING
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
    plan, reports : of the run; without reports, seconds are those that plans predict
    budget : seconds at most
    shown : returns the progress to show of a plan
    places : largest number of points of a sweep
    known : parts that need not be measured, of the worst of these points
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
    """Return the errors at one point, and the seconds of what was too costly."""
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
    """Return the evaluations of the first way that fits into the budget, or of the last one if the budget is small for
    this pipeline; if none fits, those of as many variables as do, wanted and cheap ones first. Note what is missing;
    return also the seconds of all, if those are too many.

    None: the stages refuse every way. No evaluations: nothing fits.
    """
    dear: list[tuple[Way, TooDear]] = []
    for way in ways[::-1] if evaluations.scarce else ways:
        try:
            found = evaluations.all_of(*way.which)
        except TooDear as error:
            dear.append((way, error))
            if evaluations.scarce:
                break  # the others cost more, and so does planning them
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
    """Add what one refinement of each discretisation changes; return the seconds of what was too costly."""
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
        for ways in _ways(evaluations, name) if _accepted(evaluations, name) else ():
            if pair is None:
                pair, seconds = _attempt(evaluations, missing, name, rest, ways)
        dear += seconds
        if pair is None:
            fixed[name] = f"the stages accept no finer one{f' ({point.refusal})' if point.refusal else ''}"
        elif pair.made:
            compare(parts, missing, pair.made, name, rest, pair.factor)
    return dear


def _accepted(evaluations: Evaluations, name: str) -> bool:
    """Return whether the stages accept a finer discretisation, all else as planned: one plan instead of six that are
    refused. True where no time is left to ask, or where it is short and no file limits the stages.
    """
    if evaluations.scarce and not evaluations.point.reads_files(name):
        return True
    try:
        return evaluations.plan({name: 2}) is not None
    except TooDear:
        return True


def _take(parts: Parts, missing: Texts, one: StageVariable, name: str, known: KnownParts) -> bool:
    """Add what is known of a discretisation for a variable; return whether anything is."""
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
    """Return the other discretisations of the evaluations that refine one: coarse if the stages accept that."""
    return (COARSE if name == "bins" else FEW_BANDS), {}


def _ways(evaluations: Evaluations, name: str) -> list[list[Way]]:
    """Return the evaluations that tell the error of a discretisation, for one choice of the other ones after another."""
    ways = [_refined(name, base) for base in _bases(name)]
    if name == "bins" and evaluations.scarce and evaluations.left > CHEAP * evaluations.planned_seconds:
        # The tables of the point as planned exist, and the noise is drawn from it: half the cost of a coarse grid.
        ways[0].append(Way((({name: -2}, ""), PLANNED), COARSENED))
    return ways


def _refined(name: str, base: Factors) -> list[Way]:
    """Return the evaluations that tell the error of a discretisation; ``base``: the other ones.

    One refinement, or, for less time, one coarsening: for the first order or a higher one, the error is at most what
    that changes. A margin is widened on a coarser grid.
    """
    ways = [Way(((base, ""), ({**base, name: 2}, "")), SAFETY.get(name, FIRST_ORDER))]
    if name in ("spacing", "bins"):
        ways.append(Way((({**base, name: -2}, ""), (base, "")), COARSENED))
    if name == "margin" and base:
        coarse = {**base, **COARSE}
        ways.append(Way(((coarse, ""), ({**coarse, name: 2}, "")), FIRST_ORDER))
    return ways


def _omitted(evaluations: Evaluations) -> list[Way]:
    """Return the evaluations that tell the error of what is left out or coarser: as planned and of the reference, or of
    settings one step towards it, or both with few bands. The first alone if all have the same cells.
    """
    base, how = (FEW_BANDS, NEARER) if evaluations.scarce else ({}, EXACT)
    try:
        own, exact = evaluations.plan(base), evaluations.plan(base, how)
    except TooDear:
        own = exact = None
    if own and exact and own.precision == exact.precision and _same(own, exact):
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
    """Return the 95 % interval about one draw of the noise, half its width, of the numbers that depend on noise; and
    the seconds of what was too costly.

    The error of a number that noise moves far more than it scatters, such as the noise itself, is not that of the
    noise-free path: it counts as not measured.
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
    """Add what two evaluations of some variables differ by, times ``factor``; None: that of one refinement."""
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
