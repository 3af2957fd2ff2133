"""What a plan leaves out and approximates, stage by stage, as tables and JSON show it.

In:  the cells of one stage.
Out: documents with the number of cells, the bound and, where it can be told, the seconds that it saves.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import Any

from etendue.contract.stage import parameters_of
from etendue.plan.cost import cell_seconds
from etendue.plan.model import Approximated, Cell, Node
from etendue.types.documents import Document

LEAST_TOLD = 1e-3  # seconds that are worth a word


def left_out(node: Node, cells: Sequence[Cell], precision: str) -> Document | None:
    """Of a stage that some cells go without."""
    out = [(cell, cell.left_out) for cell in cells if cell.left_out]
    if not out:
        return None
    return {
        "cells": len(out),
        "of": len(cells),
        "bound": max(why.bound for _, why in out),
        "why": "; ".join(dict.fromkeys(why.why for _, why in out)),
        "seconds_saved": sum(cell_seconds(node, replace(cell, left_out=None), precision) for cell, _ in out),
    }


def approximated(node: Node, cells: Sequence[Cell], precision: str) -> list[Document] | None:
    """Of a stage whose knobs a plan has set: every knob and setting, in how many cells, and what that saves beside
    the reference's.
    """
    found: dict[tuple[str, Hashable], list[Approximated]] = {}
    saved: dict[tuple[str, Hashable], list[float | None]] = {}
    for cell in cells:
        for one in cell.approximated:
            found.setdefault((one.knob, one.value), []).append(one)
            saved.setdefault((one.knob, one.value), []).append(_saved(node, cell, one, precision))
    if not found:
        return None
    return [
        {
            "knob": knob,
            "value": _shown(value),
            "reference": _shown(every[0].reference),
            "bound": max(one.bound for one in every),
            "cells": len(every),
            "seconds_saved": _sum(saved[knob, value]),
        }
        for (knob, value), every in found.items()
    ]


def saved(node: Node, cell: Cell, precision: str) -> float | None:
    """Seconds that a plan's decisions for a cell are expected to save; None where that is not known."""
    if cell.left_out:
        return cell_seconds(node, replace(cell, left_out=None), precision) - cell_seconds(node, cell, precision)
    return _sum([_saved(node, cell, one, precision) for one in cell.approximated])


def _saved(node: Node, cell: Cell, one: Approximated, precision: str) -> float | None:
    """Seconds that a setting saves, all others as they are; None where nobody has said what the knob costs."""
    parameter = parameters_of(type(cell.stage))[one.knob][0]
    try:
        other = replace(cell, stage=replace(cell.stage, **{one.knob: one.reference}))
    except ValueError:  # the stage refuses it
        return None
    saved = cell_seconds(node, other, precision) - cell_seconds(node, cell, precision)
    return max(saved, 0.0) if parameter.costs or saved else None


def _sum(seconds: Sequence[float | None]) -> float | None:
    known = [one for one in seconds if one is not None]
    return sum(known) if len(known) == len(seconds) else None


def _saving(seconds: float | None) -> str:
    """As a sentence ends with it, where it is known and worth a word."""
    return f"; saves about {seconds:.2g} s" if seconds is not None and seconds >= LEAST_TOLD else ""


def _shown(value: Any) -> float | str:
    return "inf" if isinstance(value, float) and math.isinf(value) else value


def told(name: str, left: Document | None, knobs: list[Document] | None) -> list[str]:
    """The same in sentences."""
    said = []
    if left:
        wrong = "exactly" if left["bound"] == 0 else f"wrong by at most {left['bound']:.2g}"
        said.append(
            f"left out  {name} in {left['cells']} of {left['of']} cells, {wrong}: "
            f"{left['why']}{_saving(left['seconds_saved'])}"
        )
    by_knob: dict[str, list[Document]] = {}
    for one in knobs or ():
        by_knob.setdefault(one["knob"], []).append(one)
    for knob, own in by_knob.items():
        worst, saved = max(one["bound"] for one in own), _sum([one["seconds_saved"] for one in own])
        values = ", ".join(
            f"{one['value']} ({one['cells']})" if len(own) > 1 else f"{one['value']} in {one['cells']} cells"
            for one in own
        )
        said.append(
            f"coarser   {name}.{knob} = {values}, not {own[0]['reference']}: adds at most {worst:.2g}{_saving(saved)}"
        )
    return said
