"""Variants of a plan: one point of its sweep, other draws of the noise, the same graph with other parameter values. A
variant takes a fraction of the time of a new plan.

In:  a plan.
Out: a plan for runs that store nothing: its cells have the keys and stated errors of the whole plan, or none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from etendue.plan.expansion.cells import expand
from etendue.plan.model import Axis, Cell, CellRef, Node, Plan, StageVariable
from etendue.plan.planner import asked_of_stages
from etendue.plan.wiring.graph import Graph
from etendue.plan.wiring.request import Choice
from etendue.process import NOT_COLLECTING
from etendue.types.documents import AxisValues, DocumentView


@NOT_COLLECTING
@asked_of_stages()
def variant(
    plan: Plan,
    values: Mapping[str, DocumentView],
    exact: bool = False,
) -> Plan:
    """Return a plan with other parameter values.

    Parameters
    ----------
    values : by stage and parameter, in the parameter's unit; they replace values of the file, and of axes with a single
        value
    exact : leave nothing out, approximate nothing, and compute in 64 bits; otherwise decide as ``plan`` does

    Raises
    ------
    RequestError
        If the stages refuse the values.
    """
    nodes = tuple(_with_values(node, values.get(node.name, {})) for node in plan.nodes)
    axes, derived, factors = (
        tuple(_moved(axis, values) for axis in own)
        for own in (plan.axes, plan.derived, [one for axis in plan.axes for one in axis.factors])
    )
    shared, wanted = dict(plan.shared), plan.wanted
    graph = Graph(nodes, axes, shared, wanted, None, (), derived=derived, factors=factors)
    pipeline = plan.pipeline
    precision, decided = ("float64", {}) if exact else (plan.precision, plan.cells)
    choice = Choice(pipeline.tolerance, False, precision, pipeline.norm, plan.expected, decided=decided, stored=False)
    cells, chosen, _ = expand(graph, pipeline, choice)
    return replace(
        plan,
        axes=axes,
        derived=derived,
        nodes=nodes,
        cells=cells,
        precision=chosen,
        leaves_out=not exact and plan.leaves_out,
        digits=choice.digits,
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


def at_point(plan: Plan, place: AxisValues, wanted: tuple[StageVariable, ...]) -> Plan:
    """Return the plan of ``wanted`` at one point, with means instead of draws and rounding."""
    at = plan.everywhere({axis.dim: axis.values.index(place[axis.dim]) for axis in plan.axes})
    factors = dict[str, int]()
    for axis in (axis for axis in plan.axes if axis.rows):
        factors |= dict(zip((one.dim for one in axis.factors), axis.rows[at[axis.dim]], strict=True))
    cells = [_at_origin(plan.cells[node.name, tuple(at[dim] for dim in node.axes)]) for node in plan.nodes]
    return replace(
        plan,
        axes=tuple(_narrowed(axis, at[axis.dim]) for axis in plan.axes),
        derived=tuple(_narrowed(axis, at[axis.dim]) for axis in plan.derived),
        nodes=tuple(_chosen(node, at | factors) for node in plan.nodes),
        cells={cell.ref: cell for cell in cells},
        wanted=wanted,
        kept=frozenset(),
        copied=frozenset(),
        expected=True,
    )


def with_draw(plan: Plan, number: int) -> Plan:
    """Return the plan with random draws of the noise; each number gives another draw."""
    more = f"\ndraw={number}".encode()
    cells = {ref: cell.changed(seed=cell.seed + more) if cell.seed else cell for ref, cell in plan.cells.items()}
    return replace(plan, cells=cells, expected=False)


def _narrowed(axis: Axis, number: int) -> Axis:
    gives = {name: (values[number],) for name, values in axis.gives.items()}
    rows = axis.rows[number : number + 1]
    return replace(axis, values=(axis.values[number],), gives=gives, rows=rows, places=(0,) if axis.of else ())


def _chosen(node: Node, at: Mapping[str, int]) -> Node:
    """Return a node with the one alternative that it uses."""
    if len(node.alternatives) == 1:
        return node
    number = at[node.use_axis] if node.use_axis else 0
    return replace(node, alternatives=(node.alternatives[number],), inputs=(node.inputs[number],))


def _at_origin(cell: Cell) -> Cell:
    """Return a cell at the first position of all its axes, and at the first position of the axes of the cells it reads;
    a cell never reads two positions of one stage.
    """
    before = cell.segment_input
    return cell.changed(
        ref=_first(cell.ref),
        inputs=tuple((port, _first(ref), variable) for port, ref, variable in cell.inputs),
        looks_at=tuple((port, tuple(map(_first, refs))) for port, refs in cell.looks_at),
        open_words=tuple(replace(word, ref=_first(word.ref)) for word in cell.open_words),
        segment_input=before and (_first(before[0]), before[1]),
    )


def _first(ref: CellRef) -> CellRef:
    return ref[0], (0,) * len(ref[1])
