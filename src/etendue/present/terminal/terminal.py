"""What a terminal sees: plan, the table at the end.

Results go to stdout, notes to stderr. rich does the drawing; NO_COLOR and pipes are honoured by it.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape as without_markup
from rich.table import Table

from etendue.contract.stage import parameters_of
from etendue.plan.model import CellRef, Plan
from etendue.plan.omissions import told
from etendue.present.terminal.looking import next_commands
from etendue.present.terminal.tables import floored, headlines, stage_rows
from etendue.telling import human_bytes, printable
from etendue.types.documents import Document

MOST_STORED = 6  # variables whose bytes are told one by one


def escape(text: str) -> str:
    """Foreign text as it stands: no markup, nothing that a terminal obeys."""
    return without_markup(printable(text))


class _Console(Console):
    """What is printed as text holds nothing that a terminal obeys, wherever it comes from."""

    def print(self, *objects: Any, **how: Any) -> None:
        super().print(*(printable(o) if isinstance(o, str) else o for o in objects), **how)


class _Table(Table):
    def add_row(self, *cells: Any, **how: Any) -> None:
        super().add_row(*(printable(c) if isinstance(c, str) else c for c in cells), **how)


def _out() -> Console:
    return _Console(highlight=False, soft_wrap=False)


def human_seconds(seconds: float) -> str:
    if seconds >= 60:
        return f"{int(seconds // 60)} min {seconds % 60:.0f} s"
    return f"{seconds:.2f} s" if seconds >= 1 else f"{1e3 * seconds:.1f} ms"


def human_rate(cells_a_second: float) -> str:
    return f"{cells_a_second:.0f} cells/s" if cells_a_second >= 10 else f"{cells_a_second:.2g} cells/s"


def _table(title: str, *columns: tuple[str, str], wrap: tuple[str, ...] = ()) -> Table:
    """A table whose columns are (name, justify); only those in ``wrap`` are broken into lines."""
    table = _Table(title=title, title_justify="left", box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for name, justify in columns:
        table.add_column(name, justify=justify, no_wrap=name not in wrap)  # type: ignore[arg-type]
    return table


def _print_whole(
    console: Console, title: str, columns: tuple[tuple[str, str], ...], rows: list[tuple[str, ...]], keys: int = 1
) -> None:
    """A table without an ellipsis: where the terminal is too narrow, below itself, each part with the first columns."""
    widths = [
        max(map(cell_len, (name, *(printable(row[i]) for row in rows)))) + 3 for i, (name, _) in enumerate(columns)
    ]
    parts: list[list[int]] = [[]]
    for column in range(keys, len(columns)):
        if parts[-1] and sum(widths[:keys]) + sum(widths[i] for i in (*parts[-1], column)) - 3 > console.width:
            parts.append([])
        parts[-1].append(column)
    for number, part in enumerate(parts):
        chosen = [*range(keys), *part]
        table = _table("" if number else title, *(columns[i] for i in chosen))
        for row in rows:
            table.add_row(*(escape(row[i]) for i in chosen))
        console.print(table)


def short_axes(keys: Iterable[str]) -> dict[str, str]:
    """Short names of axes: 'spacing' of 'grid_spacing', 'filter' of 'filter.use'; the key itself where two would be
    equal.
    """
    short = {}
    for key in keys:
        stage, _, parameter = key.rpartition(".")
        name = stage if parameter == "use" else parameter
        short[key] = name if len(name) <= 8 else name.rpartition("_")[2]
    return {key: name if list(short.values()).count(name) == 1 else key for key, name in short.items()}


def _product(names: Iterable[str]) -> str:
    """'gain*spacing*time'; with blanks, where lines may break, when it is long."""
    names = list(names)
    text = "*".join(names) or "-"
    return text if len(text) <= 24 else " * ".join(names)


def _axis(axis: Document, short: str) -> str:
    """'spacing = grid_spacing: 2.8 .. 5.4 um (2)'."""
    values = [f"{v:g}" if isinstance(v, float) else str(v) for v in axis["values"]]
    units = f" {axis['units']}" if axis["units"] not in (None, "1") else ""
    shown = ", ".join(values) if len(values) <= 4 else f"{values[0]} .. {values[-1]}"
    return f"{'' if short == axis['name'] else short + ' = '}{axis['name']}: {shown}{units} ({len(values)})"


def _uses(stages: list[Document]) -> list[str]:
    """'filter is filter_fast' for every stage that is named otherwise than what it uses."""
    texts = []
    for stage in stages:
        uses = stage["use"] if isinstance(stage["use"], list) else [stage["use"]]
        if uses != [stage["name"]]:
            texts.append(f"{stage['name']} is {' or '.join(dict.fromkeys(uses))}")
    return texts


def _bound(stages: list[Document]) -> list[str]:
    """Which stages take a shared quantity from an earlier one, and which are run one by one over a dim."""
    found: dict[tuple[str, str], list[str]] = {}
    mapped: dict[str, list[str]] = {}
    for stage in stages:
        for name, finder in (stage["found"] or {}).items():
            found.setdefault((name, finder), []).append(stage["name"])
        if stage["one_by_one"]:
            mapped.setdefault(" ".join(stage["one_by_one"]), []).append(stage["name"])
    texts = [f"found     {name} by {finder}, for {', '.join(takers)}" for (name, finder), takers in found.items()]
    return texts + [f"for each  {dims}: {', '.join(names)}" for dims, names in mapped.items()]


def _stored(document: Document) -> list[str]:
    """Bytes of what is stored by variable, most first; and what the words under `keep` would store."""
    sizes: dict[str, int] = {}
    for stage in document["stages"]:
        for name, one in stage["variables"].items():
            if one["kept"]:
                sizes[name] = sizes.get(name, 0) + one["bytes"]
    ranked = sorted(sizes, key=lambda name: -sizes[name])
    said = [f"{name} {human_bytes(sizes[name])}" for name in ranked[:MOST_STORED]]
    rest = sum(sizes[name] for name in ranked[MOST_STORED:])
    said += [f"{len(ranked) - MOST_STORED} more {human_bytes(rest)}"] if len(ranked) > MOST_STORED else []
    words = ", ".join(f'"{word}" {human_bytes(size)}' for word, size in document["keep"].items())
    return [f"stored    {', '.join(said)}", f"keep      = {words}"]


def print_plan(document: Document) -> None:
    """The plan as a table, and what is left out and why."""
    console = _out()
    short = short_axes(axis["name"] for axis in document["axes"])
    table = _table(
        f"plan of {escape(document['name'])}",
        ("stage", "left"),
        ("axes", "left"),
        ("cells", "right"),
        ("left out", "right"),
        ("stored", "right"),
        ("time", "right"),
        wrap=("axes",),
    )
    for stage in document["stages"]:
        table.add_row(
            stage["name"],
            _product(short[key] for key in stage["axes"]),
            str(stage["cells"]),
            str(stage["left_out"]["cells"]) if stage["left_out"] else "",
            human_bytes(stage["bytes"]),
            human_seconds(stage["seconds"]),
        )
    console.print(table)
    for text in _stored(document):
        console.print(escape(text))
    for axis in document["axes"]:
        console.print(f"axis      {escape(_axis(axis, short[axis['name']]))}")
    for text in _uses(document["stages"]):
        console.print(f"stage     {text}")
    for text in _bound(document["stages"]):
        console.print(escape(text))
    for stage in document["stages"]:
        for text in told(stage["name"], stage["left_out"], stage["approximated"]):
            console.print(escape(text))
    console.print(
        f"{document['cells']} cells ({document['naive_cells']} if every stage ran at every point), "
        f"{human_bytes(document['bytes'])} before compression, about {human_seconds(document['seconds'])} of thread "
        f"time, "
        f"{human_bytes(document['peak_memory'])} held at most, {document['precision']}"
    )
    notes = _Console(stderr=True, highlight=False)
    for text in document["warnings"]:
        notes.print(f"note: {escape(text)}")


def outcome_document(outcome: Any) -> Document:
    """``etendue run --json``."""
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
            {"name": n, "value": v, "units": u, "without": w} for n, v, u, w in headlines(outcome.plan, outcome.arrays)
        ],
    }


def together(reasons: Mapping[str, str]) -> dict[str, list[str]]:
    """Stages by the reason for which they are computed again."""
    found: dict[str, list[str]] = {}
    for name, why in reasons.items():
        found.setdefault(why, []).append(name)
    return found


def replay(plan: Plan, ref: CellRef) -> str:
    """The command that computes one cell and what it needs, alone. Axes that do not reach it stand at their first
    value.
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
            words += ["--set", f"{key}={value}"]
    for axis in plan.axes:
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


