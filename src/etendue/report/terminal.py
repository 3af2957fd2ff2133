"""What a terminal sees: plan, progress, the table at the end, lists of stages and archives.

Results go to stdout, progress and notes to stderr. rich does the drawing; NO_COLOR and pipes are honoured by it.
"""

from __future__ import annotations

import math
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from etendue.plan.cost import cell_seconds
from etendue.plan.model import Plan
from etendue.registry import Registry
from etendue.report.tables import headlines, stage_rows
from etendue.spec.ports import CellReport
from etendue.spec.stage import MISSING, parameters_of, reads_of, writes_of


def _out() -> Console:
    return Console(highlight=False, soft_wrap=False)


def human_bytes(count: float) -> str:
    for unit in ("B", "kB", "MB", "GB", "TB"):
        if count < 1000 or unit == "TB":
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return ""


def human_seconds(seconds: float) -> str:
    if seconds >= 60:
        return f"{int(seconds // 60)} min {seconds % 60:.0f} s"
    return f"{seconds:.2f} s" if seconds >= 1 else f"{1e3 * seconds:.1f} ms"


def _use(value: Any) -> str:
    return ", ".join(value) if isinstance(value, list) else str(value)


def print_plan(document: dict[str, Any]) -> None:
    """The plan as a table, and what is left out and why."""
    console = _out()
    table = Table(title=f"plan of {escape(document['name'])}", title_justify="left")
    for name, justify in (("stage", "left"), ("use", "left"), ("axes", "left"), ("cells", "right"), ("left out", "right"), ("stored", "right"), ("time", "right")):
        table.add_column(name, justify=justify, overflow="fold")  # type: ignore[arg-type]
    for stage in document["stages"]:
        table.add_row(
            stage["name"], _use(stage["use"]), " x ".join(stage["axes"]) or "-", str(stage["cells"]),
            str(stage["left_out"]["cells"]) if stage["left_out"] else "", human_bytes(stage["bytes"]), human_seconds(stage["seconds"]),
        )  # fmt: skip
    console.print(table)
    for stage in document["stages"]:
        if stage["left_out"]:
            out = stage["left_out"]
            ends = f"; the claim ends at {out['claim_ends_at']}" if out["claim_ends_at"] else ""
            console.print(f"left out: {stage['name']} in {out['cells']} of {out['of']} cells, wrong by at most {out['bound']:.2g}: {escape(out['why'])}{ends}")
    console.print(
        f"{document['cells']} cells ({document['naive_cells']} if every stage ran at every point), {human_bytes(document['bytes'])} before compression, "
        f"about {human_seconds(document['seconds'])} of thread time, {human_bytes(document['peak_memory'])} held at most, {document['precision']}"
    )
    for text in document["warnings"]:
        console.print(f"note: {escape(text)}")


class TerminalProgress:
    """A bar on stderr; silent where stderr is no terminal."""

    def __init__(self, plan: Plan) -> None:
        self.console = Console(stderr=True)
        self.costs = {}
        self.plan = plan
        self.progress: Progress | None = None

    def begin(self, cells: int) -> None:
        if not self.console.is_terminal or not cells:
            return
        self.costs = {ref: cell_seconds(self.plan.node(ref[0]), cell, self.plan.precision) for ref, cell in self.plan.cells.items()}
        self.progress = Progress(
            TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("cells"), TimeElapsedColumn(),
            TextColumn("left"), TimeRemainingColumn(), console=self.console, transient=True,
        )  # fmt: skip
        self.progress.start()
        self.task = self.progress.add_task("starting", total=cells)

    def starting(self, stages: tuple[str, ...]) -> None:
        if self.progress:
            self.progress.update(self.task, description=stages[-1][:24] if len(stages) == 1 else f"{stages[0]} .. {stages[-1]}"[:40])

    def finished(self, reports: tuple[CellReport, ...]) -> None:
        if self.progress:
            self.progress.advance(self.task, len(reports))

    def end(self) -> None:
        if self.progress:
            self.progress.stop()
            self.progress = None


def outcome_document(outcome: Any) -> dict[str, Any]:
    """``etendue run --json``."""
    stages = stage_rows(outcome.plan, outcome.reports)
    return {
        "archive": str(outcome.archive) if outcome.archive else None,
        "store": str(outcome.archive / "data.zarr") if outcome.archive else None,
        "stages": stages,
        "computed": outcome.computed,
        "reused": len(outcome.reused),
        "failed": len(outcome.failed),
        "seconds": outcome.seconds,
        "pictures": [str(p) for p in outcome.pictures],
        "reasons": outcome.reasons,
        "failures": [{"cell": [r.stage, outcome.plan.labels((r.stage, r.index))], "message": r.message} for r in outcome.failed],
        "headlines": [{"name": n, "value": v, "units": u} for n, v, u in headlines(outcome.plan, outcome.arrays)],
    }


