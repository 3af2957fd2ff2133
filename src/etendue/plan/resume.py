"""Find the cells of a plan that remain to be computed, given the content of an archive.

In:  a plan, the axis values in an archive, the finished cells.
Out: the plan over all those values, and the cells to compute (``Work``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from etendue.contract.registry import installed_stages
from etendue.contract.stage import looks_at_stages
from etendue.contract.values.tables import preset_keys
from etendue.errors import RequestError
from etendue.pipeline.derived import with_rows
from etendue.plan import planner
from etendue.plan.model import Axis, CellRef, Plan
from etendue.types.documents import AxisValue, DocumentView


@dataclass
class Work:
    """The remaining work of a request.

    ``plan`` also covers the axis values of earlier runs; ``cells`` maps each requested cell to its cell in ``plan``.
    """

    plan: Plan
    cells: Mapping[CellRef, CellRef]
    todo: set[CellRef]
    reused: set[CellRef] = field(default_factory=set)
    reasons: dict[str, str] = field(default_factory=dict)  # by stage: why it is computed again
    removed: int = 0  # cells of earlier runs at other axis values whose results are outdated
    pruned: int = 0  # finished cells removed on request
    # stages stored earlier and still valid, although 'keep' no longer names them
    stay: list[str] = field(default_factory=list)
    # files of the archive that were missing or damaged and are written again
    mended: list[str] = field(default_factory=list)
    # shards rewritten, bytes copied for them, bytes of computed results
    moved: dict[str, int] = field(default_factory=dict)
    # by stage: the cell shown as a picture, if not the usual one
    shown: Mapping[str, CellRef] = field(default_factory=dict)


# Limit on the values examined to find the valid ones among those of earlier runs; one plan counts as PLANNED values.
MOST_WORK = 10_000_000
PLANNED = 5_000


def with_stored_values(
    plan: Plan, stored: Mapping[str, Mapping[str, list[AxisValue]]], sweeps: Sequence[DocumentView] = ()
) -> Plan:
    """Return the plan extended to the axis values of an archive's earlier runs, so that valid results at these values
    are kept.

    ``sweeps`` of earlier runs, as written in their files, give the meaning of the label of a swapped stage.
    """
    extra: dict[str, list[AxisValue]] = {}
    for axis in plan.axes:
        earlier = dict.fromkeys(v for axes in stored.values() for v in axes.get(axis.dim, ()) if v not in axis.values)
        if is_of_names(axis.key):
            found = [_table(axis.key, label, sweeps) for label in earlier]
            earlier = {}
            extra[axis.key] = [table for table in found if table is not None]
        if earlier:
            extra[axis.key] = list(earlier)
    extra = {key: values for key, values in extra.items() if values}
    if not extra:
        return plan
    whole = _over(plan, extra, stored)
    if whole is None:  # some value is no longer valid; the cells at such values do not belong to this pipeline any more
        extra = {key: _possible(plan, key, values, stored) for key, values in extra.items()}
        whole = _over(plan, {key: values for key, values in extra.items() if values}, stored)
    return whole or plan


def _possible(
    plan: Plan, key: str, values: list[AxisValue], stored: Mapping[str, Mapping[str, list[AxisValue]]]
) -> list[AxisValue]:
    """Return the axis values with which the pipeline can be planned. Bisection finds them with few plans if few are
    invalid.

    The work is limited, so that a journal naming millions of values cannot stall a run; values that are not examined
    are dropped.
    """
    known = sum(len(own) for axes in stored.values() for own in axes.values())
    found, left, work = list[AxisValue](), [values], 0
    while left and work < MOST_WORK:
        part = left.pop()
        work += PLANNED + known + len(part)
        if _over(plan, {key: part}, stored):
            found += part
        elif len(part) > 1:
            left += [part[len(part) // 2 :], part[: len(part) // 2]]
    return found


def _over(
    plan: Plan, extra: Mapping[str, list[AxisValue]], stored: Mapping[str, Mapping[str, list[AxisValue]]]
) -> Plan | None:
    """Return the plan with further axis values, in stored order; None if it is invalid."""
    pipeline, sweep = plan.pipeline, dict(plan.pipeline.sweep)
    for axis in plan.axes:
        if axis.key not in extra:
            continue
        if axis.rows:
            pipeline = with_rows(pipeline, axis.dim, _rows(axis, extra[axis.key], stored))
            continue
        if is_of_names(axis.key):
            sweep[axis.key] = [*sweep[axis.key], *extra[axis.key]]
        else:
            known = {v for axes in stored.values() for v in axes.get(axis.dim, ())}
            order = dict.fromkeys(v for axes in stored.values() for v in axes.get(axis.dim, ()))
            own = {*axis.values, *extra[axis.key]}
            sweep[axis.key] = [*(v for v in order if v in own), *(v for v in axis.values if v not in known)]
    try:
        return planner.make_plan(replace(pipeline, sweep=sweep), installed_stages(), plan.leaves_out)
    except RequestError:
        return None


def _rows(axis: Axis, extra: Sequence[AxisValue], stored: Mapping[str, Mapping[str, list[AxisValue]]]) -> list[int]:
    """Return the rows of a design in stored order, then the new rows."""
    there = [row for axes in stored.values() for row in axes.get(axis.dim, ()) if isinstance(row, int)]
    wanted = {*axis.values, *extra}
    return list(dict.fromkeys([*(row for row in there if row in wanted), *axis.values]))


def is_of_names(key: str) -> bool:
    """Return whether the values of an axis are names, of stages or presets, that a table explains."""
    return key.endswith(".use") or key in preset_keys()


def _table(key: str, label: AxisValue, sweeps: Sequence[DocumentView]) -> Any:
    """Return the definition of a label of a swapped stage from the newest sweep that contains it."""
    for sweep in sweeps:
        values = sweep.get(key)
        for one in values if isinstance(values, list) else ():
            if label == (
                one.get("label", one.get("use", next((one[key] for key in preset_keys() if key in one), None)))
                if isinstance(one, dict)
                else one
            ):
                return one
    return None


def select(plan: Plan, finished: set[CellRef], requested: set[CellRef] | None = None) -> set[CellRef]:
    """Return the cells to compute: requested cells that are unfinished, and finished cells whose result was not stored
    and is read by a cell to compute.
    """
    todo = {ref for ref in (plan.cells if requested is None else requested) if ref not in finished}
    nodes = {node.name: node for node in plan.nodes}
    read: set[CellRef] = set()  # cells whose arrays a cell to compute reads
    # In reverse, since cells come after those they read: each source is added before the loop reaches it.
    for ref in reversed(list(plan.cells)):
        if ref not in todo:
            continue
        cell, node = plan.cells[ref], nodes[ref[0]]
        for number, (_, source, variable) in enumerate(cell.inputs):
            # A cell that is left out passes on the array of its input, if anybody reads or stores it.
            passes = cell.left_out is not None and (ref in read or (ref[0], variable) in plan.with_arrays)
            if len(node.segment) > 1 and number == 0 and not passes:
                _need_segment(plan, source, todo)
                continue
            read.add(source)
            if (source[0], variable) not in plan.kept:
                todo.add(source)
        todo |= {word.ref for word in cell.open_words if (word.ref[0], word.variable) not in plan.kept}
        for port, what, _ in node.looks_at:
            if not looks_at_stages(what):
                read.update(dict(cell.looks_at).get(port, ()))
                todo |= {s for s in dict(cell.looks_at).get(port, ()) if (s[0], what) not in plan.kept}
    return todo


def _need_segment(plan: Plan, source: CellRef, todo: set[CellRef]) -> None:
    """Add the cells needed to compute a transform again: all cells up to the input of its segment, unless this input is
    stored.
    """
    segment_input = plan.cells[source].segment_input
    assert segment_input is not None
    (node, index), variable = segment_input
    if (node, variable) not in plan.kept:
        todo.add((node, index))
