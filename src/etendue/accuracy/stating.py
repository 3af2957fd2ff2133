"""State an error for cells that were not measured, from those that were and from what the plan decided for both.

In:  the plan of a whole sweep, and errors measured at some of its places.
Out: for every wanted variable, a number that the worst of its cells is unlikely to exceed.
"""

from __future__ import annotations

from collections.abc import Sequence

from etendue.accuracy.measuring import MeasuredErrors
from etendue.plan.model import CellRef, Plan
from etendue.types.documents import AxisValues

MARGIN = 3.0  # factor on the worst measured error: a few cells represent many


def stated_elsewhere(plan: Plan, measured: MeasuredErrors, places: Sequence[AxisValues]) -> dict[str, float | None]:
    """Return the stated error by variable, rms relative to full scale; None if unknown, or if every cell was measured.

    The bounds of all decisions on the way to a cell are added up. If that sum exceeds those of the measured cells, the
    stated error grows in proportion.
    """
    bounds: dict[CellRef, float] = {}
    for ref, cell in plan.cells.items():
        bounds[ref] = cell.bound + max((bounds[source] for _, source, _ in cell.inputs), default=0.0)
    names = [name for _, name in plan.wanted]
    found: dict[str, float | None] = {}
    for stage, name in plan.wanted:
        key = name if names.count(name) == 1 else f"{stage}.{name}"
        axes = [plan.axis(dim) for dim in plan.node(stage).axes]
        seen = {(stage, tuple(axis.values.index(place[axis.dim]) for axis in axes)) for place in places}
        others = [bounds[cell.ref] for cell in plan.of(stage) if cell.ref not in seen]
        worst = measured.errors[key].rms if key in measured.errors else None
        if worst is None or not others:
            found[key] = None
            continue
        most = max(bounds[ref] for ref in seen)
        found[key] = MARGIN * worst * (max(1.0, max(others) / most) if most > 0 else 1.0)
    return found
