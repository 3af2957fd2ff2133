"""Find stages that disagree: about a shared assumption, or by modelling the same physics twice along one path.

In:  nodes and cells of a plan.
Out: notes, each text once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

from etendue.contract.stage import Stage
from etendue.plan.identity.once import Once
from etendue.plan.model import Cell, CellRef, Node

Assumed = dict[str, tuple[str, Any]]  # by what is assumed: the stage that assumes it, and the value


def taken_differently(nodes: Iterable[Node], cells: Mapping[CellRef, Cell]) -> list[str]:
    """Return a note for every stage whose assumption differs from that of an earlier stage on its path."""
    by_node: dict[str, list[Cell]] = {}
    for cell in cells.values():
        by_node.setdefault(cell.node, []).append(cell)
    # By node: the assumptions made up to its cells; one entry if all cells assume the same, else one per cell.
    everywhere: dict[str, Assumed] = {}
    somewhere: dict[CellRef, Assumed] = {}
    notes: dict[str, None] = {}
    # Cells with equal stages and equal inputs make the same assumptions.
    alike: Once[Assumed] = Once()

    def assumed_by(cell: Cell, *before: Assumed) -> Assumed:
        found: Assumed = {}
        for one in before:
            found |= one
        for what, value in cell.stage.assumes().items():
            earlier = found.get(what)
            if earlier is not None and earlier[1] != value:
                theirs = f"{_shown(earlier[1])} in {earlier[0]!r}, earlier on its path"
                notes[f"{cell.node}: {what} is {_shown(value)} here, but {theirs}"] = None
            found[what] = (cell.node, value)
        return found

    for node in nodes:
        own = by_node.get(node.name, [])
        sources = {source for bound in node.inputs for _, source, _ in bound}
        if len(node.inputs) == 1 and sources <= everywhere.keys():
            before = [everywhere[source] for _, source, _ in node.inputs[0]]
            found = [alike((one, *before), partial(assumed_by, one_cell, *before)) for one, one_cell in _stages(own)]
            if all(one == found[0] for one in found):
                everywhere[node.name] = found[0] if found else {}
                continue
        for cell in own:
            before = [everywhere[r[0]] if r[0] in everywhere else somewhere[r] for _, r, _ in cell.inputs]
            somewhere[cell.ref] = alike((cell.stage, *before), partial(assumed_by, cell, *before))
    return list(notes)


def _stages(cells: Iterable[Cell]) -> list[tuple[Stage, Cell]]:
    """Return the distinct stages of some cells, each with the first cell that has it."""
    found: Once[tuple[Stage, Cell]] = Once()
    for cell in cells:
        if found.get((cell.stage,)) is None:
            found.put((cell.stage, cell), (cell.stage,))
    return found.values()


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
