"""Summarise the omissions and approximations of a plan, stage by stage, for tables and JSON.

In:  the cells of one stage.
Out: documents with the number of cells, the bound and, if known, the seconds saved.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Sequence
from dataclasses import replace

from etendue.contract.stage import parameters_of
from etendue.plan.cost import WRITING, Rates, cell_bytes, cell_seconds, told_seconds
from etendue.plan.model import Approximated, Cell, Node
from etendue.telling import human_bytes
from etendue.types.documents import Document

LEAST_TOLD = 1e-3  # seconds; a smaller saving is not mentioned


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
    """Return the seconds that it would take to compute some left-out cells and to write those of their variables that
    have no array.
    """
    whole = [replace(cell, left_out=None) for cell in cells]
    if rates is None:
        return sum(cell_seconds(node, cell, precision) for cell in whole)
    per_byte = WRITING if rates.per_byte is None else rates.per_byte
    main = list(node.writes)[:1] if not stored else []
    unwritten = sum(cell_bytes(node, cell, precision, main) for cell in whole)
    return told_seconds(node, whole, precision, rates)[0] + per_byte * unwritten


def approximated(
    node: Node, cells: Sequence[Cell], precision: str, rates: Rates | None = None
) -> list[Document] | None:
    """Return, for a stage whose knobs the plan has set, every knob and setting with the number of cells and the seconds
    saved relative to the reference setting; None for other stages.
    """
    found: dict[tuple[str, Hashable], list[Approximated]] = {}
    wanted: dict[tuple[str, Hashable], float] = {}  # bounds at the wanted variables
    saved: dict[tuple[str, Hashable], list[float | None]] = {}
    for cell in cells:
        for one in cell.approximated:
            found.setdefault((one.knob, one.value), []).append(one)
            place = one.knob, one.value
            wanted[place] = max(wanted.get(place, 0.0), cell.at_wanted(one.bound))
            saved.setdefault((one.knob, one.value), []).append(_saved(node, cell, one, precision, rates))
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
        return cell_seconds(node, replace(cell, left_out=None), precision) - cell_seconds(node, cell, precision)
    return _sum([_saved(node, cell, one, precision) for one in cell.approximated])


def _saved(node: Node, cell: Cell, one: Approximated, precision: str, rates: Rates | None = None) -> float | None:
    """Return the seconds that one setting saves, all others unchanged; None if the knob states no costs."""
    parameter = parameters_of(type(cell.stage))[one.knob][0]
    try:
        other = replace(cell, stage=replace(cell.stage, **{one.knob: one.reference}))
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


def _saving(seconds: float | None) -> str:
    """Return the end of a sentence that states the saving; '' if it is unknown or too small to mention."""
    return f"; saves about {seconds:.2g} s" if seconds is not None and seconds >= LEAST_TOLD else ""


def _at_most(at_stage: float, at_wanted: float) -> str:
    """Return a bound, at the stage and, where later stages let it grow, in the results that are wanted."""
    grown = f", {at_wanted:.2g} in the results" if f"{at_wanted:.2g}" != f"{at_stage:.2g}" else ""
    return f"at most {at_stage:.2g} of full scale at this stage{grown}"


def _shown(value: Hashable) -> Hashable:
    return "inf" if isinstance(value, float) and math.isinf(value) else value


def _best(knob: Document) -> str:
    """Return the reference setting of a knob and, if its declaration has one, the description of this setting."""
    value, _, meaning = knob.get("best", "").partition(":")  # documents of earlier versions have none
    own = str(knob["reference"])
    return f"{own} ({meaning.strip()})" if meaning and value == own else own


def told(name: str, left: Document | None, knobs: list[Document] | None) -> list[str]:
    """Return the summaries of a stage as sentences."""
    said = []
    if left:
        wrong = "exactly" if left["bound"] == 0 else f"error {_at_most(left['at_stage'], left['bound'])}"
        copies = f"; their copies take {human_bytes(left['copies'])}" if left["copies"] else ""
        said.append(
            f"left out  {name} in {left['cells']} of {left['of']} cells, {wrong}: "
            f"{left['why']}{_saving(left['seconds_saved'])}{copies}"
        )
    by_knob: dict[str, list[Document]] = {}
    for one in knobs or ():
        by_knob.setdefault(one["knob"], []).append(one)
    for knob, own in by_knob.items():
        worst = _at_most(max(one["at_stage"] for one in own), max(one["bound"] for one in own))
        saved = _sum([one["seconds_saved"] for one in own])
        values = ", ".join(f"{one['value']} ({one['cells']})" if len(own) > 1 else f"{one['value']}" for one in own)
        said.append(f"coarser   {name}.{knob} = {values}, the best being {_best(own[0])}: {worst}{_saving(saved)}")
    return said
