"""What a plan leaves out and approximates, stage by stage, as tables and JSON show it.

In:  the cells of one stage.
Out: documents with the number of cells, the bound and, where it can be told, the seconds that it saves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from etendue.plan.cost import cell_seconds
from etendue.plan.model import Approximated, Cell, Node


def left_out(node: Node, cells: Sequence[Cell], precision: str) -> dict[str, Any] | None:
    """Of a stage that some cells go without."""
    out = [(cell, cell.left_out) for cell in cells if cell.left_out]
    if not out:
        return None
    return {
        "cells": len(out), "of": len(cells), "bound": max(why.bound for _, why in out),
        "why": "; ".join(dict.fromkeys(why.why for _, why in out)),
        "seconds_saved": sum(cell_seconds(node, replace(cell, left_out=None), precision) for cell, _ in out),
    }  # fmt: skip


def approximated(cells: Sequence[Cell]) -> list[dict[str, Any]] | None:
    """Of a stage whose knobs a plan has set: every knob and setting, and in how many cells."""
    found: dict[tuple[str, Any], list[Approximated]] = {}
    for cell in cells:
        for one in cell.approximated:
            found.setdefault((one.knob, one.value), []).append(one)
    if not found:
        return None
    return [
        {
            "knob": knob,
            "value": _shown(value),
            "reference": _shown(every[0].reference),
            "bound": max(one.bound for one in every),
            "cells": len(every),
        }
        for (knob, value), every in found.items()
    ]


def _shown(value: Any) -> Any:
    return "inf" if isinstance(value, float) and math.isinf(value) else value


def told(name: str, left: dict[str, Any] | None, knobs: list[dict[str, Any]] | None) -> list[str]:
    """The same in sentences."""
    said = []
    if left:
        wrong = "exactly" if left["bound"] == 0 else f"wrong by at most {left['bound']:.2g}"
        said.append(f"left out  {name} in {left['cells']} of {left['of']} cells, {wrong}: {left['why']}")
    by_knob: dict[str, list[dict[str, Any]]] = {}
    for one in knobs or ():
        by_knob.setdefault(one["knob"], []).append(one)
    for knob, own in by_knob.items():
        values = ", ".join(f"{one['value']} ({one['cells']})" if len(own) > 1 else f"{one['value']} in {one['cells']} cells" for one in own)
        said.append(f"coarser   {name}.{knob} = {values}, not {own[0]['reference']}: adds at most {max(one['bound'] for one in own):.2g}")
    return said
