"""Where a cell finds what it reads: positions on the axes of other nodes, from its own.

In:  a node of the graph, and those it reads and looks at.
Out: ``Reading``, once for all cells of an alternative.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import NamedTuple

from etendue.contract.capabilities import Noisy
from etendue.contract.stage import looks, quantities_of, reads_of
from etendue.plan.model import Node

Place = Callable[[tuple[int, ...]], tuple[int, ...]]  # the position of one cell from that of another


class Reading(NamedTuple):
    """Where an alternative of a node finds what it reads."""

    inputs: tuple[tuple[str, str, str, Place], ...]  # port or shared quantity, node, variable, where
    looks_at: tuple[tuple[str, tuple[tuple[str, Place], ...]], ...]
    ports: frozenset[str]
    quantities: frozenset[str]
    alike: bool  # whether what is decided of a cell follows from its stage, and the grids and facts of what it reads


def reading_of(node: Node, number: int, nodes: Mapping[str, Node]) -> Reading:
    """What the alternative at this place of a node reads and looks at."""
    kind = node.alternatives[number].kind
    ports = reads_of(kind)
    seen = [one for one in node.looks_at if one[0] in ports and looks(ports[one[0]]) == one[1]]
    return Reading(
        tuple((port, source, variable, places(node, nodes[source])) for port, source, variable in node.inputs[number]),
        tuple((port, tuple((name, places(node, nodes[name])) for name in names)) for port, _, names in seen),
        frozenset(ports),
        frozenset(quantities_of(kind)),
        not (node.is_source or node.segment or issubclass(kind, Noisy)),
    )


def places(node: Node, source: Node) -> Place:
    """Where a cell stands that is read; what a probe of transfer functions does not depend on is at its first value."""
    where = {dim: place for place, dim in enumerate(node.axes)}
    if source.axes == node.axes:
        return lambda index: index
    if len(source.axes) > 1 and all(dim in where for dim in source.axes):
        return itemgetter(*(where[dim] for dim in source.axes))
    found = [where.get(dim, -1) for dim in source.axes]
    return lambda index: tuple([index[place] if place >= 0 else 0 for place in found])
