"""Terminal output of plans, and the tables of all commands.

Results go to stdout, notes to stderr. rich does the drawing and honours NO_COLOR and pipes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape as without_markup
from rich.table import Table

from etendue.plan.designs.told import design_lines
from etendue.present.terminal.cells import Column, cells
from etendue.telling import human_bytes, human_seconds, printable
from etendue.types.documents import Document

MOST_STORED = 6  # variables whose bytes are listed individually
LEAST_TOLD = 1e-3  # seconds; a smaller saving is not mentioned


def escape(text: str) -> str:
    """Return foreign text with markup and control characters neutralised."""
    return without_markup(printable(text))


class _Console(Console):
    """A console that removes control characters from all printed text."""

    def print(self, *objects: Any, **how: Any) -> None:
        super().print(*(printable(o) if isinstance(o, str) else o for o in objects), **how)


class _Table(Table):
    def add_row(self, *cells: Any, **how: Any) -> None:
        super().add_row(*(printable(c) if isinstance(c, str) else c for c in cells), **how)


def _out() -> Console:
    return _Console(highlight=False, soft_wrap=False)


def human_rate(cells_a_second: float) -> str:
    return f"{cells_a_second:.0f} cells/s" if cells_a_second >= 10 else f"{cells_a_second:.2g} cells/s"


def _table(
    title: str,
    *columns: Column,
    rows: Sequence[Any] = (),
    wrap: tuple[str, ...] = (),
    style: Callable[[Any], str] = lambda row: "",
) -> Table:
    """Return a table; only columns in ``wrap`` are broken into lines. ``style`` returns the style of a row, such as
    bold.
    """
    table = _Table(title=title, title_justify="left", box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    for name, justify, *_ in columns:
        broken = name in wrap
        table.add_column(escape(name), justify=justify, no_wrap=not broken, overflow="fold" if broken else "ellipsis")
    for row, texts in zip(rows, cells(columns, rows), strict=True):
        table.add_row(*map(escape, texts), style=style(row))
    return table


def _print_whole(console: Console, title: str, columns: Sequence[Column], rows: Sequence[Any], keys: int = 1) -> None:
    """Print a table without ellipses: if the terminal is too narrow, split it into parts that repeat the first
    columns.
    """
    told, heads = cells(columns, rows), [column[0] for column in columns]
    widths = [max(cell_len(printable(text)) for text in column) + 3 for column in zip(heads, *told, strict=True)]
    parts: list[list[int]] = [[]]
    for column in range(keys, len(columns)):
        if parts[-1] and sum(widths[:keys]) + sum(widths[i] for i in (*parts[-1], column)) - 3 > console.width:
            parts.append([])
        parts[-1].append(column)
    for number, part in enumerate(parts):
        chosen = [*range(keys), *part]
        own = [[row[i] for i in chosen] for row in told]
        console.print(_table("" if number else title, *(columns[i][:2] for i in chosen), rows=own))


def short_axes(keys: Iterable[str]) -> dict[str, str]:
    """Return short names of axes: 'spacing' for 'grid_spacing', 'filter' for 'filter.use'; the key itself if two short
    names would be equal.
    """
    short = {}
    for key in keys:
        stage, _, parameter = key.rpartition(".")
        name = stage if parameter == "use" else parameter
        short[key] = name if len(name) <= 8 else name.rpartition("_")[2]
    return {key: name if list(short.values()).count(name) == 1 else key for key, name in short.items()}


def _product(names: Iterable[str]) -> str:
    """Return 'gain*spacing*time'; if the text is long, add blanks at which lines may break."""
    names = list(names)
    text = "*".join(names) or "-"
    return text if len(text) <= 24 else " * ".join(names)


def _axis(axis: Document, short: str) -> str:
    """Return a line such as 'spacing = grid_spacing: 2.8, 5.4 um (2)'; of more than four values, the first and last."""
    values = [f"{v:g}" if isinstance(v, float) else str(v) for v in axis["values"]]
    units = f" {axis['units']}" if axis["units"] not in (None, "1") else ""
    shown = ", ".join(values) if len(values) <= 4 else f"{values[0]} .. {values[-1]}"
    return f"{'' if short == axis['name'] else short + ' = '}{axis['name']}: {shown}{units} ({len(values)})"


def _uses(stages: list[Document]) -> list[str]:
    """Return 'filter is filter_fast' for every stage whose name differs from its ``use``."""
    texts = []
    for stage in stages:
        uses = stage["use"] if isinstance(stage["use"], list) else [stage["use"]]
        if uses != [stage["name"]]:
            texts.append(f"{stage['name']} is {' or '.join(dict.fromkeys(uses))}")
    return texts


def _bound(stages: list[Document]) -> list[str]:
    """Return lines for the shared quantities that one stage computes for later stages, and for the stages that are run
    once for each index of a dim.
    """
    found: dict[tuple[str, str], list[str]] = {}
    mapped: dict[str, list[str]] = {}
    for stage in stages:
        for name, finder in (stage["found"] or {}).items():
            found.setdefault((name, finder), []).append(stage["name"])
        if stage["one_by_one"]:
            mapped.setdefault(" ".join(stage["one_by_one"]), []).append(stage["name"])
    texts = [
        f"found     {name}: from {finder}, used by {', '.join(takers)}" for (name, finder), takers in found.items()
    ]
    return texts + [f"for each  {dims}: {', '.join(names)}" for dims, names in mapped.items()]


def _stored(document: Document) -> list[str]:
    """Return the stored bytes by variable, largest first, and the bytes for each choice of `keep`."""
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


def plan_columns(product: Callable[[Iterable[str]], str]) -> tuple[Column, ...]:
    """Return the columns of the table of stages in a plan."""
    return (
        ("stage", "left", "name"),
        ("axes", "left", "axes", product),
        ("cells", "right", "cells"),
        ("left out", "right", lambda stage: stage["left_out"] and stage["left_out"]["cells"]),
        ("stored", "right", "bytes", human_bytes),
        ("time", "right", lambda stage: expected_seconds(stage) if stage["cells"] else _without_time(stage)),
    )


def expected_seconds(document: Document) -> str:
    """Return the expected run time (s) as text, with '~' if this machine has not run the stages yet."""
    return f"{'' if document.get('seconds_known', True) else '~'}{human_seconds(document['seconds'])}"


def _without_time(stage: Document) -> str:
    """Return the word shown instead of a time: ``reused`` for earlier results, ``not needed`` if no wanted variable
    needs the stage.
    """
    return "reused" if stage["cells"] else "not needed"


def print_plan(document: Document) -> None:
    """Print the plan as a table, and the omissions with their reasons."""
    console = _out()
    short = short_axes(axis["name"] for axis in document["axes"] if not axis.get("of"))
    short = {axis["name"]: short.get(axis["name"], axis["name"]) for axis in document["axes"]}
    columns = plan_columns(lambda axes: _product(short[key] for key in axes))
    title = f"plan of {escape(document['name'])}"
    console.print(_table(title, *columns, rows=document["stages"], wrap=("axes",)))
    for text in _stored(document):
        console.print(escape(text))
    for axis in document["axes"]:
        console.print(f"axis      {escape(_axis(axis, short[axis['name']]))}")
    for text in design_lines(document):
        console.print(escape(text))
    for text in _uses(document["stages"]):
        console.print(f"stage     {text}")
    for text in _bound(document["stages"]):
        console.print(escape(text))
    for stage in document["stages"]:
        for text in omission_lines(stage["name"], stage["left_out"], stage["approximated"]):
            console.print(escape(text))
    console.print(
        f"{document['cells']} cells ({document['naive_cells']} if every stage ran at every point), "
        f"{human_bytes(document['bytes'])} before compression, about {expected_seconds(document)} of thread "
        f"time, "
        f"peak memory {human_bytes(document['peak_memory'])}, {document['precision']}"
    )
    if (digits := document.get("digits")) is not None:
        console.print(
            f"digits    stated: within {digits['tolerance']:g} of full scale, about {human_bytes(digits['bytes'])}; "
            f"exact: {human_bytes(document['bytes'])}, both before compression"
        )
    notes = _Console(stderr=True, highlight=False)
    for text in document["warnings"]:
        notes.print(f"note: {escape(text)}")


def _saving(seconds: float | None) -> str:
    """Return '; saves about ... s', to end a sentence; '' if the saving is unknown or too small to mention."""
    return f"; saves about {seconds:.2g} s" if seconds is not None and seconds >= LEAST_TOLD else ""


def _at_most(at_stage: float, at_wanted: float) -> str:
    """Return the text of an error bound at the stage, and in the wanted results if the bound differs there."""
    grown = f", {at_wanted:.2g} in the results" if f"{at_wanted:.2g}" != f"{at_stage:.2g}" else ""
    grown = grown if at_wanted < 1 else ", not bounded below full scale in the results"
    return f"at most {at_stage:.2g} of full scale at this stage{grown}"


def omission_lines(name: str, left: Document | None, knobs: list[Document] | None) -> list[str]:
    """Return sentences that state the omission and the knob settings of a stage."""
    said = []
    if left:
        wrong = "exactly" if left["bound"] == 0 else f"error {_at_most(left['at_stage'], left['bound'])}"
        copies = f"; their copies take {human_bytes(left['copies'])}" if left["copies"] else ""
        said.append(
            f"left out  {name} in {left['cells']} of {left['of']} cells, {wrong}: "
            f"{left['why']}{_saving(left['seconds_saved'])}{copies}"
        )
    by_knob: dict[str, list[Document]] = {}
    for one in knobs or ():
        by_knob.setdefault(one["knob"], []).append(one)
    for knob, own in by_knob.items():
        worst = _at_most(max(one["at_stage"] for one in own), max(one["bound"] for one in own))
        saved = None if any(one["seconds_saved"] is None for one in own) else sum(one["seconds_saved"] for one in own)
        values = ", ".join(f"{one['value']} ({one['cells']})" if len(own) > 1 else f"{one['value']}" for one in own)
        best = str(own[0]["reference"])
        value, _, meaning = own[0].get("best", "").partition(":")  # documents of earlier versions have none
        if meaning and value == best:
            best = f"{best} ({meaning.strip()})"
        said.append(f"coarser   {name}.{knob} = {values}; the best setting is {best}: {worst}{_saving(saved)}")
    return said
