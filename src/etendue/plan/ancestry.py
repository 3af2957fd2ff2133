"""Find the cells that some cells need, for runs of only a few cells of a plan.

In:  a plan and cells of it.
Out: these cells and all that they depend on, directly or indirectly.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable

from etendue.contract.stage import looks_at_stages
from etendue.plan.model import CellRef, Node, Plan


def ancestry(plan: Plan, refs: Iterable[CellRef], known: Collection[CellRef] = ()) -> set[CellRef]:
    """Return the cells and every cell whose result they need. The search does not continue beyond ``known`` cells."""
    nodes = {node.name: node for node in plan.nodes}
    found: set[CellRef] = set()
    open_ = list(refs)
    while open_:
        ref = open_.pop()
        if ref not in found:
            found.add(ref)
            open_ += () if ref in known else _needed_by(plan, nodes, ref)
    return found


def _needed_by(plan: Plan, nodes: dict[str, Node], ref: CellRef) -> list[CellRef]:
    """Return the cells that a cell reads, waits for and looks at. To look at transfer functions, it needs the stages
    but not their results, so only the cells that determine parameters of these stages are returned.
    """
    cell = plan.cells[ref]
    refs = [source for _, source, _ in cell.inputs] + [word.ref for word in cell.open_words]
    what_of = {port: what for port, what, _ in nodes[ref[0]].looks_at}
    for port, seen in cell.looks_at:
        if looks_at_stages(what_of[port]):
            refs += [finder for other in seen for _, finder, _ in plan.cells[other].found]
        else:
            refs += seen
    return refs


def behind(plan: Plan, names: Iterable[str]) -> set[str]:
    """Return the names of some nodes and of all nodes that depend on their outputs."""
    found = set(names)
    for node in plan.nodes:
        read = {source for bound in node.inputs for _, source, _ in bound}
        seen = {name for _, what, own in node.looks_at if not looks_at_stages(what) for name in own}
        if (read | seen) & found:
            found.add(node.name)
    return found


def in_front(plan: Plan, names: Iterable[str]) -> set[str]:
    """Return the names of some nodes and of all nodes whose decisions can change their outputs: the nodes that they
    read from or look at, directly or indirectly.
    """
    found = set(names)
    # A node reads only earlier nodes, so one pass in reverse reaches everything.
    for node in reversed(plan.nodes):
        if node.name in found:
            found |= {source for bound in node.inputs for _, source, _ in bound}
            found |= {name for _, _, own in node.looks_at for name in own}
    return found
