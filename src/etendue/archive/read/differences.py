"""Compare two archives: the cells that differ, the size of the difference, and the parameter, code or input that caused
it.

In:  the folders of two archives.
Out: a ``StageDifference`` for every stage of either archive.

Cells are matched by stage and axis values. An axis that only one archive has is matched at the value that the parameter
has in the other archive. Cells whose stored bytes have the same size and digest are not read.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from etendue.archive.read.differing import Difference, between, together
from etendue.archive.read.stored import Stored, StoredArrays
from etendue.archive.records.past_runs import latest_record
from etendue.archive.records.provenance import node_changes
from etendue.errors import ArchiveError
from etendue.types.documents import AxisValue, Document, DocumentView

_LABEL = re.compile(r""" ([^ =]+)=('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|\S+)""")
StageAndValues = tuple[str, frozenset[tuple[str, Any]]]  # a stage, and axis values by dim
WORST = 5  # cells of a stage that are listed


@dataclass(frozen=True)
class CellDifference:
    """One variable of one cell that differs between the archives."""

    cell: str
    variable: str
    difference: Difference


@dataclass
class StageDifference:
    """The comparison of one stage in two archives.

    Attributes
    ----------
    cells : number of cells that both archives have
    same : number of these cells that have equal arrays
    since : the cause: a change of the stage itself, or an input that differs; '' if the records show no change
    """

    name: str
    cells: int = 0
    same: int = 0
    only_first: list[str] = field(default_factory=list)
    only_second: list[str] = field(default_factory=list)
    differing: list[CellDifference] = field(default_factory=list)
    since: str = ""

    @property
    def equal(self) -> bool:
        return not (self.only_first or self.only_second or self.differing)


class _Side:
    """One of the two archives."""

    def __init__(self, folder: Path) -> None:
        self.stored = Stored(folder)
        record = latest_record(folder)
        if record is None:
            raise ArchiveError(f"{folder} has no readable record of a run; check it with: etendue verify {folder}")
        self.record: Document = record
        self.cells: dict[str, tuple[str, dict[str, AxisValue]]] = {name: _labels(name) for name in self.stored.finished}
        self.keys = {re.sub(r"\.use$", "", key).replace(".", "_"): key for key in record["axes"]}
        self.dims: dict[str, set[str]] = {}
        for stage, labels in self.cells.values():
            self.dims.setdefault(stage, set()).update(labels)

    def fixed(self, dim: str, key: str) -> Any:
        """Return the fixed value of a parameter that the other archive sweeps; None if unknown."""
        stage, _, name = key.rpartition(".")
        if dim in self.keys:
            return None
        if not stage:
            return self.record["shared"].get(name)
        node = self.record["nodes"].get(stage, {})
        return (node.get("stage") or [None])[0] if name == "use" else node.get("shown", {}).get(name)

    def places(self, other: _Side) -> dict[StageAndValues, str]:
        """Return the names of the finished cells by stage and values on the axes of both archives. On an axis that only
        the other archive has, a cell is at the value that is fixed in this archive.
        """
        found = {}
        for name, (stage, labels) in self.cells.items():
            more = other.dims.get(stage, set()) - self.dims[stage]
            filled = {dim: self.fixed(dim, other.keys.get(dim, dim)) for dim in more}
            found[stage, frozenset((dim, _plain(value)) for dim, value in {**labels, **filled}.items())] = name
        return found


def _labels(name: str) -> tuple[str, Document]:
    """Return stage and axis values from the name of a cell."""
    stage = name.split(" ")[0]
    labels = {}
    for dim, text in _LABEL.findall(name[len(stage) :]):
        try:
            labels[dim] = ast.literal_eval(text)
        except (ValueError, SyntaxError):
            labels[dim] = text
    return stage, labels


def _plain(value: Any) -> Any:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def differences(
    first: Path, second: Path, told: Callable[[int, int], None] = lambda done, total: None
) -> list[StageDifference]:
    """Return the differences by stage, in the order of the first archive; ``told`` is called with the number of
    finished cells and the total.

    Raises
    ------
    ArchiveError
        One of the folders is not an archive, or has no readable record.
    """
    one, other = _Side(first), _Side(second)
    mine, theirs = one.places(other), other.places(one)
    order = dict.fromkeys(
        [*one.record.get("order", ()), *other.record.get("order", ()), *(stage for stage, _ in (*mine, *theirs))]
    )
    found = {stage: StageDifference(stage) for stage in order}
    for number, (place, name) in enumerate(mine.items()):
        told(number, len(mine))
        own = found[place[0]]
        twin = theirs.get(place)
        if twin is None:
            own.only_first.append(name)
            continue
        own.cells += 1
        off = _cells(one.stored, name, other.stored, twin)
        own.differing += off
        own.same += not off
    for place, name in theirs.items():
        if place not in mine:
            found[place[0]].only_second.append(name)
    since = node_changes(
        *(_unswept(side.record["nodes"], {*one.keys.values(), *other.keys.values()}) for side in (one, other))
    )
    for stage, own in found.items():
        own.since = since.get(stage, "")
        if own.differing and not own.since:
            own.since = _elsewhere(one.record, other.record)
    return list(found.values())


def _unswept(nodes: DocumentView, axes: set[str]) -> Document:
    """Return the records of stages without the parameters that either archive sweeps: cells are matched by the values
    of these parameters.
    """
    return {
        name: {
            **node,
            "parameters": {k: v for k, v in node["parameters"].items() if k not in axes and f"{name}.{k}" not in axes},
        }
        for name, node in nodes.items()
    }


def _elsewhere(one: DocumentView, other: DocumentView) -> str:
    changed = [
        f"{k} {v} -> {other['platform'].get(k)}" for k, v in one["platform"].items() if other["platform"].get(k) != v
    ]
    return f"the platform: {', '.join(changed)}" if changed else ""


def _cells(one: Stored, name: str, other: Stored, twin: str) -> list[CellDifference]:
    """Return the variables of a cell that differ; variables that only one archive keeps are ignored."""
    mine, theirs, found = one.cell(name), other.cell(twin), list[CellDifference]()
    if mine.digested and theirs.digested and _bytes(mine) == _bytes(theirs):
        return []
    for variable in mine.variables:
        if variable not in theirs.variables:
            continue
        try:
            if mine.windows(variable) == theirs.windows(variable):
                pairs = zip(mine.parts(variable), theirs.parts(variable), strict=True)
                off = together(between(part, other_part) for (_, part), (_, other_part) in pairs)
            else:
                off = between(mine.read(variable), theirs.read(variable))
        except ArchiveError as error:
            off = Difference(False, str(error))
        if not off.same:
            found.append(CellDifference(name, variable, off))
    return found


def _bytes(cell: StoredArrays) -> list[tuple[Any, ...]]:
    """Return the recorded sizes and digests of a cell."""
    return [
        (c.variable, c.window, c.form.dtype, c.form.shape, c.form.codec, c.written.size, c.written.digest)
        for c, _ in cell.chunks
    ]


def document(first: Path, second: Path, found: list[StageDifference]) -> Document:
    """Return the comparison as the document that ``--json`` prints."""
    return {
        "first": str(first),
        "second": str(second),
        "equal": all(stage.equal for stage in found),
        "only": {
            "first": _alone([n for s in found for n in s.only_first], [n for s in found for n in s.only_second]),
            "second": _alone([n for s in found for n in s.only_second], [n for s in found for n in s.only_first]),
        },
        "stages": [_stage(stage) for stage in found],
    }


def _alone(names: list[str], others: list[str]) -> Document:
    """Return the number of cells that only one archive has, and the axis values that occur only in these cells."""
    own, there = ({(d, _plain(v)) for n in some for d, v in _labels(n)[1].items()} for some in (names, others))
    values: dict[str, list[Any]] = {}
    for dim, value in sorted(own - there, key=str):
        values.setdefault(dim, []).append(value)
    return {"cells": len(names), "values": values}


def _stage(found: StageDifference) -> Document:
    known = [one for one in found.differing if not one.difference.why]
    return {
        "name": found.name,
        "cells": found.cells,
        "same": found.same,
        "differing": found.cells - found.same,
        "only_first": len(found.only_first),
        "only_second": len(found.only_second),
        "since": found.since or None,
        "largest": max((one.difference.largest for one in known), default=None),
        "rms": max((one.difference.rms for one in known), default=None),
        "relative": max((_size(one) for one in known), default=None),
        "worst": [_shown(one) for one in sorted(found.differing, key=_size, reverse=True)[:WORST]],
        "named": {"only_first": found.only_first[:WORST], "only_second": found.only_second[:WORST]},
    }


def _size(one: CellDifference) -> float:
    return float("inf") if one.difference.relative is None else one.difference.relative


def _shown(one: CellDifference) -> Document:
    own = one.difference
    if own.why:
        return {"cell": one.cell, "variable": one.variable, "why": own.why}
    return {
        "cell": one.cell,
        "variable": one.variable,
        "values": own.values,
        "differing": own.differing,
        "undefined": own.undefined,
        "largest": own.largest,
        "rms": own.rms,
        "full_scale": own.scale,
        "relative": own.relative,
    }