def print_outcome(outcome: Any) -> None:
    """The table stage | cells | time | share, what was left out or failed, headline figures, where everything is."""
    console = _out()
    rows = stage_rows(outcome.plan, outcome.reports)
    table = _table(
        f"{escape(outcome.plan.pipeline.name)}: {outcome.computed} cells computed, {len(outcome.reused)} reused",
        ("stage", "left"),
        ("cells", "right"),
        ("time", "right"),
        ("share", "right"),
        ("error", "right"),
        ("known by", "left"),
        ("left out", "right"),
    )
    for row in rows:
        table.add_row(
            row["name"],
            str(row["cells"]),
            human_seconds(row["seconds"]) if row["computed"] else "reused",
            f"{100 * row['share']:.0f} %",
            "unknown" if row["error"] is None else f"{row['error']:.1g}",
            row["how"],
            f"{row['left_out']['cells']} of {row['cells']}" if row["left_out"] else "",
        )
    console.print(table)
    for row in rows:
        for text in told(row["name"], row["left_out"], row["approximated"]):
            console.print(escape(text))
    _print_changes(console, outcome)
    _print_doubts(console, outcome)
    _print_figures(console, outcome)
    if outcome.archive:
        console.print(f"archive        {outcome.archive}", soft_wrap=True)
    for picture in outcome.pictures:
        console.print(f"contact sheet  {picture}", soft_wrap=True)
    if outcome.archive:
        for text in next_commands(outcome):
            console.print(text, soft_wrap=True)
    console.print(f"{human_seconds(outcome.seconds)} in all")


