"""What of a plan is left to do, given what an archive holds.

In:  a plan, the axis values an archive has, the cells that are finished.
Out: the plan over all those values, and the cells to compute (``Work``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from etendue.contract.registry import installed_stages
from etendue.contract.stage import looks_at_stages
from etendue.contract.tables import preset_keys
from etendue.errors import RequestError
from etendue.plan import planner
from etendue.plan.model import CellRef, Plan
from etendue.types.documents import AxisValue, DocumentView


@dataclass
class Work:
    """What is left to do of what was asked for.

    ``plan`` is over the axis values of earlier runs as well; ``cells`` has each cell of what was asked for in it.
    """

    plan: Plan
    cells: Mapping[CellRef, CellRef]
    todo: set[CellRef]
    reused: set[CellRef] = field(default_factory=set)
    reasons: dict[str, str] = field(default_factory=dict)  # by stage: why it is computed again
    removed: int = 0  # cells of earlier runs, at other axis values, that would come out differently now
    pruned: int = 0  # finished cells removed because it was asked for
    stay: list[str] = field(default_factory=list)  # stages stored earlier and right, though 'keep' no longer names them
    mended: list[str] = field(
        default_factory=list
    )  # files of the archive that were missing or damaged, and are written again
    moved: dict[str, int] = field(
        default_factory=dict
    )  # shards made anew, bytes copied for them, bytes of what was computed
    shown: Mapping[str, CellRef] = field(
        default_factory=dict
    )  # of each stage the cell of the pictures, where it is not the usual one


# values looked at to find the possible ones among those of earlier runs; a plan counts as PLANNED of them
MOST_WORK = 10_000_000
PLANNED = 5_000


def with_stored_values(
    plan: Plan, stored: Mapping[str, Mapping[str, list[AxisValue]]], sweeps: Sequence[DocumentView] = ()
) -> Plan:
    """The plan over the axis values of an archive's earlier runs as well: what is still right there stays.

    ``sweeps`` of earlier runs, as they stood in their files, say what a label of a swapped stage means.
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
    if whole is None:  # a value that is no longer possible: its cells are not of this pipeline any more
        extra = {key: _possible(plan, key, values, stored) for key, values in extra.items()}
        whole = _over(plan, {key: values for key, values in extra.items() if values}, stored)
    return whole or plan


def _possible(
    plan: Plan, key: str, values: list[AxisValue], stored: Mapping[str, Mapping[str, list[AxisValue]]]
) -> list[AxisValue]:
    """Those of the values over which there is a plan, found by halves: few values that are not cost few plans.

    A journal that names millions is not gone through to the end: what nobody has come to stays out.
    """
    known = sum(len(own) for axes in stored.values() for own in axes.values())
    found, left, work = list[Any](), [values], 0
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
    """The plan with further axis values, in stored order; None where it is impossible."""
    sweep = dict(plan.pipeline.sweep)
    for axis in plan.axes:
        if axis.key not in extra:
            continue
        if is_of_names(axis.key):
            sweep[axis.key] = [*sweep[axis.key], *extra[axis.key]]
        else:
            known = {v for axes in stored.values() for v in axes.get(axis.dim, ())}
            order = dict.fromkeys(v for axes in stored.values() for v in axes.get(axis.dim, ()))
            own = {*axis.values, *extra[axis.key]}
            sweep[axis.key] = [*(v for v in order if v in own), *(v for v in axis.values if v not in known)]
    try:
        return planner.make_plan(replace(plan.pipeline, sweep=sweep), installed_stages(), plan.leaves_out)
    except RequestError:
        return None


def is_of_names(key: str) -> bool:
    """Whether the values of an axis are names, of stages or presets: their tables say what they stand for."""
    return key.endswith(".use") or key in preset_keys()


def _table(key: str, label: Any, sweeps: Sequence[DocumentView]) -> Any:
    """What stood for a label of a swapped stage in the newest sweep that had it."""
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
    """The cells to compute: unfinished requested ones, and finished ones whose unstored result an unfinished one
    reads.
    """
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
        todo |= {word.ref for word in cell.open_words if (word.ref[0], word.variable) not in plan.kept}
        for port, what, _ in node.looks_at:
            if not looks_at_stages(what):
                todo |= {s for s in dict(cell.looks_at).get(port, ()) if (s[0], what) not in plan.kept}
    return todo


def _need_segment(plan: Plan, source: CellRef, todo: set[CellRef]) -> None:
    """A transform is rebuilt from its segment's input, which must be stored or computed."""
    segment_input = plan.cells[source].segment_input
    assert segment_input is not None
    (node, index), variable = segment_input
    if (node, variable) not in plan.kept:
        todo.add((node, index))
