"""Attributes with which an array is drawn correctly without a plan, and that say whether higher or lower values are
better.

In:  a plan, one of its stages, some cells of that stage, and one of its variables.
Out: the attributes of ``contract.arrays.drawn.Drawn``, with the attributes that vary along axes in ``drawn_by``;
     ``better`` (higher, lower).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from etendue.contract.arrays import colouring
from etendue.contract.arrays.drawn import BY
from etendue.contract.arrays.variables import variable
from etendue.contract.capabilities import Viewed
from etendue.plan.drawn import drawn_of
from etendue.plan.model import Cell, Node, Plan
from etendue.types.documents import Document


def drawing_attributes(plan: Plan, node: Node, cells: Sequence[Cell], name: str) -> Document:
    """Return the attributes common to all cells and, in ``drawn_by``, the attributes that vary."""
    better = variable(name).better
    found: Document = {"better": better} if better else {}
    if drawn_of(plan, cells[0], name) is None:
        return found
    by_cell = _by_cell(plan, node, cells, name)
    first = next(iter(by_cell.values()))
    others = [own for own in by_cell.values() if own is not first]  # cells with equal attributes share one dictionary
    common = {key: value for key, value in first.items() if all(own.get(key) == value for own in others)}
    if all(own == first for own in others):
        return found | common
    moving = _moving(by_cell, len(node.axes))
    places: dict[str, list[Any]] = {}
    for index, own in by_cell.items():
        at = {node.axes[n]: plan.axis(node.axes[n]).values[index[n]] for n in moving}
        places[json.dumps(at)] = [at, {key: value for key, value in own.items() if key not in common}]
    return found | common | {BY: json.dumps(list(places.values()))}


def _by_cell(plan: Plan, node: Node, cells: Sequence[Cell], name: str) -> dict[tuple[int, ...], Document]:
    """Return the attributes by position on the axes; cells that are drawn alike share one dictionary."""
    names = {variable(name).pattern, variable(name).black} - {""}  # quantities that change the drawing
    swept = [plan.axis(dim) for dim in node.axes]
    axes = [number for number, axis in enumerate(swept) if axis.key in names or names & axis.gives.keys()]
    viewed = any(issubclass(one.kind, Viewed) for one in node.alternatives)
    drawn = drawn_of(plan, cells[0], name)
    starts = _starts(cells, name) if drawn is not None and drawn.pattern else {}
    if not axes and not viewed and len(set(starts.values())) < 2:
        cells = cells[:1]
    known: dict[Any, Document] = {}
    found = {}
    for cell in cells:
        start = starts.get(cell.index, (0, 0))
        alike = (tuple(cell.index[n] for n in axes), cell.stage if viewed else None, start)
        if alike not in known and (own := drawn_of(plan, cell, name)) is not None:
            known[alike] = replace(own, pattern=_rows(own.pattern, start)).attributes()
        found[cell.index] = known[alike]
    return found


def _starts(cells: Sequence[Cell], name: str) -> dict[tuple[int, ...], tuple[int, int]]:
    """Return the row and column at which each array begins; 0 along a direction in which all arrays begin alike,
    because coordinates there count from the first sample.
    """
    lines = [(cell.grids[name].line("y"), cell.grids[name].line("x")) for cell in cells]
    rows, columns = ([round(line.start) for line in along] for along in zip(*lines, strict=True))
    down, across = (len(set(along)) > 1 for along in (rows, columns))
    return {cell.index: (y if down else 0, x if across else 0) for cell, y, x in zip(cells, rows, columns, strict=True)}


def _rows(pattern: str, start: tuple[int, int]) -> str:
    """Return the rows of a pattern as text, separated by /, shifted to a starting row and column."""
    if not pattern:
        return ""
    return "/".join(colouring.pattern(pattern).moved(*start))


def _moving(found: Mapping[tuple[int, ...], Any], axes: int) -> list[int]:
    """Return the numbers of the axes along which the attributes differ; all axes if too few cells are known."""
    moving = []
    for number in range(axes):
        rest: dict[tuple[int, ...], Any] = {}
        if any(rest.setdefault((*at[:number], *at[number + 1 :]), own) != own for at, own in found.items()):
            moving.append(number)
    told: dict[tuple[int, ...], Any] = {}
    alone = any(told.setdefault(tuple(at[n] for n in moving), own) != own for at, own in found.items())
    return list(range(axes)) if alone else moving
