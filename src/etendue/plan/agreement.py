"""Stages that disagree: what several take for granted and have different values of, and physics that light meets twice.

In:  nodes and cells of a plan.
Out: notes, each text once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from etendue.plan.identity.once import Once
from etendue.plan.model import Cell, CellRef, Node


def taken_differently(cells: Mapping[CellRef, Cell]) -> list[str]:
    """Where a stage assumes of something shared what no stage before it on its way did."""
    assumed: dict[CellRef, dict[str, tuple[str, Any]]] = {}
    notes: dict[str, None] = {}
    alike: Once[dict[str, tuple[str, Any]]] = Once()  # cells of one stage that read cells alike assume the same

    def assumed_by(cell: Cell) -> dict[str, tuple[str, Any]]:
        found: dict[str, tuple[str, Any]] = {}
        for _, source, _ in cell.inputs:
            found |= assumed[source]
        for what, value in cell.stage.assumes().items():
            before = found.get(what)
            if before is not None and before[1] != value:
                theirs = f"{_shown(before[1])} in {before[0]!r}, which stands before it"
                notes[f"{cell.node}: {what} is {_shown(value)} here, but {theirs}"] = None
            found[what] = (cell.node, value)
        return found

    for ref, cell in cells.items():
        before = [assumed[source] for _, source, _ in cell.inputs]
        assumed[ref] = alike((cell.stage, *before), partial(assumed_by, cell), cell.node)
    return list(notes)


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return " ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def met_twice(nodes: Iterable[Node]) -> list[str]:
    """Where light, or charge, goes through two stages that hold the same physics."""
    notes: list[str] = []
    before: dict[str, dict[str, str]] = {}  # by node: what has been met on the way, and where
    for node in nodes:
        met: dict[str, str] = {}
        for bound in node.inputs:
            for _, source, _ in bound:
                met |= before[source]
        once = dict.fromkeys(what for one in node.alternatives for what in one.kind.once)
        for what in once:
            if what in met:
                notes.append(
                    f"{node.name}: {what} counts twice: {met[what]!r}, before it, has it already; leave one of them out"
                )
        before[node.name] = met | dict.fromkeys(once, node.name)
    return notes
