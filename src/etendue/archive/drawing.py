"""What arrays say of how they are drawn, and of which direction is better, so that a program without a plan draws them right.

In:  a plan, a stage of it, one of its variables.
Out: attributes: ``drawn_as`` (linear, encoded, map), ``drawn_white``, ``drawn_black``, ``drawn_pattern`` (rows of filters), ``drawn_for``
     (XYZ of the white to which a viewer is adapted), ``better`` (higher, lower).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from etendue.physics.sensor import cfa
from etendue.plan.model import Cell, Node, Plan
from etendue.spec.capabilities import Viewed
from etendue.spec.stage import Stage
from etendue.spec.variables import variable


def drawing_attributes(plan: Plan, node: Node, cells: Sequence[Cell], name: str) -> dict[str, Any]:
    """Only what holds for all cells: a swept pattern is not said."""
    shown, dims = variable(name), node.writes[name].dims
    found: dict[str, Any] = {"better": shown.better} if shown.better else {}
    if not shown.shown or dims[-2:] != ("y", "x"):
        return found
    found["drawn_as"] = shown.shown
    if shown.white is not None:
        found["drawn_white"] = shown.white
    swept = {axis.key for axis in plan.axes}
    if shown.black and shown.black not in swept:
        found["drawn_black"] = float(plan.camera.get(shown.black, 0) or 0)
    pattern = plan.camera.get("pattern")
    if shown.shown == "linear" and not {"channel", "wavelength"} & set(dims) and pattern is not None and "pattern" not in swept:
        found["drawn_pattern"] = str(cfa.read(str(pattern)))
    if "channel" in dims:
        whites = {_white(stage) for stage in {id(cell.stage): cell.stage for cell in cells}.values()}
        if len(whites) == 1 and None not in whites:
            found["drawn_for"] = list(whites.pop() or ())
    return found


def _white(stage: Stage) -> tuple[float, ...] | None:
    white = stage.viewing_white() if isinstance(stage, Viewed) else None
    return None if white is None else tuple(float(value) for value in np.ravel(white))
