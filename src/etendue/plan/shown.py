"""Choose the cells of a sweep to show: one of each stage, for pictures and headline metrics."""

from __future__ import annotations

from collections.abc import Mapping

from etendue.contract.arrays.variables import Declaration, variable
from etendue.plan.model import Axis, CellRef, Plan, StageVariable
from etendue.types.documents import AxisValues


def shown_cells(plan: Plan) -> dict[str, CellRef]:
    """Return one cell of each stage for the pictures: at the pipeline's own values of swept quantities, else at the
    middle of the axis.
    """
    middle = plan.everywhere({axis.dim: middle_of(plan, axis) for axis in plan.axes})
    computed = (node for node in plan.nodes if node.name not in plan.seen_only)
    return {node.name: (node.name, tuple(middle[dim] for dim in node.axes)) for node in computed}


def middle_of(plan: Plan, axis: Axis) -> int:
    """Return the position of the pipeline's own value on an axis, or the middle if the axis lacks this value."""
    base, value = plan.pipeline.shared.get(axis.key), plan.shared.get(axis.key)
    return axis.values.index(value) if base is not None and value in axis.values else len(axis.values) // 2


def shown_place(plan: Plan) -> AxisValues:
    """Return the axis values of the shown cells, by dim."""
    shown = {axis.dim: 0 for axis in plan.axes}
    for name, index in shown_cells(plan).values():
        shown |= dict(zip(plan.node(name).axes, index, strict=True))
    shown |= {one.of: middle_of(plan, plan.axis(one.of)) for one in plan.derived}
    return {axis.dim: axis.values[shown[axis.dim]] for axis in plan.axes}


def where_shown(plan: Plan, shown: Mapping[str, CellRef] | None = None) -> str:
    """Return the axis values of the shown cells, such as `` at gain 2.8, pitch 4 um``; '' without a sweep."""
    at = {}
    for name, index in (shown or shown_cells(plan)).values():
        at.update({dim: value for dim, value in plan.labels((name, index)).items()})
    texts = []
    for axis in plan.axes:
        if axis.dim in at:
            value = at[axis.dim]
            said = f"{value:.4g}" if isinstance(value, float) else str(value)
            texts.append(f"{axis.key} {said}{f' {axis.units}' if axis.units not in ('', '1') else ''}")
    return f" at {', '.join(texts)}" if texts else ""


def is_headline(name: str, declaration: Declaration) -> bool:
    """Return whether a variable may be a headline metric: one number, or one per stage, that is not only a count."""
    about = variable(name)
    return declaration.dims in ((), ("stage",)) and not about.quiet and not about.counted


def answers(plan: Plan) -> tuple[StageVariable, ...]:
    """Return the variables whose values a run reports: the wanted variables, and metrics that are computed on the way
    to them.
    """
    computed = (node for node in plan.nodes if node.name not in plan.seen_only)
    found = [(node.name, v) for node in computed for v, declared in node.writes.items() if is_headline(v, declared)]
    return (*plan.wanted, *(one for one in found if one not in plan.wanted))