def print_outcome(outcome: Any) -> None:
    """The table stage | cells | time | share, what was left out or failed, headline figures, where everything is."""
    console = _out()
    rows = stage_rows(outcome.plan, outcome.reports)
    table = Table(title=f"{escape(outcome.plan.pipeline.name)}: {outcome.computed} cells computed, {len(outcome.reused)} reused", title_justify="left")
    for name, justify in (("stage", "left"), ("cells", "right"), ("time", "right"), ("share", "right"), ("error", "right"), ("known by", "left"), ("left out", "right")):
        table.add_column(name, justify=justify)  # type: ignore[arg-type]
    for row in rows:
        table.add_row(
            row["name"], str(row["cells"]), human_seconds(row["seconds"]) if row["computed"] else "reused", f"{100 * row['share']:.0f} %",
            "unknown" if row["error"] is None else f"{row['error']:.1g}", row["how"],
            f"{row['left_out']['cells']} of {row['cells']}" if row["left_out"] else "",
        )  # fmt: skip
    console.print(table)
    for row in rows:
        if row["left_out"]:
            console.print(f"left out: {row['name']}, wrong by at most {row['left_out']['bound']:.2g}: {escape(row['left_out']['why'])}")
    for name, why in outcome.reasons.items():
        console.print(f"computed again: {name}, because {escape(why)}")
    clipped = [r for r in outcome.reports.values() if r.clipped_flux > 0]
    if clipped:
        worst = max(clipped, key=lambda r: r.clipped_flux)
        console.print(f"clipped: negative light in front of {worst.stage}, at most {worst.clipped_flux:.2g} of the flux of a cell")
    for report in outcome.failed[:5]:
        labels = outcome.plan.labels((report.stage, report.index))
        flags = " ".join(f"--set {outcome.plan.axis(d).key if '.' in outcome.plan.axis(d).key else 'camera.' + outcome.plan.axis(d).key}={v}" for d, v in labels.items())
        console.print(f"failed: {report.stage} {escape(str(labels))}: {escape(report.message)}")
        console.print(f"  again, alone: etendue run {outcome.plan.pipeline.file} {flags} --want {report.stage} --archive again")
    if len(outcome.failed) > 5:
        console.print(f"failed: {len(outcome.failed) - 5} more; see the ledger")
    for name, value, unit in headlines(outcome.plan, outcome.arrays):
        console.print(f"{name:32s} {value:.5g} {unit}")
    if outcome.archive:
        console.print(f"archive        {outcome.archive}", soft_wrap=True)
    for picture in outcome.pictures:
        console.print(f"contact sheet  {picture}", soft_wrap=True)
    console.print(f"{human_seconds(outcome.seconds)} in all")


def stage_document(registry: Registry, name: str) -> dict[str, Any]:
    """One stage as JSON; a broken plugin says why it is broken."""
    from etendue.errors import PluginError

    installed = registry.installed(name)
    document: dict[str, Any] = {"name": name, "distribution": installed.distribution, "version": installed.version}
    try:
        kind = registry.load(name)
    except PluginError as error:
        return {**document, "reads": {}, "writes": {}, "parameters": {}, "doc": "", "broken": str(error)}
    parameters = {}
    for key, (parameter, kind_of, default) in parameters_of(kind).items():
        value = None if default is MISSING else (list(default) if isinstance(default, tuple) else default)
        if isinstance(value, float) and not math.isfinite(value):
            value = "inf"
        parameters[key] = {
            "type": getattr(kind_of, "__name__", str(kind_of)), "units": parameter.units, "default": value, "required": default is MISSING,
            "range": parameter.range_text(), "choices": list(parameter.choices) if parameter.choices else None,
            "camera": parameter.camera, "fidelity": parameter.reference or None, "doc": parameter.doc,
        }  # fmt: skip
    return {
        **document,
        "reads": {p: str(d) for p, d in reads_of(kind).items()},
        "writes": {p: str(d) for p, d in writes_of(kind).items()},
        "parameters": parameters,
        "doc": (kind.__doc__ or "").strip(),
    }


def print_stages(documents: list[dict[str, Any]]) -> None:
    console = _out()
    table = Table()
    for name in ("stage", "reads", "writes", "from"):
        table.add_column(name, overflow="fold")
    for d in documents:
        table.add_row(d["name"], ", ".join(d["reads"]), d.get("broken") or ", ".join(d["writes"]), f"{d['distribution']} {d['version']}")
    console.print(table)


def print_stage(document: dict[str, Any]) -> None:
    console = _out()
    console.print(f"{document['name']}  ({document['distribution']} {document['version']})")
    if "broken" in document:
        console.print(escape(document["broken"]))
        return
    console.print(escape(document["doc"]))
    for what in ("reads", "writes"):
        for declaration in document[what].values():
            console.print(f"{what:7s} {escape(declaration)}")
    table = Table()
    for name in ("parameter", "default", "units", "allowed", "meaning"):
        table.add_column(name, overflow="fold")
    for key, p in document["parameters"].items():
        allowed = ", ".join(p["choices"]) if p["choices"] else p["range"]
        notes = p["doc"] + (" (camera)" if p["camera"] else "") + (f" (fidelity; reference: {p['fidelity']})" if p["fidelity"] else "")
        table.add_row(key, "required" if p["required"] else str(p["default"]), p["units"], allowed, escape(notes))
    console.print(table)


def print_archive(document: dict[str, Any]) -> None:
    console = _out()
    state = "a run is going on" if document["running"] else f"{document['runs']} runs, the last began {document['began']}"
    console.print(f"{document['archive']}: pipeline {document['pipeline']}, {human_bytes(document['bytes'])}, {state}")
    for axis, values in document["axes"].items():
        shown = ", ".join(map(str, values[:8])) + (f", ... ({len(values)})" if len(values) > 8 else "")
        console.print(f"axis {axis}: {shown}")
    table = Table()
    for name in ("stage", "cells", "group", "variable", "dims"):
        table.add_column(name, overflow="fold")
    for stage in document["stages"]:
        cells = ", ".join(f"{n} {s}" for s, n in stage["cells"].items())
        rows = stage["variables"] or [{"group": "", "variable": "(not kept)", "dims": {}, "units": ""}]
        for i, v in enumerate(rows):
            dims = " ".join(f"{d} {n}" for d, n in v["dims"].items())
            table.add_row(stage["name"] if not i else "", cells if not i else "", v["group"], f"{v['variable']} {escape('[' + v['units'] + ']') if v['units'] else ''}", dims)
    console.print(table)
    console.print(f"open it: xarray.open_datatree('{document['store']}', engine='zarr')", soft_wrap=True)
