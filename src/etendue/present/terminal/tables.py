"""Tables: the ledger (a row per cell), the summary (a row per stage), and the lines printed at the end of a run.

In:  a plan and the reports of its cells.
Out: columns as plain lists with dims and attributes; text for a terminal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from etendue.contract.arrays.variables import variable
from etendue.contract.wording import first
from etendue.plan import omissions
from etendue.plan.identity.once import Once
from etendue.plan.marks import not_in_it
from etendue.plan.model import Axis, Cell, CellRef, Plan
from etendue.plan.reports import DONE, FAILED, LEFT_OUT, NOTHING, REUSED, SKIPPED, STATUSES, Reports
from etendue.plan.shown import is_headline
from etendue.types.arrays import Array
from etendue.types.documents import Document


class Column:
    """A table column that is built only when it is converted to an array: all columns of a large table together would
    take more memory than the plan.
    """

    def __init__(self, make: Callable[[], list[Any]], dtype: Any) -> None:
        self.make, self.dtype = make, dtype

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.make(), dtype=dtype or self.dtype)


def ledger(plan: Plan, reports: Reports) -> Document:
    """Return a table with one row per cell: stage, axis values (missing if an axis does not affect the stage), seconds,
    error and its basis, key.
    """
    cells, nodes = plan.cells, {node.name: node for node in plan.nodes}
    arrays: Document = {}

    def put(name: str, long_name: str, of: Callable[[Cell], float | str], units: str = "") -> None:
        """Add a column computed from each cell: numbers if ``units`` is given, else text."""
        _put(arrays, name, long_name, lambda: [of(cell) for cell in cells.values()], units)

    def put_report(name: str, long_name: str, of: Callable[[int], Any], units: str = "") -> None:
        """Add a column computed from the report of each cell; ``of`` gets the number of the cell."""
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

    alike: Once[float | None] = Once()

    def saved(cell: Cell) -> float:
        if not (cell.left_out or cell.approximated):
            return 0.0
        found = alike(
            (cell.stage, cell.grids, cell.input_grids),
            lambda: omissions.saved(nodes[cell.node], cell, plan.precision),
            cell.node,
            cell.left_out is None,
            cell.approximated,
        )
        return math.nan if found is None else found

    put("stage", "stage", lambda c: c.node)
    put("use", "implementation", lambda c: c.use)
    for axis in plan.positioned:
        # prefixed at_, because here an axis value is a column, not a dimension as in the other groups
        arrays[f"at_{axis.dim}"] = (("cell",), _at(plan, axis), {"long_name": axis.key, "units": axis.units or "1"})
    _put(arrays, "status", "status of the cell", lambda: [STATUSES[one] or "not_computed" for one in reports.status])
    put_report("seconds", "thread time", reports.seconds.__getitem__, "s")
    put(
        "error",
        "error of the stage, relative to full scale",
        lambda c: math.nan if c.error[0] is None else c.error[0],
        "1",
    )
    put("how", "basis of the error", lambda c: c.error[1])
    put(
        "bound",
        "error bound of omissions and approximations in the cell's output, relative to full scale",
        lambda c: c.bound,
        "1",
    )
    put(
        "approximated",
        "knobs set by the plan",
        lambda c: ", ".join(f"{a.knob} = {a.value}" for a in c.approximated),
    )
    put("seconds_saved", "expected thread time saved by omissions and approximations", saved, "s")
    put("why_left_out", "reason for leaving out", lambda c: c.left_out.why if c.left_out else "")
    put_report("clipped", "share of negative input clipped", rest(0), "1")
    put_report("clipped_flux", "share of flux clipped", rest(1), "1")
    earlier = "earlier platform on which the cell was computed, if accepted; empty: platform of the run record"
    put_report("platform", earlier, rest(3))
    put("key", "equal key, equal result", lambda c: c.key)
    put_report("message", "error message", rest(4))
    return {"arrays": arrays, "attrs": {"title": "one row per cell"}}


def _put(arrays: Document, name: str, long_name: str, make: Callable[[], list[Any]], units: str = "") -> None:
    attrs = {"units": units, "long_name": long_name} if units else {"long_name": long_name}
    arrays[name] = (("cell",), Column(make, float if units else object), attrs)


def _at(plan: Plan, axis: Axis) -> Column:
    """Return the column with the axis value of each cell: '' or NaN if the axis does not affect the cell."""
    text = any(isinstance(v, str) for v in axis.values)
    place = {node.name: node.axes.index(axis.dim) for node in plan.nodes if axis.dim in node.axes}
    nothing: Any = "" if text else math.nan
    return Column(
        lambda: [axis.values[index[place[node]]] if node in place else nothing for node, index in plan.cells],
        object if text else float,
    )


def stage_rows(plan: Plan, reports: Reports) -> list[Document]:
    """Return one row per stage: cells computed, reused, left out and failed, seconds, share, worst error."""
    rows = []
    took = {node.name: reports.seconds_of(node.name) for node in plan.nodes}
    total = reports.seconds_of() or 1.0
    for node in plan.nodes:
        cells, seconds = [] if node.name in plan.seen_only else plan.of(node.name), took[node.name]
        bounds = [c.left_out.bound if c.left_out else 0.0 for c in cells]
        stated = [(c.error[0] + bound, bound) for c, bound in zip(cells, bounds, strict=True) if c.error[0] is not None]
        error, bound = max(stated, default=(None, 0.0))
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
                "left_out": omissions.left_out(
                    node, cells, plan.precision, [v for v in node.writes if (node.name, v) in plan.with_arrays]
                ),
                "approximated": omissions.approximated(node, cells, plan.precision),
                "seconds": seconds,
                "share": seconds / total,
                "error": error,
                "how": "bound" if error is not None and bound > 0.5 * error else how,
                "bytes": reports.bytes_of(node.name),
            }
        )
    return rows


def summary(plan: Plan, reports: Reports) -> Document:
    """Return the table with one row per stage, in the form of a group of the archive."""
    rows = stage_rows(plan, reports)
    dims = ("stage",)
    arrays = {
        "stage": (dims, np.array([r["name"] for r in rows], dtype=object), {"long_name": "stage"}),
        "cells": (dims, np.array([r["cells"] for r in rows]), {"units": "1", "long_name": "cells"}),
        "seconds": (dims, np.array([r["seconds"] for r in rows]), {"units": "s", "long_name": "thread time"}),
        "bytes": (dims, np.array([r["bytes"] for r in rows]), {"units": "byte", "long_name": "bytes stored"}),
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
    """Return a sentence for each stage that counts values of the type ``counted`` (lifted to a floor, or above
    saturation) and found some.
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
                f"of them in a cell"
            )
    return texts


class Headline(NamedTuple):
    """The value of a metric in a shown cell; ``without``: the stages whose effect the metric does not include."""

    name: str
    value: float
    unit: str
    without: tuple[str, ...]
    stage: str
    variable: str


def headlines(plan: Plan, arrays: Mapping[CellRef, Mapping[str, Array]]) -> list[Headline]:
    """Return up to three metrics of the shown cells, preferred metrics first."""
    preferred = first("headline")
    found: dict[str, Headline] = {}
    for ref, values in arrays.items():
        node = plan.node(ref[0])
        for name, array in values.items():
            declaration = node.writes[name]
            if is_headline(name, declaration) and np.size(array):
                value = float(np.ravel(array)[-1])
                at = ""
                if declaration.dims:
                    at = f" at {plan.cells[ref].grids[name]['stage'].values()[-1]}"
                if math.isfinite(value):
                    without = not_in_it(plan, node, name)
                    found[name] = Headline(f"{name}{at}", value, declaration.unit, without, ref[0], name)
    ordered = [found[n] for n in preferred if n in found] + [v for n, v in found.items() if n not in preferred]
    return ordered[:3]
