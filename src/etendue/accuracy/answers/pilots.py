"""Measure the error of the answer after a run, by a few evaluations of one point within a budget of seconds.

In:  the plan and the reports of a run.
Out: an ``AnswerError`` for every wanted variable.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np

from etendue.accuracy.answers.comparing import KnownParts, Parts, Texts, Way, attempt
from etendue.accuracy.answers.error import AnswerError, AnswerErrors, is_number, scaled, worst
from etendue.accuracy.answers.evaluations import PLANNED, PLANNING, Evaluations, Rates, Shown, Which
from etendue.accuracy.answers.one_at_a_time import measure_each, measure_omissions
from etendue.accuracy.answers.refinement import DRAWN, NOTHING, Point
from etendue.accuracy.answers.together import Together
from etendue.accuracy.pilot import chosen_places
from etendue.contract.registry import Registry
from etendue.plan.model import Plan, StageVariable
from etendue.plan.shown import answers, shown_place
from etendue.run.memory import SELDOM_COLLECTING
from etendue.session import Outcome

THRIFT = 20.0  # largest cost of measuring one part after the other, in units of the cost of the point as planned
ELSEWHERE = 2.0  # factor for points of a sweep that were not measured
PLACES = 4  # points of a sweep that are measured, as far as the budget allows
UNSEEN = 1e-7  # of full scale; a picture with a smaller error is black, saturated or uniform there
DRAWS = 4  # number of draws of the noise, including the draw of the run
INTERVAL = 3.182  # Student's t for 95 % and three degrees of freedom


@SELDOM_COLLECTING
def state_errors(
    plan: Plan,
    registry: Registry,
    run: Outcome | None,
    budget: float,
    shown: Shown = None,
    places: int = PLACES,
    known: KnownParts = NOTHING,
) -> AnswerErrors:
    """Return the error of every wanted variable and headline metric.

    Parameters
    ----------
    plan, run : the plan and its run, whose seconds and results are used; None: predicted seconds
    budget : maximum number of seconds
    shown : returns the progress to show of a plan
    places : largest number of points of a sweep
    known : parts of the errors that are known and need not be measured, as the largest value over the points
    """
    began, at, wanted = time.process_time(), shown_place(plan), answers(plan)
    rates, dear, longest = Rates(plan, run.reports if run else None), 0.0, 0.0
    found: list[dict[str, AnswerError]] = []
    for place in (at, *(place for place in chosen_places(plan.axes, places) if place != at)):
        since = time.process_time()
        if found and (dear or began + budget - since < longest):
            break
        evaluations = Evaluations(Point(plan, registry, place, wanted), rates, began + budget, shown, run)
        own, dear = _at_point(plan, evaluations, known)
        found.append(own)
        longest = max(longest, time.process_time() - since)
    errors = {name: worst(one[name] for one in found) for name in found[0]}
    if len(found) < math.prod(len(axis.values) for axis in plan.axes):
        errors = _elsewhere(scaled(errors, ELSEWHERE), evaluations.point, plan)
    refused = {name for one in errors.values() for name in one.fixed}
    finer = Point(plan, registry, at, wanted).remedies()
    remedies = {name: text for name, text in finer.items() if name not in refused}
    return AnswerErrors(errors, found[0], at, len(found), time.process_time() - began, dear, budget, remedies=remedies)


def _elsewhere(errors: dict[str, AnswerError], point: Point, plan: Plan) -> dict[str, AnswerError]:
    """Return the errors over a sweep of which only some points were measured. If a variable has no error there, such as
    a saturated picture, its error at the other points is recorded as unknown, except for codes and counts, which often
    stay the same.
    """
    affected = {one for name in point.names() for one in point.affected(plan, name)}
    found = dict(errors)
    for name, one in errors.items():
        declared = plan.node(one.stage).writes[one.variable]
        varies = (one.stage, one.variable) in affected and (declared.dtype == "float" or "y" in declared.dims)
        if varies and one.parts and not one.open and one.rms <= (0.0 if one.unit else UNSEEN):
            where = "the measured point" if one.points == 1 else f"the {one.points} measured points"
            found[name] = replace(one, open={"other points": f"at {where} no refinement changes it"})
    return found


def _at_point(plan: Plan, evaluations: Evaluations, known: KnownParts) -> tuple[dict[str, AnswerError], float]:
    """Return the errors at one point, and the predicted seconds of evaluations that exceeded the budget."""
    point = evaluations.point
    parts: Parts = {one: {} for one in point.wanted}
    missing: Texts = {one: {} for one in point.wanted}
    fixed = dict(point.fixed())
    scarce = not known and evaluations.left < THRIFT * (evaluations.planned_seconds + PLANNING)
    together = Together(plan, evaluations, parts, missing, fixed) if scarce else None
    if together:
        together.measure()
        dear = together.dear + measure_each(plan, evaluations, together.apart, parts, missing, fixed, known)
    else:
        dear = measure_each(plan, evaluations, point.names(), parts, missing, fixed, known)
        dear += measure_omissions(evaluations, parts, missing)
    if together:
        together.split(once=True)
    noise, more = _noise(evaluations, parts, missing)
    if together:
        together.split()
        together.refine()
    names = [name for _, name in point.wanted]
    errors = {}
    for stage, name in point.wanted:
        declared = plan.node(stage).writes[name]
        unit = declared.unit if is_number(declared) else ""
        own = AnswerError(
            stage, name, unit, parts[stage, name], fixed, missing[stage, name], noise=noise.get((stage, name))
        )
        errors[name if names.count(name) == 1 else f"{stage}.{name}"] = own
    return errors, dear + more


def _noise(evaluations: Evaluations, parts: Parts, missing: Texts) -> tuple[dict[StageVariable, float], float]:
    """Return the half width of the 95 % interval about one draw of the noise, for numbers that depend on noise; and the
    predicted seconds of evaluations that exceeded the budget.

    For some numbers, such as the noise itself, noise causes a bias that is much larger than their scatter. The errors
    of the noise-free path do not apply to such numbers and count as not measured.
    """
    noisy = evaluations.point.noisy
    if not noisy:
        return {}, 0.0
    own_draw = evaluations.draw
    draws: list[Which] = [({"draw": n}, DRAWN) for n in range(DRAWS - bool(own_draw))]
    every, seconds = attempt(evaluations, missing, "noise", noisy, [Way((PLANNED, *draws))])
    made = [own for _, own in every.made] if every else []
    found = {}
    for one in noisy if made else ():
        values = [float(np.ravel(own[one])[-1]) for own in (*made, own_draw) if one in own]
        if len(values) == DRAWS + 1 and all(map(math.isfinite, values)):
            mean, spread = math.fsum(values[1:]) / DRAWS, float(np.std(values[1:], ddof=1))
            found[one] = INTERVAL * spread
            if abs(values[0] - mean) > 3 * INTERVAL * spread / math.sqrt(DRAWS) + 0.3 * abs(mean):
                parts[one].clear()
                missing[one]["noise-free path"] = "its value depends on the noise"
    return found, seconds
