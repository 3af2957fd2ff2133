"""Tables: the ledger (a row per cell), the summary (a row per stage), and what is printed at the end of a run.

In:  a plan and the reports of its cells.
Out: columns as plain lists with dims and attributes; text for a terminal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from etendue.plan import omissions
from etendue.plan.model import CellRef, Plan
from etendue.spec.ports import CellReport
from etendue.spec.variables import variable

Table = dict[str, Any]


def ledger(plan: Plan, reports: Mapping[CellRef, CellReport]) -> Table:
    """One row per cell: stage, axes (missing where they do not reach), seconds, error and how it is known, key."""
    rows = [(plan.cells[ref], reports.get(ref)) for ref in plan.cells]
    arrays: dict[str, Any] = {
        "stage": (("cell",), np.array([c.node for c, _ in rows], dtype=object), {"long_name": "stage"}),
        "use": (("cell",), np.array([c.use for c, _ in rows], dtype=object), {"long_name": "implementation"}),
    }
    for axis in plan.axes:
        column: list[Any] = []
        text = any(isinstance(v, str) for v in axis.values)
        place = {node.name: node.axes.index(axis.dim) for node in plan.nodes if axis.dim in node.axes}
        for cell, _ in rows:
            column.append(axis.values[cell.index[place[cell.node]]] if cell.node in place else ("" if text else math.nan))
        values = np.array(column, dtype=object if text else float)
        # named beside the dims of the other groups, not after them: here it is a column
        arrays[f"at_{axis.dim}"] = (("cell",), values, {"long_name": axis.key, "units": axis.units or "1"})
    status = [r.status if r else "not_computed" for _, r in rows]
    arrays["status"] = (("cell",), np.array(status, dtype=object), {"long_name": "what became of the cell"})
    arrays["seconds"] = (("cell",), np.array([r.seconds if r else math.nan for _, r in rows]), {"units": "s", "long_name": "thread time"})
    arrays["error"] = (
        ("cell",), np.array([math.nan if c.error[0] is None else c.error[0] for c, _ in rows]),
        {"units": "1", "long_name": "error of the stage, relative to full scale"},
    )  # fmt: skip
    arrays["how"] = (("cell",), np.array([c.error[1] for c, _ in rows], dtype=object), {"long_name": "how the error is known"})
    arrays["bound"] = (
        ("cell",), np.array([c.bound for c, _ in rows]),
        {"units": "1", "long_name": "what leaving out and approximating may add to what the cell writes, relative to full scale"},
    )  # fmt: skip
    coarser = [", ".join(f"{a.knob} = {a.value}" for a in c.approximated) for c, _ in rows]
    arrays["approximated"] = (("cell",), np.array(coarser, dtype=object), {"long_name": "knobs that the plan has set"})
    nodes = {node.name: node for node in plan.nodes}
    saved = [omissions.saved(nodes[c.node], c, plan.precision) for c, _ in rows]
    arrays["seconds_saved"] = (
        ("cell",), np.array([math.nan if s is None else s for s in saved]),
        {"units": "s", "long_name": "thread time that leaving out and approximating is expected to save"},
    )  # fmt: skip
    arrays["why_left_out"] = (
        ("cell",),
        np.array([c.left_out.why if c.left_out else "" for c, _ in rows], dtype=object),
        {"long_name": "why"},
    )
    arrays["clipped"] = (
        ("cell",),
        np.array([r.clipped if r else math.nan for _, r in rows]),
        {"units": "1", "long_name": "share of negative input clipped"},
    )
    arrays["clipped_flux"] = (
        ("cell",), np.array([r.clipped_flux if r else math.nan for _, r in rows]), {"units": "1", "long_name": "share of flux in it"}
    )  # fmt: skip
    arrays["platform"] = (
        ("cell",), np.array([r.platform if r else "" for _, r in rows], dtype=object),
        {"long_name": "an earlier platform, on which it was computed, and accepted; empty: that of the record of the run"},
    )  # fmt: skip
    arrays["key"] = (("cell",), np.array([c.key for c, _ in rows], dtype=object), {"long_name": "equal key, equal result"})
    arrays["message"] = (("cell",), np.array([r.message if r else "" for _, r in rows], dtype=object), {"long_name": "what went wrong"})
    return {"arrays": arrays, "attrs": {"title": "one row per cell: error against run time is a selection from it"}}


def plan_axes(plan: Plan, node: str) -> tuple[str, ...]:
    return plan.node(node).axes


def stage_rows(plan: Plan, reports: Mapping[CellRef, CellReport]) -> list[dict[str, Any]]:
    """One row per stage: cells computed, reused, left out and failed, seconds, share, worst error."""
    rows = []
    grouped: dict[str, list[CellReport]] = {}
    for ref, report in reports.items():
        grouped.setdefault(ref[0], []).append(report)
    total = math.fsum(r.seconds for r in reports.values() if r.status in ("done", "left_out")) or 1.0
    for node in plan.nodes:
        cells = plan.of(node.name)
        own = grouped.get(node.name, [])
        seconds = math.fsum(r.seconds for r in own if r.status in ("done", "left_out"))
        errors = [c.error[0] for c in cells if c.error[0] is not None]
        how = next((c.error[1] for c in cells), "unknown")
        rows.append(
            {
                "name": node.name,
                "use": node.alternatives[0].use if len(node.alternatives) == 1 else [a.use for a in node.alternatives],
                "distribution": node.alternatives[0].distribution,
                "axes": [plan.axis(d).key for d in node.axes],
                "cells": len(cells),
                "computed": sum(r.status in ("done", "left_out") for r in own),
                "reused": sum(r.status == "reused" for r in own),
                "failed": sum(r.status in ("failed", "skipped") for r in own),
                "left_out": omissions.left_out(node, cells, plan.precision),
                "approximated": omissions.approximated(node, cells, plan.precision),
                "seconds": seconds,
                "share": seconds / total,
                "error": max(errors) if errors else None,
                "how": how,
                "bytes": sum(f.size for r in own for f in r.written),
            }
        )  # fmt: skip
    return rows


def summary(plan: Plan, reports: Mapping[CellRef, CellReport]) -> Table:
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


def floored(plan: Plan, reports: Mapping[CellRef, CellReport], counted: str = "floored") -> list[str]:
    """A sentence for each stage with a variable that counts what was lifted to a floor, or lies above saturation, and is above 0."""
    texts = []
    for node in plan.nodes:
        if not any(variable(v).counted == counted for v in node.writes):
            continue
        counts = [r.floored for ref, r in reports.items() if ref[0] == node.name and r.floored > 0]
        if counts:
            what = " and ".join(variable(v).long_name for v in node.writes if variable(v).counted == counted)
            texts.append(f"{node.name} has {what}: in {len(counts)} of {len(plan.of(node.name))} cells, at most {max(counts):g} in a cell")
    return texts


def headlines(plan: Plan, arrays: Mapping[CellRef, Mapping[str, Any]]) -> list[tuple[str, float, str]]:
    """Up to three figures of the shown cells: resolution, dynamic range, exposure first, then any other scalar."""
    preferred = ("mtf50_lp_mm", "dr_elgamal", "mean_snr", "clipped_fraction", "airy_diameter", "fit_residual")
    found: dict[str, tuple[str, float, str]] = {}
    for ref, values in arrays.items():
        node = plan.node(ref[0])
        for name, array in values.items():
            declaration = node.writes[name]
            if declaration.dims in ((), ("stage",)) and np.size(array) and name != "clipping_level" and not variable(name).counted:
                value = float(np.ravel(array)[-1])
                at = ""
                if declaration.dims:
                    at = f" at {plan.cells[ref].grids[name]['stage'].values()[-1]}"
                if math.isfinite(value):
                    found[name] = (f"{name}{at}", value, declaration.unit)
    ordered = [found[n] for n in preferred if n in found] + [v for n, v in found.items() if n not in preferred]
    return ordered[:3]
