"""The digits that are significant at a tolerance: the rounding steps of the pictures of a cell.

In:  cells in the order of the plan, with their facts; the tolerance.
Out: for each cell, by variable, the exponent of a power of two; None if all digits are kept.

A step is the largest power of two within the tolerance times full scale. It depends only on the plan, so it can be part
of the cell's key, and only on earlier cells, so light is not recomputed when the exposure is edited. Full scale is

- for light and charge, the largest value that it may reach, or twice the value that it is known to reach after any blur
  if that is less. Rounding changes a value by at most half a step: at most the tolerance times the largest value, even
  if a later blur makes a bright point as faint as the light around it;
- for pictures without a unit, 1; but before the stage that scales a picture to its white, the part of the converter's
  range that the charge reaches, because a dark exposure is made brighter later.

Curves, metrics, maps, integers and coordinates keep all digits.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from etendue.contract.arrays.facts import UNKNOWN, Facts
from etendue.contract.arrays.variables import Declaration, variable
from etendue.contract.stage import Stage
from etendue.plan import cost, stage_calls
from etendue.plan.expansion.forms import Draft
from etendue.plan.model import ALL_DIGITS, Cell, CellRef, Node, Plan

DISPLAYED, LINEAR = ("encoded", "unencoded"), "linear"  # how variables are shown that are rounded
SMALLEST = {"float32": -126, "float64": -1022}  # exponents below which floats have fewer digits anyway
Inputs = tuple[tuple[str, CellRef, str], ...]
Exponents = Mapping[str, int | None]


def is_picture(declared: Declaration) -> bool:
    return declared.dims[-2:] == ("y", "x")


def is_rounded(declared: Declaration) -> bool:
    """Return whether the digits of a variable follow the tolerance: floats of a picture."""
    shown = variable(declared.variable).shown
    return declared.dtype == "float" and is_picture(declared) and shown in (*DISPLAYED, LINEAR)


def is_in_range(declared: Declaration) -> bool:
    """Return whether a picture is relative to the range of a converter or to white: codes, and pictures without a
    unit.
    """
    return declared.unit == "1" or declared.dtype != "float"


def in_words(found: Exponents) -> str:
    """Return the exponents as text for the key of a cell."""
    return "digits " + " ".join(f"{name} {'all' if own is None else own}" for name, own in found.items())


class Digits:
    """Finds the digits of cells. ``cells``: the cells planned so far."""

    def __init__(
        self, cells: Mapping[CellRef, Cell], nodes: Mapping[str, Node], tolerance: float, precision: str
    ) -> None:
        self.cells, self.nodes, self.tolerance, self.precision = cells, nodes, tolerance, precision
        self.reached: dict[CellRef, float] = {}
        self.same: dict[tuple[tuple[str, int | None], ...], Exponents] = {}

    def of(self, draft: Draft, facts: Facts) -> Exponents:
        """Return the digits of a cell that is not left out; ``facts``: of its first variable."""
        if not self.tolerance > 0:
            return ALL_DIGITS
        found = []
        for number, (name, declared) in enumerate(draft.node.writes.items()):
            if is_rounded(declared):
                own = UNKNOWN if number else facts
                in_range = is_in_range(declared)
                full = self.reach(draft.node, draft.stage, draft.inputs) if in_range else brightest(own)
                found.append((name, exponent(self.tolerance * full, self.precision)))
        key = tuple(found)
        return self.same.setdefault(key, dict(key))  # most cells have the same digits as another cell

    def reach(self, node: Node, stage: Stage, inputs: Inputs) -> float:
        """Return the part of the range that a picture reaches; 0 if it is unknown."""
        main = next(iter(node.writes.values()))
        said = variable(main.variable)
        if said.shown in DISPLAYED or said.white is not None:
            return 1.0  # relative to white
        found = 1.0
        for port, ref, name in inputs:
            before = self.nodes[ref[0]].writes[name]
            if is_picture(before) and is_in_range(before):
                found = min(found, self.reach_of(ref))
            elif is_picture(before):  # a converter: the part that an error as large as all light or charge would fill
                given = {own: self.cells[one].facts for own, one, _ in inputs}
                full = brightest(given[port])
                if full > 0:
                    given[port] = replace(given[port], high=full)
                    found = min(found, stage_calls.growth_of(stage, given))
                else:
                    found = min(found, 0.0)
        return found

    def reach_of(self, ref: CellRef) -> float:
        found = self.reached.get(ref)
        if found is None:
            cell = self.cells[ref]
            found = self.reached[ref] = self.reach(self.nodes[ref[0]], cell.stage, cell.inputs)
        return found


def brightest(facts: Facts) -> float:
    """Return the full scale of light or charge; 0 if it is unknown."""
    reached = max(facts.brightest or 0.0, facts.mean or 0.0, facts.low or 0.0)
    if (content := facts.content) is not None:
        peaks = (row[-1] for row in content.peaks) if content.widths else ()
        reached = content.full * max(*content.mean, *peaks)
    return min(2 * reached, math.inf if facts.high is None else facts.high)


def exponent(step: float, precision: str) -> int | None:
    """Return the exponent of the largest power of two that is not above a number; None if floats have no such step."""
    if not 0 < step < math.inf:
        return None
    found = math.frexp(step)[1] - 1
    return found if found >= SMALLEST[precision] else None


def stored_bytes(plan: Plan) -> int:
    """Return the bytes of all stored arrays if each value takes only the bits from its sign to its rounding step."""
    total = 0.0
    for node in plan.nodes:
        names = [name for name in node.writes if (node.name, name) in plan.with_arrays]
        for cell in plan.of(node.name) if names else ():
            for name in names:
                whole = cost.bytes_of(node.writes[name], cell.grids[name], plan.precision)
                own = cell.digits.get(name)
                total += whole if own is None else min(whole, cell.grids[name].count * _bits(node, cell, name, own) / 8)
    return round(total)


def _bits(node: Node, cell: Cell, name: str, own: int) -> int:
    most = 1.0 if is_in_range(node.writes[name]) else cell.facts.high or brightest(cell.facts)
    return max(math.frexp(most)[1] - own, 0) + 1
