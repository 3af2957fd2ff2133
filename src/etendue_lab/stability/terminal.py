"""Terminal output of stability: the worst case of each law of each stage.

In:  groups of rows, or rows.
Out: a table; a line for each failure; the counts.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from etendue.cli.saying import say, show
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document
from etendue_lab.stability.rows import counts, document, groups, single
from etendue_lab.stability.study import stability as check

if TYPE_CHECKING:
    from etendue_lab.stability.rows import LawCases

COLUMNS = (
    ("stage, law and worst case", "left", "told"),
    ("cases", "right", "cases"),
    ("error", "right", "error", ".2g"),
    ("bound", "right", "bound", ".2g"),
    ("condition", "right", "condition", ".2g"),
    ("verdict", "left", "verdict"),
)


def print_stability(groups: Sequence[LawCases], every: bool, counts: dict[str, int]) -> None:
    """Print ``groups``: one per law and stage, or one per row with ``every``."""
    console = _out()
    rows: list[Document] = []
    for stage, own in groupby(groups, lambda group: group.worst.stage):
        rows.append(dict.fromkeys(one[2] for one in COLUMNS) | {"told": stage})
        rows += [_row(group, every) for group in own]
    title, wrap = "all cases" if every else "worst case of each law", COLUMNS[0][:1]
    console.print(_table(title, *COLUMNS, rows=rows, wrap=wrap, style=lambda row: "" if row["verdict"] else "bold"))
    for group in groups:
        if group.worst.ok is not True:
            console.print(
                f"{escape(group.worst.stage)}, {group.worst.law}, {escape(group.worst.case)}: {escape(group.worst.why)}"
            )
    untried = f", {counts['untried']} not tested" if counts["untried"] else ""
    console.print(
        f"{counts['cases']} cases of {counts['stages']} stages: {counts['held']} passed, {counts['failed']} "
        f"failed{untried}"
    )


def _row(group: LawCases, every: bool) -> Document:
    row = group.worst
    return {
        "told": f"  {row.law}{f': {row.case}' if row.case != 'ordinary' else ''}",
        "cases": None if every else group.cases,
        "error": row.error,
        "bound": row.bound,
        "condition": group.condition,
        "verdict": verdict(group, every),
    }


def verdict(group: LawCases, every: bool) -> str:
    if group.failed:
        return "FAILED" if every or group.cases == 1 else f"{group.failed} FAILED"
    if group.untried:
        return "not tested"
    return "refused" if every and group.worst.why.startswith("refused") else "passed"


@contextmanager
def trying() -> Iterator[Callable[[int, int, str], None]]:
    """Show a progress bar on stderr; silent if stderr is not a terminal."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda done, total, name: None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("parts"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("starting", total=None)
        yield lambda done, total, name: progress.update(task, completed=done, total=total, description=name[:24])


def stability_command(stages: tuple[str, ...], every: bool, seed: int, workers: int | None, as_json: bool) -> None:
    with trying() as told:
        rows = check(stages, workers or 0, told, seed)
    if as_json:
        say(document(rows))
    else:
        show(print_stability, single(rows) if every else groups(rows), every, counts(rows))
    sys.exit(1 if any(row.ok is False for row in rows) else 0)
