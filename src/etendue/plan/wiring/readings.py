"""Where the inputs of a cell come from.

In:  nodes; the maps between axes of one set of rows.
Out: ``Reading``: by port the node and variable, and the map from the position of a cell to that of the cell it reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from operator import itemgetter

from etendue.contract.capabilities import Bounded, Noisy, Transfer
from etendue.contract.stage import looks, quantities_of, reads_of
from etendue.plan.model import Node
from etendue.plan.structure.cell import PositionMap, Reading

Maps = Mapping[tuple[str, str], tuple[int, ...]]  # positions on one axis by those on another


def reading_of(node: Node, number: int, nodes: Mapping[str, Node], maps: Maps) -> Reading:
    """Return the inputs of an alternative of a node and the stages that it looks at, with their positions."""
    kind = node.alternatives[number].kind
    ports = reads_of(kind)
    seen = [one for one in node.looks_at if one[0] in ports and looks(ports[one[0]]) == one[1]]
    asked = [name for _, what, names in seen if what == "transfer" for name in names]
    return Reading(
        tuple(
            (port, source, variable, places(node, nodes[source], maps))
            for port, source, variable in node.inputs[number]
        ),
        tuple((port, tuple((name, places(node, nodes[name], maps)) for name in names)) for port, _, names in seen),
        frozenset(ports),
        frozenset(quantities_of(kind)),
        not (node.is_source or node.segment or (issubclass(kind, Noisy) and issubclass(kind, Bounded | Transfer))),
        tuple((name, places(node, nodes[name], maps)) for name in asked),
        len(node.segment),
    )


def places(node: Node, source: Node, maps: Maps) -> PositionMap:
    """Return the map from the position of a cell of ``node`` to the position of the cell of ``source`` that it reads.
    Dims that ``node`` lacks are at their first value, which is right because a node lacks only dims that do not change
    what it reads. A row of a design is mapped to its combination of factors.
    """
    where = {dim: place for place, dim in enumerate(node.axes)}
    if source.axes == node.axes:
        return lambda index: index
    found: list[tuple[int, tuple[int, ...] | None]] = []
    for dim in source.axes:
        via = next((own for own in node.axes if (own, dim) in maps), "") if dim not in where else ""
        found.append((where[via], maps[via, dim]) if via else (where.get(dim, -1), None))
    if len(found) > 1 and all(place >= 0 and rows is None for place, rows in found):
        return itemgetter(*(place for place, _ in found))
    return lambda index: tuple(
        [0 if place < 0 else index[place] if rows is None else rows[index[place]] for place, rows in found]
    )
