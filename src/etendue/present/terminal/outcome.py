"""The end of a run: its stages, the errors of its results, headline metrics, and the place of the results.

In:  an ``Outcome``.
Out: lines on stdout, the most important lines last; the document of ``run --json``.
"""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any

from rich.console import Console

from etendue.archive.records.inputs import as_recorded
from etendue.contract.stage import parameters_of
from etendue.pipeline.zipped import SAMPLE
from etendue.plan.model import Axis, CellRef, Plan
from etendue.present.terminal.answer_texts import plus_minus, remedies
from etendue.present.terminal.answers import print_answers
from etendue.present.terminal.looking import next_commands
from etendue.present.terminal.tables import floored, headlines, stage_rows
from etendue.present.terminal.terminal import _out, _table, _without_time, escape, omission_lines
from etendue.telling import human_seconds
from etendue.types.documents import Document


def outcome_document(outcome: Any) -> Document:
    """Return the document of ``etendue run --json``."""
    stages = stage_rows(outcome.plan, outcome.reports)
    return {
        "archive": str(outcome.archive) if outcome.archive else None,
        "store": str(outcome.archive / "data.zarr") if outcome.archive else None,
        "tolerance": outcome.plan.pipeline.tolerance if outcome.plan.leaves_out else None,
        "norm": outcome.plan.pipeline.norm,
        "stages": stages,
        "computed": outcome.computed,
        "reused": len(outcome.reused),
        "failed": len(outcome.failed),
        "seconds": outcome.seconds,
        "pictures": [str(p) for p in outcome.pictures],
        "reasons": outcome.reasons,
        "removed": outcome.removed,
        "pruned": outcome.pruned,
        "stays": outcome.stay,
        "mended": outcome.mended,
        "moved": outcome.moved,
        "floored": floored(outcome.plan, outcome.reports),
        "overexposed": floored(outcome.plan, outcome.reports, "overexposed"),
        "failures": [
            {
                "cell": [r.stage, outcome.plan.labels(ref := (r.stage, r.index))],
                "by": outcome.plan.origin(ref),
                "message": r.message,
                "again": replay(outcome.plan, ref),
            }
            for r in outcome.failed
        ],
        "headlines": [
            {"name": own.name, "value": own.value, "units": own.unit, "without": own.without}
            | ({"error": error} if (error := outcome.error_of(own.stage, own.variable)) else {})
            for own in headlines(outcome.plan, outcome.arrays)
        ],
    }


