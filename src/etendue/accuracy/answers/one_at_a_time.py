"""The error of each discretisation and of omissions, one after the other.

In:  evaluations of a point, with a budget for about ten evaluations.
Out: the parts of the errors of the wanted variables.

A discretisation is refined by a factor of two while all others are coarse. The change hardly depends on the others, and
the evaluation costs a fraction of the seconds of the point itself.
"""

from __future__ import annotations

from etendue.accuracy.answers.comparing import (
    COARSE,
    COARSENED,
    FEW_BANDS,
    FIRST_ORDER,
    SAFETY,
    Compared,
    KnownParts,
    Parts,
    Texts,
    Way,
    attempt,
    compare,
    computed_alike,
    is_refinable,
    not_affected,
)
from etendue.accuracy.answers.error import OMISSIONS
from etendue.accuracy.answers.evaluations import PLANNED, Evaluated, Evaluations, TooDear, Which
from etendue.accuracy.answers.refinement import EXACT, NEARER, Factors
from etendue.plan.model import Plan, StageVariable


def measure_omissions(evaluations: Evaluations, parts: Parts, missing: Texts) -> float:
    """Add the change by omissions and coarser settings to ``parts``; return the predicted seconds of evaluations that
    exceeded the budget.
    """
    wanted = evaluations.point.wanted
    pair, seconds = attempt(evaluations, missing, OMISSIONS, wanted, _omitted(evaluations))
    if pair is None:
        for own in missing.values():
            own[OMISSIONS] = evaluations.point.why_no_reference()
    elif pair.made:
        compare(parts, missing, [pair.made[0], pair.made[-1]], OMISSIONS, wanted, pair.factor)
    return seconds


def measure_each(
    plan: Plan,
    evaluations: Evaluations,
    names: list[str],
    parts: Parts,
    missing: Texts,
    fixed: dict[str, str],
    known: KnownParts,
) -> float:
    """For each discretisation, add to ``parts`` the change of the results when it is refined once; return the predicted
    seconds of the refinements that were skipped because they exceed the budget.
    """
    point, dear = evaluations.point, 0.0
    order = [*SAFETY, *names]
    for name in sorted(names, key=order.index):
        affected = point.affected(plan, name)
        not_affected(parts, affected, name)
        rest = [one for one in affected if not _take(parts, missing, one, name, known)]
        if not rest:
            continue
        pair: Compared | None = None
        seconds = 0.0
        for base in _bases(name) if is_refinable(evaluations, name) else ():
            if pair is None:
                pair, seconds = attempt(evaluations, missing, name, rest, _refined(name, base))
        dear += seconds
        if pair is None:
            fixed[name] = point.why_no_finer()
        elif pair.made:
            compare(parts, missing, pair.made, name, rest, pair.factor)
    return dear


def _take(parts: Parts, missing: Texts, one: StageVariable, name: str, known: KnownParts) -> bool:
    """Add an already known error of a discretisation to the parts of a variable; return False if it is not known."""
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
    return next(filter(None, (evaluations.all_of(*which) for which in refinements(name))), None)


def refinements(name: str) -> list[tuple[Which, Which]]:
    """Return pairs of evaluations that differ by one refinement, to be tried in order until the stages accept one."""
    return [((base, ""), ({**base, name: 2}, "")) for base in _bases(name)]


def _bases(name: str) -> tuple[Factors, Factors]:
    """Return the factors of the other discretisations while one is refined: first coarse ones, then, if the stages
    refuse these, as planned.
    """
    return (COARSE if name == "bins" else FEW_BANDS), {}


def _refined(name: str, base: Factors) -> list[Way]:
    """Return the evaluations from which the error of a discretisation follows; ``base``: factors of the other
    discretisations.

    The first way is one refinement. A cheaper way is to coarsen once: for convergence of first or higher order, the
    error is at most the change caused by coarsening. A margin can also be widened on a coarser grid.
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
    planned; the other uses the reference, or settings one step towards the reference. Both may use few bands. If plan
    and reference have the same cells, only the first is returned.
    """
    own = evaluations.point.base
    try:
        exact = evaluations.plan({}, EXACT)
    except TooDear:
        exact = None
    if exact and computed_alike(own, exact):
        return [Way((PLANNED,))]
    return [
        Way((PLANNED, ({}, EXACT))),
        Way((PLANNED, ({}, NEARER)), FIRST_ORDER),
        Way(((FEW_BANDS, ""), (FEW_BANDS, EXACT)), COARSENED),
        Way(((FEW_BANDS, ""), (FEW_BANDS, NEARER)), COARSENED * FIRST_ORDER),
    ]
