"""Rendering of a run's outcome: the summary of the archive or of the tree in memory, and a description of this run.

In:  the outcome of a run.
Out: HTML for a notebook, lines for a terminal.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from etendue.present.plots.opening import opened
from etendue.present.plots.summary import page
from etendue.present.plots.summary.contents import UNREADABLE, Glance, glance
from etendue.telling import human_seconds, printable


def outcome_text(outcome: Any) -> str:
    own, why = _seen(outcome)
    said = page.text(own) if own else printable(why)
    return f"<run of {outcome.plan.pipeline.name}: {_done(outcome)}>" + (f"\n{said}" if said else "")


def outcome_page(outcome: Any) -> str:
    own, _ = _seen(outcome)
    return page.page(own, f"this run: {_done(outcome)}") if own else f"<pre>{page.safe(outcome_text(outcome))}</pre>"


def _seen(outcome: Any) -> tuple[Glance | None, str]:
    """Return the summary; or None and the reason: the archive is damaged, missing, or in an object store, where the
    caller opens it.
    """
    tree = outcome.tree
    try:
        if tree is None and outcome.archive is not None and "://" not in str(outcome.archive):
            tree = opened(Path(outcome.archive))
        return (glance(tree) if tree is not None else None), ""
    except UNREADABLE as error:
        return None, str(error)


def _done(outcome: Any) -> str:
    parts = [
        f"{outcome.computed} {'cell' if outcome.computed == 1 else 'cells'} computed",
        f"{len(outcome.reused)} reused",
    ]
    parts += [f"{len(outcome.failed)} failed"] if outcome.failed else []
    return f"{', '.join(parts)}, {human_seconds(outcome.seconds)}"
