"""Terminal summary of an archive: its runs, axes and stages, with the finished cells.

In:  the document that describes an archive.
Out: lines on stdout.
"""

from __future__ import annotations

import re

from rich.console import Console

from etendue.present.terminal.terminal import _out, _product, escape, human_rate, short_axes
from etendue.telling import human_bytes, human_seconds
from etendue.types.documents import Document


def _span(sizes: list[int]) -> str:
    """Return a size as text: '32', or '24..48' if it differs between the cells of a stage."""
    return f"{min(sizes)}" if min(sizes) == max(sizes) else f"{min(sizes)}..{max(sizes)}"


def short(text: str, most: int = 200) -> str:
    """Return a name found in an archive, shortened to one line."""
    said = str(text)
    return said if len(said) <= most else f"{said[:most]}... ({len(said)} characters)"


def print_archive(document: Document) -> None:
    console = _out()
    runs = "1 run" if document["runs"] == 1 else f"{document['runs']} runs"
    state = "a run is in progress" if document["running"] else f"{runs}, the last started {document['began']}"
    console.print(
        f"{document['archive']}: pipeline {short(document['pipeline'])}, {human_bytes(document['bytes'])}, {state}"
    )
    if document["partial"]:
        console.print(
            escape(f"left by a killed compact: {document['partial']}; the next compact removes it"),
            soft_wrap=True,
        )
    planned, finished = document["planned"], document["finished"]
    if planned:
        share = f"{100 * finished // planned} %" if finished < planned else "all"
        console.print(f"cells {finished} of {planned} requested by the last run ({share})")
    if document["rate"]:
        left = "" if document["left"] is None else f", about {human_seconds(max(round(document['left']), 1))} left"
        console.print(f"pace  {human_rate(document['rate'])} since it started{left}")
    for axis, values in document["axes"].items():
        shown = ", ".join(map(short, values[:8])) + (f", ... ({len(values)})" if len(values) > 8 else "")
        console.print(f"axis {short(axis)}: {shown}")
    parts = {key for key in document["axes"] for whole in document["axes"] if key.startswith(f"{whole}_")}
    short_names = short_axes(key for key in document["axes"] if key not in parts) | {key: key for key in parts}
    axes = {re.sub(r"\.use$", "", key).replace(".", "_"): name for key, name in short_names.items()}
    for stage in document["stages"]:
        _print_stage(console, document, stage, axes)
    for study in document.get("studies", ()):
        stale = f"; out of date: {study['stale']}; run the command again" if study["stale"] else ""
        console.print(escape(f"study {short(study['group'])}, of {study['cells']} cells{stale}"), soft_wrap=True)
    console.print(f"open it: xarray.open_datatree('{document['store']}', engine='zarr')", soft_wrap=True)


def _print_stage(console: Console, document: Document, stage: Document, axes: dict[str, str]) -> None:
    """Print the cells of a stage, and each variable once, although cells of different sizes are stored in separate
    groups.
    """
    cells = ", ".join(f"{n} {s}" for s, n in stage["cells"].items()) or "not started"
    if document["running"] and stage["planned"]:
        cells = f"{stage['finished']} of {stage['planned']}"
    groups = dict.fromkeys(v["group"] for v in stage["variables"]) or {f"{stage['name']} (not kept)": None}
    parts: dict[tuple[str, ...], list[Document]] = {}
    for v in stage["variables"]:
        parts.setdefault((v["variable"], v["units"], *(d for d in v["dims"] if d not in axes)), []).append(v)
    reach = list(dict.fromkeys(axes[d] for v in stage["variables"] for d in v["dims"] if d in axes))
    title = next(iter(groups)) if len(groups) == 1 else f"{stage['name']} ({len(groups)} sizes)"
    console.print(f"{title:28s} {cells:20s} {_product(reach)}")
    for (variable, units, *dims), own in parts.items():
        inner = " ".join(f"{d}={_span([v['dims'][d] for v in own])}" for d in dims)
        unit = f"[{short(units)}]" if units not in ("", "1") else ""
        same = f"  left out: {short(own[0]['same_as'])}" if "same_as" in own[0] else ""
        console.print(escape(f"    {variable:24s} {inner:27s} {unit}{same}").rstrip())
