"""Find stages that disagree: about a shared assumption, or by modelling the same physics twice along one path.

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
    """Return a note for every stage whose assumption differs from that of an earlier stage on its path."""
    assumed: dict[CellRef, dict[str, tuple[str, Any]]] = {}
    notes: dict[str, None] = {}
    # Cells with equal stages and equal inputs make the same assumptions.
    alike: Once[dict[str, tuple[str, Any]]] = Once()

    def assumed_by(cell: Cell) -> dict[str, tuple[str, Any]]:
        found: dict[str, tuple[str, Any]] = {}
        for _, source, _ in cell.inputs:
            found |= assumed[source]
        for what, value in cell.stage.assumes().items():
            before = found.get(what)
            if before is not None and before[1] != value:
                theirs = f"{_shown(before[1])} in {before[0]!r}, earlier on its path"
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
    """Return a note for every two stages on one path of light or charge that model the same physics."""
    notes: list[str] = []
    # By node: each kind of physics modelled up to it, and the stage that models it.
    before: dict[str, dict[str, str]] = {}
    for node in nodes:
        met: dict[str, str] = {}
        for bound in node.inputs:
            for _, source, _ in bound:
                met |= before[source]
        once = dict.fromkeys(what for one in node.alternatives for what in one.kind.once)
        for what in once:
            if what in met:
                notes.append(f"{node.name}: {what} counts twice: {met[what]!r} already models it; remove one of them")
        before[node.name] = met | dict.fromkeys(once, node.name)
    return notes