def together(reasons: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the stages grouped by the reason why they are recomputed."""
    found: dict[str, list[str]] = {}
    for name, why in reasons.items():
        found.setdefault(why, []).append(name)
    return found


def replay(plan: Plan, ref: CellRef) -> str:
    """Return the command that computes only one cell and its inputs. An axis that does not affect the cell takes its
    first value.
    """
    labels = plan.labels(ref)
    words = ["etendue", "run", plan.pipeline.file]
    swept = {axis.key for axis in plan.axes}
    for key, value in plan.pipeline.overrides:
        if (
            not key.startswith("sweep.")
            and key not in ("wanted", "keep")
            and key.removeprefix(f"{plan.pipeline.table.name}.") not in swept
        ):
            words += ["--set", f"{key}={as_recorded(value, {}) if isinstance(value, Mapping) else value}"]
    for axis in plan.axes:
        if axis.rows:
            words += _row_settings(plan, axis, ref)
            continue
        value = labels.get(axis.dim, axis.values[0])
        stage, _, parameter = axis.key.partition(".")
        if parameter != "use":
            words += ["--set", f"{axis.key if parameter else plan.pipeline.table.place(axis.key)}={value}"]
            continue
        node = next((n for n in plan.nodes if n.name == stage), None)
        one = next((a for a in node.alternatives if a.label == value), None) if node else None
        if one is not None:
            declared = parameters_of(one.kind)
            words += ["--set", f"{axis.key}={one.use}"]
            for name, own in one.values.items():
                if not declared[name][0].shared and own != declared[name][2]:
                    words += ["--set", f"{stage}.{name}={own}"]
    return shlex.join([*words, "--want", ref[0], "--archive", "again"])


def _row_settings(plan: Plan, axis: Axis, ref: CellRef) -> list[str]:
    """Return the options that reduce an axis of rows to the row that contains this cell."""
    at = dict(zip(plan.node(ref[0]).axes, ref[1], strict=True))
    position = at.get(axis.dim, 0)
    for part in plan.derived:
        if part.of == axis.dim and part.dim in at:
            position = part.places.index(at[part.dim])
    if axis.dim == SAMPLE:
        return ["--set", f"design.rows=[{axis.values[position]}]"]
    found = []
    for number, factor in enumerate(axis.factors):
        place = factor.key if "." in factor.key else plan.pipeline.table.place(factor.key)
        found += ["--set", f"{place}={axis.column(number)[position]}"]
    return found


def print_outcome(outcome: Any) -> None:
    """Print the stage table, omissions, failures, headline metrics, and the place of the results."""
    console = _out()
    rows = stage_rows(outcome.plan, outcome.reports)
    table = _table(
        f"{escape(outcome.plan.pipeline.name)}: {outcome.computed} cells computed, {len(outcome.reused)} reused",
        ("stage", "left", "name"),
        ("cells", "right", "cells"),
        ("time", "right", lambda row: human_seconds(row["seconds"]) if row["computed"] else _without_time(row)),
        ("share", "right", lambda row: f"{100 * row['share']:.0f} %"),
        ("own error", "right", "error", ".1g", "unknown"),
        ("basis", "left", "how"),
        ("left out", "right", lambda row: f"{row['left_out']['cells']} of {row['cells']}" if row["left_out"] else ""),
        rows=rows,
    )
    console.print(table)
    for row in rows:
        for text in omission_lines(row["name"], row["left_out"], row["approximated"]):
            console.print(escape(text))
    _print_changes(console, outcome)
    _print_doubts(console, outcome)
    if outcome.answers:
        console.print("")
        print_answers(outcome.answers, {own.variable for own in headlines(outcome.plan, outcome.arrays)})
    console.print("")
    _print_figures(console, outcome)
    if outcome.archive:
        console.print(f"archive        {outcome.archive}", soft_wrap=True)
    for picture in outcome.pictures:
        console.print(f"contact sheet  {picture}", soft_wrap=True)
    if outcome.archive:
        for text in next_commands(outcome):
            console.print(text, soft_wrap=True)
    console.print(f"{human_seconds(outcome.seconds)} total")


def _print_changes(console: Console, outcome: Any) -> None:
    """Print the changes that a run made to earlier results."""
    for why, names in together(outcome.reasons).items():
        more = f" and {len(names) - 4} more" if len(names) > 5 else ""
        console.print(f"recomputed: {', '.join(names[:4] if more else names)}{more}, because {escape(why)}")
    if outcome.removed:
        console.print(
            f"removed: {outcome.removed} cells of earlier runs at other axis values, which would now have other results"
        )
    if outcome.pruned:
        console.print(f"pruned: {outcome.pruned} finished cells that this run does not keep")
    if outcome.stay:
        console.print(
            escape(f"kept: {', '.join(outcome.stay)}, no longer named by 'keep' (--prune removes it)"), soft_wrap=True
        )
    for text in outcome.mended[:5]:
        console.print(escape(f"rewritten, because missing or damaged: {text[:1000]}"), soft_wrap=True)
    if len(outcome.mended) > 5:
        console.print(f"rewritten, because missing or damaged: {len(outcome.mended) - 5} more")
    if outcome.moved.get("shards"):
        shards, copied, computed = (outcome.moved[name] for name in ("shards", "copied", "computed"))
        what = (
            f"{shards} {'shard' if shards == 1 else 'shards'}: {copied} bytes copied beside {computed} bytes computed"
        )
        console.print(f"rewritten: {what}", soft_wrap=True)


def _print_doubts(console: Console, outcome: Any) -> None:
    """Print the stages that clipped light, and the failures."""
    worst = outcome.reports.most_clipped()
    if worst is not None:
        console.print(
            f"clipped: negative light before {worst.stage}, at most {worst.clipped_flux:.2g} of the flux of a cell"
        )
    for text in floored(outcome.plan, outcome.reports):
        console.print(f"floored: {escape(text)}", soft_wrap=True)
    for text in floored(outcome.plan, outcome.reports, "overexposed"):
        console.print(f"overexposed: {escape(text)}; clipped values are shown as white", soft_wrap=True)
    for report in outcome.failed[:5]:
        ref = (report.stage, report.index)
        where = f"{report.stage} {outcome.plan.labels(ref)}, {outcome.plan.origin(ref)}"
        console.print(f"failed: {escape(where)}: {escape(report.message)}", soft_wrap=True)
        console.print(f"  rerun alone: {escape(replay(outcome.plan, ref))}", soft_wrap=True)
    if len(outcome.failed) > 5:
        console.print(f"failed: {len(outcome.failed) - 5} more; see the ledger")


def _print_figures(console: Console, outcome: Any) -> None:
    """Print headline metrics with their errors, the stages that they do not include, and the command for smaller
    errors.
    """
    figures = headlines(outcome.plan, outcome.arrays)
    if figures and outcome.shown_at:
        console.print(f"metrics and pictures{escape(outcome.shown_at)}:")
    without: dict[str, list[str]] = {}
    for own in figures:
        error = plus_minus(outcome.error_of(own.stage, own.variable), own.unit)
        plain = f"{own.unit if own.unit != '1' else ''}{' (error not measured)' if outcome.answers else ''}".strip()
        console.print(f"{own.name:32s} {own.value:.5g} {error or plain}".rstrip())
        if own.without:
            without.setdefault(", ".join(own.without), []).append(own.name)
    for stages, names in without.items():
        console.print(escape(f"without the effect of {stages}: {', '.join(names)}"))
    for text in remedies(outcome.answers or {}, f"etendue run {shlex.quote(outcome.plan.pipeline.file)}"):
        console.print(escape(text), soft_wrap=True)
