"""Suggestions after a run: the command that plots its results, and the list of possible plots.

In:  the outcome of a run; the content of an archive.
Out: lines of text.
"""

from __future__ import annotations

import os
import shlex
from typing import Any

from etendue.present.pictures.small_maps import small_maps
from etendue.telling import printable
from etendue.types.documents import Document


def next_commands(outcome: Any) -> list[str]:
    """Return the commands that plot the results."""
    place = shlex.quote(str(outcome.archive) if "://" in str(outcome.archive) else os.path.relpath(outcome.archive))
    place = place if not place.startswith("..") else shlex.quote(str(outcome.archive))
    chosen = small_maps(outcome.plan)
    kinds = (
        [f"map {chosen[0].variable}", "pareto"] if len(chosen) > 1 else [f"map {chosen[0].variable}"] if chosen else []
    )
    kinds += ["strip", "budget"]
    if any(axis.rows for axis in outcome.plan.axes):  # a map of samples shows nothing
        metric = chosen[0].variable if chosen else "METRIC"
        return [f"what matters   etendue sensitivity {place} {metric}  (or plot {place} scatter; see plot --list)"]
    return [f"plot it        etendue plot {place} {kinds[0]}  (or {', '.join(kinds[1:])}; see --list)"]


def plots_text(document: Document) -> list[str]:
    """Return the lines that list everything that can be plotted from an archive."""
    lines = []
    for name, what in document["kinds"].items():
        lines.append(f"kind {name:8s} {what}")
    for axis, values in document["axes"].items():
        shown = ", ".join(values[:8]) + (f", ... ({len(values)})" if len(values) > 8 else "")
        lines.append(printable(f"axis {axis}: {shown}"))
    wide = max((len(one["name"]) for one in document["variables"]), default=0)
    for one in document["variables"]:
        own = ", ".join([*one["axes"], *(f"[{dim}]" for dim in one["dims"])]) or "one value"
        unit = f"  in {one['units']}" if one["units"] else ""
        better = f"  {one['better']} is better" if one["better"] else ""
        kind = "metric" if one["kind"] == "figure" else one["kind"]
        lines.append(printable(f"{kind:8s} {one['name']:{wide}s}  over {own}{unit}{better}"))
    return lines
