"""Terminal output of a search.

In:  the document of a search.
Out: the best settings or, for several goals, the Pareto front, and the number of trials that met the limits.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.types.documents import Document
from etendue_lab.search.asked import read_request
from etendue_lab.search.drawn import drawn
from etendue_lab.search.study import Trial, search


def print_search(document: Document) -> None:
    """Print the result of a search."""
    console, best = _out(), document["best"]
    goals = [*document["minimise"], *document["maximise"]]
    names = [text.partition(" = ")[0] for text in document["over"]]
    limits = f", subject to {' and '.join(document['subject'])}" if document["subject"] else ""
    title = f"{document['pipeline']}: {'largest' if document['maximise'] else 'smallest'} {', '.join(goals)}{limits}"
    columns = (
        ("trial", "right", "number"),
        *((name, "right", "settings", lambda own, name=name: _short(own[name])) for name in names),
        *((goal, "right", "values", lambda own, goal=goal: f"{own[goal]:.5g}") for goal in goals),
    )
    console.print(_table(escape(title), *columns, rows=best))
    count, failed, outside = len(document["trials"]), document["failed"], document["outside"]
    if document["importance"]:
        shares = (f"{name} {100 * share:.0f} %" for name, share in document["importance"].items())
        console.print(f"importance for {goals[0]}: {', '.join(shares)}")
    console.print(
        f"{count} trials, {document['recalled']} of them from an earlier call: {outside} beyond a limit, "
        f"{failed} failed; seed {document['seed']}, {document['sampler']}"
    )
    for note in document["notes"]:
        console.print(f"note: {escape(note)}")
    if document.get("folder"):
        console.print(f"written to {escape(document['folder'])}")


def _short(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _said(trial: Trial, best: bool) -> None:
    """Print a trial that is the best so far, on stderr."""
    if best:
        settings = ", ".join(f"{name} {_short(value)}" for name, value in trial.settings.items())
        values = ", ".join(f"{value:.5g}" for value in trial.values)
        print(f"trial {trial.number}: {values} at {settings}", file=sys.stderr, flush=True)


def optimise_command(given: options.Given, trials: int, output: Path | None, as_json: bool, **asked: Any) -> None:
    pipeline = given.pipeline()
    how = {name: asked.pop(name) for name in ("seed", "sampler")}
    request = replace(read_request(pipeline, options.installed(), **asked), **how)
    folder = output or Path(f"{pipeline.name}-search")
    found = search(pipeline, request, trials, folder, _said)
    document = found.document() | {"folder": str(folder)}
    drawn(document).save(folder / "history.png")
    tell(as_json, document, print_search)
    if not document["best"]:
        raise SystemExit(3)