def _print_changes(console: Console, outcome: Any) -> None:
    """What a run has done to what was there before."""
    for why, names in together(outcome.reasons).items():
        more = f" and {len(names) - 4} more" if len(names) > 5 else ""
        console.print(f"computed again: {', '.join(names[:4] if more else names)}{more}, because {escape(why)}")
    if outcome.removed:
        console.print(
            f"removed: {outcome.removed} cells of earlier runs at other axis values, which would come out differently "
            f"now"
        )
    if outcome.pruned:
        console.print(f"removed, as asked: {outcome.pruned} finished cells that this run does not keep")
    if outcome.stay:
        console.print(
            escape(f"stays: {', '.join(outcome.stay)}, which 'keep' no longer names (remove: --prune)"), soft_wrap=True
        )
    for text in outcome.mended[:5]:
        console.print(escape(f"was missing or damaged, and is written again: {text[:1000]}"), soft_wrap=True)
    if len(outcome.mended) > 5:
        console.print(f"was missing or damaged, and is written again: {len(outcome.mended) - 5} more")
    if outcome.moved.get("shards"):
        shards, copied, computed = (outcome.moved[name] for name in ("shards", "copied", "computed"))
        what = (
            f"{shards} {'shard' if shards == 1 else 'shards'} made anew: {copied} bytes copied beside {computed} "
            f"bytes computed"
        )
        console.print(f"rewritten: {what}", soft_wrap=True)


def _print_doubts(console: Console, outcome: Any) -> None:
    """Where light is cut off, and what failed."""
    worst = outcome.reports.most_clipped()
    if worst is not None:
        console.print(
            f"clipped: negative light in front of {worst.stage}, at most {worst.clipped_flux:.2g} of the flux of a cell"
        )
    for text in floored(outcome.plan, outcome.reports):
        console.print(f"floored: {escape(text)}", soft_wrap=True)
    for text in floored(outcome.plan, outcome.reports, "overexposed"):
        console.print(f"overexposed: {escape(text)}; what is clipped is shown as white", soft_wrap=True)
    for report in outcome.failed[:5]:
        ref = (report.stage, report.index)
        where = f"{report.stage} {outcome.plan.labels(ref)}, {outcome.plan.origin(ref)}"
        console.print(f"failed: {escape(where)}: {escape(report.message)}", soft_wrap=True)
        console.print(f"  again, alone: {escape(replay(outcome.plan, ref))}", soft_wrap=True)
    if len(outcome.failed) > 5:
        console.print(f"failed: {len(outcome.failed) - 5} more; see the ledger")


def _print_figures(console: Console, outcome: Any) -> None:
    figures = headlines(outcome.plan, outcome.arrays)
    if figures and outcome.shown_at:
        console.print(f"figures and pictures{escape(outcome.shown_at)}:")
    for name, value, unit, unseen in figures:
        without = f"  without {', '.join(unseen)}" if unseen else ""
        console.print(
            f"{name:32s} {value:.5g} {unit if unit != '1' else ''}".rstrip() + escape(without), soft_wrap=True
        )
