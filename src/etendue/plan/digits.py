"""The digits that a tolerance leaves: the step to whose multiples a cell's pictures are rounded where its stage hands
them on.

In:  a cell before or after its decisions, and the tolerance.
Out: by variable, the exponent of a power of two; None where all digits stay.

The step is the largest power of two within the tolerance times full scale. It follows from the plan alone, so that it
can be in the key of the cell. Full scale is 1 for pictures without a unit, and of light and charge the largest value
that the plan knows it may reach, or twice the value that it is known to reach if that is less: rounding changes a value
by at most half a step, which is then at most the tolerance times the largest value. Curves, metrics, maps, integers and
coordinates keep all digits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from etendue.contract.arrays.facts import UNKNOWN, Facts
from etendue.contract.arrays.variables import Declaration, variable
from etendue.plan.model import Cell, Node, Plan

PICTURES = ("linear", "encoded", "unencoded")  # how variables are shown that are rounded
SMALLEST = {"float32": -126, "float64": -1022}  # exponents below which floats have fewer digits anyway


def is_rounded(declared: Declaration) -> bool:
    """Return whether the digits of a variable follow the tolerance: floats of a picture."""
    return (
        declared.dtype == "float" and declared.dims[-2:] == ("y", "x") and variable(declared.variable).shown in PICTURES
    )


def exponents(
    writes: Mapping[str, Declaration], facts: Facts, tolerance: float, precision: str
) -> dict[str, int | None]:
    """Return the exponents of the steps of a cell that is not left out. ``facts``: of its first variable."""
    found: dict[str, int | None] = {}
    if not tolerance > 0:
        return found
    for number, (name, declared) in enumerate(writes.items()):
        if is_rounded(declared):
            found[name] = _exponent(tolerance * full_scale(declared, UNKNOWN if number else facts), precision)
    return found


def full_scale(declared: Declaration, facts: Facts) -> float:
    """Return the value to which the digits of a picture are relative; 0 if it is unknown."""
    if declared.unit == "1":
        return 1.0
    reached = max(facts.brightest or 0.0, facts.mean or 0.0, facts.low or 0.0)
    if (content := facts.content) is not None:
        peaks = (row[0] for row in content.peaks) if content.widths else ()
        reached = content.full * max(*content.mean, *peaks)
    return min(2 * reached, math.inf if facts.high is None else facts.high)


def _exponent(step: float, precision: str) -> int | None:
    if not 0 < step < math.inf:
        return None
    exponent = math.frexp(step)[1] - 1
    return exponent if exponent >= SMALLEST[precision] else None


def steps(plan: Plan, node: Node, cell: Cell) -> dict[str, float]:
    """Return the steps of a cell by variable. One that is left out passes on what is rounded already."""
    if cell.left_out is not None:
        return {}
    found = exponents(node.writes, cell.facts, plan.digits, plan.precision)
    return {name: 2.0**own for name, own in found.items() if own is not None}


def in_words(found: Mapping[str, int | None]) -> str:
    """Return the exponents as text for the key of a cell."""
    return "digits " + " ".join(f"{name} {'all' if own is None else own}" for name, own in found.items())
