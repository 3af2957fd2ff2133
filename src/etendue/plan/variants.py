"""Variants of a plan: the same stages and connections with other parameter values, planned again in a fraction of the
time. They are for runs that store nothing: their cells have no keys.

In:  a plan.
Out: a plan of the same graph.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from etendue.plan.expansion.cells import expand
from etendue.plan.model import Axis, Node, Plan
from etendue.plan.planner import asked_of_stages, without_collecting
from etendue.plan.wiring.graph import Graph
from etendue.plan.wiring.request import Choice
from etendue.types.documents import DocumentView


@without_collecting()
@asked_of_stages()
def variant(
    plan: Plan,
    values: Mapping[str, DocumentView],
    leave_out: bool = False,
    precision: str = "",
    expected: bool = True,
    draw: int = 0,
) -> Plan:
    """Return a plan with other parameter values.

    Parameters
    ----------
    values : by stage and parameter, in the parameter's unit; they replace those of the file and of axes of one value
    leave_out : whether stages may be left out or approximated, as in the pipeline
    precision : of arrays; '' as in the pipeline
    expected : means instead of draws and rounding
    draw : added to the seed of the pipeline

    Raises
    ------
    RequestError
        If the stages refuse the values.
    """
    nodes = tuple(_with_values(node, values.get(node.name, {})) for node in plan.nodes)
    graph = Graph(nodes, tuple(_moved(axis, values) for axis in plan.axes), dict(plan.shared), plan.wanted, None, ())
    pipeline = replace(plan.pipeline, seed=plan.pipeline.seed + draw)
    choice = Choice(
        pipeline.tolerance,
        leave_out and pipeline.leave_out,
        precision or pipeline.precision,
        pipeline.norm,
        expected,
        keys=False,
    )
    cells, chosen, _ = expand(graph, pipeline, choice)
    return replace(
        plan,
        pipeline=pipeline,
        axes=graph.axes,
        nodes=nodes,
        cells=cells,
        precision=chosen,
        leaves_out=choice.leave_out,
        expected=expected,
    )


def _with_values(node: Node, values: DocumentView) -> Node:
    if not values:
        return node
    every = tuple(
        replace(one, values={**one.values, **values}, written=one.written | values.keys()) for one in node.alternatives
    )
    return replace(node, alternatives=every)


def _moved(axis: Axis, values: Mapping[str, DocumentView]) -> Axis:
    """Return an axis of a stage's parameter at its new value."""
    stage, _, name = axis.key.partition(".")
    own = values.get(stage, {})
    return replace(axis, values=(own[name],)) if name in own and len(axis.values) == 1 else axis
