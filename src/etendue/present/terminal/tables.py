"""Tables: the ledger (a row per cell), the summary (a row per stage), and what is printed at the end of a run.

In:  a plan and the reports of its cells.
Out: columns as plain lists with dims and attributes; text for a terminal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from etendue.contract.variables import variable
from etendue.contract.wording import first
from etendue.plan import omissions
from etendue.plan.marks import not_in_it
from etendue.plan.model import Axis, Cell, CellRef, Plan
from etendue.plan.reports import DONE, FAILED, LEFT_OUT, NOTHING, REUSED, SKIPPED, STATUSES, Reports
from etendue.types.arrays import Array
from etendue.types.documents import Document

Table = dict[str, Any]


class Column:
    """A column of a table that is made when it is asked for as an array: all of a large one at once would take more
    than the plan.
    """

    def __init__(self, make: Callable[[], list[Any]], dtype: Any) -> None:
        self.make, self.dtype = make, dtype

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.make(), dtype=dtype or self.dtype)


def ledger(plan: Plan, reports: Reports) -> Table:
    """One row per cell: stage, axes (missing where they do not reach), seconds, error and how it is known, key."""
    cells, nodes = plan.cells, {node.name: node for node in plan.nodes}
    arrays: dict[str, Any] = {}

    def put(name: str, long_name: str, of: Callable[[Cell], float | str], units: str = "") -> None:
        """Of every cell a text, or a number where there are units."""
        _put(arrays, name, long_name, lambda: [of(cell) for cell in cells.values()], units)

    def put_report(name: str, long_name: str, of: Callable[[int], Any], units: str = "") -> None:
        """The same of what has become of a cell, by its number."""
        nothing = math.nan if units else ""
        _put(
            arrays,
            name,
            long_name,
            lambda: [of(n) if status else nothing for n, status in enumerate(reports.status)],
            units,
        )

    def rest(place: int) -> Callable[[int], Any]:
        return lambda number: reports.rest.get(number, NOTHING)[place]

    alike: dict[tuple[Any, ...], float] = {}

    def saved(cell: Cell) -> float:
        if not (cell.left_out or cell.approximated):
            return 0.0
        place = (
            cell.node,
            id(cell.stage),
            id(cell.grids),
            id(cell.input_grids),
            cell.left_out is None,
            cell.approximated,
        )
        if place not in alike:
            found = omissions.saved(nodes[cell.node], cell, plan.precision)
            alike[place] = math.nan if found is None else found
        return alike[place]

    put("stage", "stage", lambda c: c.node)
    put("use", "implementation", lambda c: c.use)
    for axis in plan.axes:
        # named beside the dims of the other groups, not after them: here it is a column
        arrays[f"at_{axis.dim}"] = (("cell",), _at(plan, axis), {"long_name": axis.key, "units": axis.units or "1"})
    _put(
        arrays, "status", "what became of the cell", lambda: [STATUSES[one] or "not_computed" for one in reports.status]
    )
    put_report("seconds", "thread time", reports.seconds.__getitem__, "s")
    put(
        "error",
        "error of the stage, relative to full scale",
        lambda c: math.nan if c.error[0] is None else c.error[0],
        "1",
    )
    put("how", "how the error is known", lambda c: c.error[1])
    put(
        "bound",
        "what leaving out and approximating may add to what the cell writes, relative to full scale",
        lambda c: c.bound,
        "1",
    )
    put(
        "approximated",
        "knobs that the plan has set",
        lambda c: ", ".join(f"{a.knob} = {a.value}" for a in c.approximated),
    )
    put("seconds_saved", "thread time that leaving out and approximating is expected to save", saved, "s")
    put("why_left_out", "why", lambda c: c.left_out.why if c.left_out else "")
    put_report("clipped", "share of negative input clipped", rest(0), "1")
    put_report("clipped_flux", "share of flux in it", rest(1), "1")
    earlier = "an earlier platform, on which it was computed, and accepted; empty: that of the record of the run"
    put_report("platform", earlier, rest(3))
    put("key", "equal key, equal result", lambda c: c.key)
    put_report("message", "what went wrong", rest(4))
    return {"arrays": arrays, "attrs": {"title": "one row per cell: error against run time is a selection from it"}}


def _put(arrays: dict[str, Any], name: str, long_name: str, make: Callable[[], list[Any]], units: str = "") -> None:
    attrs = {"units": units, "long_name": long_name} if units else {"long_name": long_name}
    arrays[name] = (("cell",), Column(make, float if units else object), attrs)


def _at(plan: Plan, axis: Axis) -> Column:
    """Where each cell stands on an axis; nothing of a cell that it does not reach."""
    text = any(isinstance(v, str) for v in axis.values)
    place = {node.name: node.axes.index(axis.dim) for node in plan.nodes if axis.dim in node.axes}
    nothing: Any = "" if text else math.nan
    return Column(
        lambda: [axis.values[index[place[node]]] if node in place else nothing for node, index in plan.cells],
        object if text else float,
    )


def stage_rows(plan: Plan, reports: Reports) -> list[Document]:
    """One row per stage: cells computed, reused, left out and failed, seconds, share, worst error."""
    rows = []
    took = {node.name: reports.seconds_of(node.name) for node in plan.nodes}
    total = reports.seconds_of() or 1.0
    for node in plan.nodes:
        cells, seconds = plan.of(node.name), took[node.name]
        errors = [c.error[0] for c in cells if c.error[0] is not None]
        how = next((c.error[1] for c in cells), "unknown")
        rows.append(
            {
                "name": node.name,
                "use": node.alternatives[0].use if len(node.alternatives) == 1 else [a.use for a in node.alternatives],
                "distribution": node.alternatives[0].distribution,
                "axes": [plan.axis(d).key for d in node.axes],
                "cells": len(cells),
                "computed": reports.count(DONE, LEFT_OUT, stage=node.name),
                "reused": reports.count(REUSED, stage=node.name),
                "failed": reports.count(FAILED, SKIPPED, stage=node.name),
                "left_out": omissions.left_out(node, cells, plan.precision),
                "approximated": omissions.approximated(node, cells, plan.precision),
                "seconds": seconds,
                "share": seconds / total,
                "error": max(errors) if errors else None,
                "how": how,
                "bytes": reports.bytes_of(node.name),
            }
        )
    return rows


def summary(plan: Plan, reports: Reports) -> Table:
    """The same as a group of the archive."""
    rows = stage_rows(plan, reports)
    dims = ("stage",)
    arrays = {
        "stage": (dims, np.array([r["name"] for r in rows], dtype=object), {"long_name": "stage"}),
        "cells": (dims, np.array([r["cells"] for r in rows]), {"units": "1", "long_name": "cells"}),
        "seconds": (dims, np.array([r["seconds"] for r in rows]), {"units": "s", "long_name": "thread time"}),
        "bytes": (dims, np.array([r["bytes"] for r in rows]), {"units": "byte", "long_name": "stored"}),
        "worst_error": (
            dims,
            np.array([math.nan if r["error"] is None else r["error"] for r in rows]),
            {"units": "1", "long_name": "worst error"},
        ),
        "left_out": (
            dims,
            np.array([r["left_out"]["cells"] if r["left_out"] else 0 for r in rows]),
            {"units": "1", "long_name": "cells left out"},
        ),
    }
    return {"arrays": arrays, "attrs": {"title": "one row per stage"}}


def floored(plan: Plan, reports: Reports, counted: str = "floored") -> list[str]:
    """A sentence for each stage with a variable that counts what was lifted to a floor, or lies above saturation,
    and is above 0.
    """
    texts = []
    for node in plan.nodes:
        if not any(variable(v).counted == counted for v in node.writes):
            continue
        counts = reports.counted(node.name)
        if counts:
            what = " and ".join(variable(v).long_name for v in node.writes if variable(v).counted == counted)
            texts.append(
                f"{node.name} has {what}: in {len(counts)} of {len(plan.of(node.name))} cells, at most {max(counts):g} "
                f"in a cell"
            )
    return texts


def headlines(
    plan: Plan, arrays: Mapping[CellRef, Mapping[str, Array]]
) -> list[tuple[str, float, str, tuple[str, ...]]]:
    """Up to three figures of the shown cells: what goes first, then any other scalar; with their name, value and
    unit the stages that are not in them."""
    preferred = first("headline")
    found: dict[str, tuple[str, float, str, tuple[str, ...]]] = {}
    for ref, values in arrays.items():
        node = plan.node(ref[0])
        for name, array in values.items():
            declaration = node.writes[name]
            if (
                declaration.dims in ((), ("stage",))
                and np.size(array)
                and not variable(name).quiet
                and not variable(name).counted
            ):
                value = float(np.ravel(array)[-1])
                at = ""
                if declaration.dims:
                    at = f" at {plan.cells[ref].grids[name]['stage'].values()[-1]}"
                if math.isfinite(value):
                    found[name] = (f"{name}{at}", value, declaration.unit, not_in_it(plan, node, name))
    ordered = [found[n] for n in preferred if n in found] + [v for n, v in found.items() if n not in preferred]
    return ordered[:3]
