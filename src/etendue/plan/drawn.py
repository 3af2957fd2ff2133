"""The black level and the filter pattern with which a variable of a cell is drawn, at the axis values of the cell."""

from __future__ import annotations

from typing import Any

from etendue.contract.arrays.colouring import flat_dims
from etendue.contract.arrays.drawn import Drawn
from etendue.contract.arrays.variables import variable
from etendue.contract.capabilities import Viewed
from etendue.plan.model import Cell, Plan


def drawn_of(plan: Plan, cell: Cell, name: str) -> Drawn | None:
    """Return how to draw a variable; None if it is not a picture, or is not shown."""
    known, dims = variable(name), plan.node(cell.node).writes[name].dims
    if not known.shown or dims[-2:] != ("y", "x"):
        return None
    black = float(_quantity(plan, cell, known.black) or 0) if known.black else 0.0
    own = known.pattern and not set(flat_dims()) & set(dims)
    pattern = str(_quantity(plan, cell, known.pattern) or "") if own else ""
    viewed = "channel" in dims and isinstance(cell.stage, Viewed)
    white = cell.stage.viewing_white() if viewed and isinstance(cell.stage, Viewed) else None
    return Drawn.of(known, black, pattern, () if white is None else [float(value) for value in white])


def _quantity(plan: Plan, cell: Cell, name: str) -> Any:
    """Return the value of a shared quantity for a cell; None if it is swept along an axis that does not affect the
    cell.
    """
    axes = plan.node(cell.node).axes
    own = [plan.axis(dim) for dim in axes]
    others = [axis for axis in plan.axes if axis.dim not in axes]
    for axis in sorted([*own, *others], key=lambda axis: axis.key != name):  # its own axis overrides that of presets
        if axis.key == name or name in axis.gives:
            return axis.value(name, cell.index[axes.index(axis.dim)]) if axis.dim in axes else None
    return plan.shared.get(name)
