"""Compare evaluations of a point that differ in one or several discretisations.

In:  evaluations, computed on demand within the budget, and variables.
Out: the change of each variable, as a part of its error; or the reason why it is unknown.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from etendue.accuracy.answers.error import OMISSIONS, Part, is_number, part_between
from etendue.accuracy.answers.evaluations import Evaluated, Evaluations, TooDear, Which
from etendue.accuracy.answers.regridding import on_grid
from etendue.contract.arrays.variables import Declaration, variable
from etendue.plan.model import Plan, StageVariable

if TYPE_CHECKING:
    from etendue.types.arrays import Array

# With first-order convergence, the error that remains after a refinement by two equals its change, so the total is
# twice the change. For a margin, less remains.
FIRST_ORDER = 2.0
SAFETY: Mapping[str, float] = {"spacing": FIRST_ORDER, "bins": FIRST_ORDER, "margin": 1.5}
UNRESOLVED = 0.4  # a number that one step changes by a larger fraction does not converge
COARSENED = 1.5  # factor on the change in cheaper ways, where 1 is expected
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


def is_refinable(evaluations: Evaluations, name: str) -> bool:
    """Return whether the stages accept a finer discretisation if everything else stays as planned. The check makes one
    plan; without it, a refusal would be found only after six plans. Return True if no time is left for the check.
    """
    try:
        return evaluations.plan({name: 2}) is not None
    except TooDear:
        return True


def not_affected(parts: Parts, affected: Collection[StageVariable], name: str) -> None:
    """Set the error to 0 for the variables that a discretisation cannot change."""
    for one, own in parts.items():
        if one not in affected:
            own[name] = Part(0.0, 0.0, "not affected")


def computed_alike(own: Plan, other: Plan) -> bool:
    """Return whether two plans of a point compute all cells in the same way."""
    return own.precision == other.precision and all(
        cell.left_out is None and cell.stage == other.cells[ref].stage for ref, cell in own.cells.items()
    )


def attempt(
    evaluations: Evaluations, missing: Texts, name: str, wanted: Iterable[StageVariable], ways: list[Way]
) -> tuple[Compared | None, float]:
    """Return the evaluations of the first `Way` that fits into the budget, and 0 seconds. If no way fits, return the
    evaluations of as many variables as possible (wanted and cheap variables first) and the seconds that all variables
    would take, and record the other variables in ``missing``.

    Return None and 0 if the stages refuse every way. If not even one variable fits into the budget, the list of
    evaluations is empty.
    """
    dear: list[tuple[Way, TooDear]] = []
    for way in ways:
        try:
            found = evaluations.all_of(*way.which)
        except TooDear as error:
            dear.append((way, error))
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
    for one in wanted:
        stage, written = one
        if name in missing[one]:
            continue
        if one not in values or one not in reference:
            missing[one][name] = f"{stage} fails without noise, or when refined"
            continue
        cell = other.of(stage)[0]
        declared, grid = other.node(stage).writes[written], plan.of(stage)[0].grids[written]
        finer: Array | None = reference[one]
        if grid != cell.grids[written]:
            finer = on_grid(reference[one], declared.dims, cell.grids[written], grid)
        if finer is None:
            missing[one][name] = "the variable is on the grid that is refined"
            continue
        found = part_between(values[one], finer, declared, cell.stage)
        if isinstance(found, str):
            missing[one][name] = found
        elif name != OMISSIONS and (share := _share(found, values[one], finer, declared)) > UNRESOLVED:
            missing[one][name] = f"one step changes it by {share:.0%}, so it does not converge on these grids"
        else:
            parts[one][name] = found * (SAFETY.get(name, FIRST_ORDER) if factor is None else factor)


def _share(found: Part, value: Array, other: Array, declared: Declaration) -> float:
    """Return the change of a number relative to the larger of its two magnitudes; 0 for pictures and for fractions of a
    whole.
    """
    if not is_number(declared) or variable(declared.variable).full is not None:
        return 0.0
    largest = max((abs(x) for one in (value, other) for x in np.ravel(one) if np.isfinite(x)), default=0.0)
    return found.rms / largest if largest else 0.0
