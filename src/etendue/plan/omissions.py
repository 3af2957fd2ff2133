"""Summarise the omissions and approximations of a plan, stage by stage, for tables and JSON.

In:  the cells of one stage.
Out: documents with the number of cells, the bound and, if known, the seconds saved.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Sequence
from dataclasses import replace
from functools import partial

from etendue.contract.stage import parameters_of
from etendue.plan.cost import WRITING, Rates, alike, cell_bytes, cell_seconds, seconds_of
from etendue.plan.identity.once import Once
from etendue.plan.model import Approximated, Cell, Node
from etendue.types.documents import Document


def left_out(
    node: Node, cells: Sequence[Cell], precision: str, stored: Collection[str] = (), rates: Rates | None = None
) -> Document | None:
    """Return the summary of a stage that is left out in some cells; None for other stages.

    ``bound`` refers to the wanted variables and includes the growth of errors in later stages; ``at_stage`` refers to
    the output of the stage. ``stored``: variables of the stage that have an array, so that these cells store copies.
    ``rates``: measured rates for the seconds saved, including writing.
    """
    out = [(cell, cell.left_out) for cell in cells if cell.left_out]
    if not out:
        return None
    return {
        "cells": len(out),
        "of": len(cells),
        "bound": max(cell.at_wanted(why.bound) for cell, why in out),
        "at_stage": max(why.bound for _, why in out),
        "why": "; ".join(dict.fromkeys(why.why for _, why in out)),
        "seconds_saved": _without(node, [cell for cell, _ in out], precision, stored, rates),
        "copies": sum(cell_bytes(node, cell, precision, stored) for cell, _ in out),
    }


def _without(node: Node, cells: Sequence[Cell], precision: str, stored: Collection[str], rates: Rates | None) -> float:
    """Return the seconds that it would take to compute some left-out cells and to write their variables that have no
    array.
    """
    whole = [(cell.changed(left_out=None), count) for cell, count in alike(cells)]
    if rates is None:
        return sum(count * cell_seconds(node, cell, precision) for cell, count in whole)
    per_byte = WRITING if rates.per_byte is None else rates.per_byte
    main = list(node.writes)[:1] if not stored else []
    unwritten = sum(count * cell_bytes(node, cell, precision, main) for cell, count in whole)
    return seconds_of(node, whole, precision, rates)[0] + per_byte * unwritten


def approximated(
    node: Node, cells: Sequence[Cell], precision: str, rates: Rates | None = None
) -> list[Document] | None:
    """Return, for a stage whose knobs the plan has set, every knob and setting with the number of cells and the seconds
    saved relative to the reference setting; None for other stages.
    """
    found: dict[tuple[str, Hashable], list[Approximated]] = {}
    wanted: dict[tuple[str, Hashable], float] = {}  # bounds at the wanted variables
    saved: dict[tuple[str, Hashable], list[float | None]] = {}
    known: Once[float | None] = Once()
    for cell in cells:
        for one in cell.approximated:
            found.setdefault((one.knob, one.value), []).append(one)
            place = one.knob, one.value
            wanted[place] = max(wanted.get(place, 0.0), cell.at_wanted(one.bound))
            spared = partial(_saved, node, cell, one, precision, rates)
            parts = (cell.stage, cell.grids, cell.input_grids)
            saved.setdefault(place, []).append(known(parts, spared, one, cell.left_out is None))
    if not found:
        return None
    return [
        {
            "knob": knob,
            "value": _shown(value),
            "reference": _shown(every[0].reference),
            "best": parameters_of(type(cells[0].stage))[knob][0].reference,
            "bound": wanted[knob, value],
            "at_stage": max(one.bound for one in every),
            "cells": len(every),
            "seconds_saved": _sum(saved[knob, value]),
        }
        for (knob, value), every in found.items()
    ]


def saved(node: Node, cell: Cell, precision: str) -> float | None:
    """Return the seconds that the decisions about a cell are expected to save; None if unknown."""
    if cell.left_out:
        return cell_seconds(node, cell.changed(left_out=None), precision) - cell_seconds(node, cell, precision)
    return _sum([_saved(node, cell, one, precision) for one in cell.approximated])


def _saved(node: Node, cell: Cell, one: Approximated, precision: str, rates: Rates | None = None) -> float | None:
    """Return the seconds that one setting saves, all others unchanged; None if the knob states no costs."""
    parameter = parameters_of(type(cell.stage))[one.knob][0]
    try:
        other = cell.changed(stage=replace(cell.stage, **{one.knob: one.reference}))
    except ValueError:  # the stage refuses the reference setting
        return None
    estimate = cell_seconds(node, cell, precision)
    saved = cell_seconds(node, other, precision) - estimate
    taken = None if rates is None else rates.seconds(cell, estimate, precision)
    saved *= 1.0 if taken is None else taken / estimate
    return max(saved, 0.0) if parameter.costs or saved else None


def _sum(seconds: Sequence[float | None]) -> float | None:
    known = [one for one in seconds if one is not None]
    return sum(known) if len(known) == len(seconds) else None


def _shown(value: Hashable) -> Hashable:
    return "inf" if isinstance(value, float) and math.isinf(value) else value
