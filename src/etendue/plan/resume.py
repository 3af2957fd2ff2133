"""What of a plan is left to do, given what an archive holds.

In:  a plan, the axis values an archive has, the cells that are finished.
Out: the plan over all those values, and the cells to compute.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from etendue.errors import RequestError
from etendue.plan import planner
from etendue.plan.model import CellRef, Plan
from etendue.registry import installed_stages


def with_stored_values(plan: Plan, stored: Mapping[str, Mapping[str, list[Any]]]) -> Plan:
    """The plan over the axis values of an archive's earlier runs as well: what is still right there stays."""
    sweep = dict(plan.pipeline.sweep)
    for axis in plan.axes:
        earlier = dict.fromkeys(v for axes in stored.values() for v in axes.get(axis.dim, ()))
        if set(earlier) - set(axis.values) and not axis.key.endswith(".use"):
            sweep[axis.key] = [*earlier, *(v for v in axis.values if v not in earlier)]  # in stored order
    if sweep == dict(plan.pipeline.sweep):
        return plan
    try:
        return planner.make_plan(replace(plan.pipeline, sweep=sweep), installed_stages(), plan.leaves_out)
    except RequestError:  # a value that is no longer possible: its cells are not of this pipeline any more
        return plan


def select(plan: Plan, finished: set[CellRef], requested: set[CellRef] | None = None) -> set[CellRef]:
    """The cells to compute: unfinished requested ones, and finished ones whose unstored result an unfinished one reads."""
    todo = {ref for ref in (plan.cells if requested is None else requested) if ref not in finished}
    nodes = {node.name: node for node in plan.nodes}
    for ref in reversed(list(plan.cells)):
        if ref not in todo:
            continue
        cell, node = plan.cells[ref], nodes[ref[0]]
        for number, (_, source, variable) in enumerate(cell.inputs):
            if len(node.segment) > 1 and number == 0:
                _need_segment(plan, source, todo)
            elif (source[0], variable) not in plan.kept:
                todo.add(source)
        for port, what, _ in node.looks_at:
            if what != "transfer":
                todo |= {s for s in dict(cell.looks_at).get(port, ()) if (s[0], what) not in plan.kept}
    return todo


def _need_segment(plan: Plan, source: CellRef, todo: set[CellRef]) -> None:
    """A spectrum is rebuilt from its segment's input, which must be stored or computed."""
    segment_input = plan.cells[source].segment_input
    assert segment_input is not None
    (node, index), variable = segment_input
    if (node, variable) not in plan.kept:
        todo.add((node, index))
