"""Terminal output of checks of an archive: reproduced, compared, verified."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TransferSpeedColumn

from etendue.present.terminal.stored import short
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.telling import human_bytes, human_seconds
from etendue.types.documents import Document

MOST = 16  # lines of each kind; --json has all
LONGEST = 1000  # characters of a path


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.2g}"


def _counted(number: int) -> str:
    return str(number or "")


def print_reproduction(document: Document) -> None:
    """Print, for each stage, how many arrays were reproduced and how far the others deviate; then the differences in
    platform and software.
    """
    console = _out()
    table = _table(
        f"{escape(document['archive'])}: {document['verdict']}",
        ("stage", "left", "name"),
        ("arrays", "right", "compared"),
        ("same", "right", "same"),
        ("within", "right", "within", _counted),
        ("wrong", "right", lambda stage: sum(map(stage.get, ("beyond", "unknown", "damaged", "failed"))), _counted),
        ("largest", "right", lambda stage: _figure(stage["largest"]) if stage["same"] < stage["compared"] else ""),
        ("rms", "right", lambda stage: _figure(stage["relative"]) if stage["same"] < stage["compared"] else ""),
        ("bound", "right", lambda stage: _figure(stage["allowed"]) if stage["same"] < stage["compared"] else ""),
        rows=document["stages"],
    )
    console.print(table)
    _print_reasons(console, document)


def _print_reasons(console: Console, document: Document) -> None:
    """Print the reasons why cells and files differ, and the list of unchecked contents."""
    for name, pair in document["platform"]["differs"].items():
        console.print(escape(f"platform  {name}: {pair['then']} then, {pair['now']} now"), soft_wrap=True)
    if document["platform"]["same"]:
        console.print("platform  same: every bit must agree")
    for row in document["software"]:
        what = "its code has changed" if row["what"] == "code" else f"{row['then']} then, {row['now']} now"
        console.print(escape(f"software  {row['stage']}: {what}"), soft_wrap=True)
    for cell in document["not_the_same"]:
        if cell["found"] != "within":
            console.print(
                escape(
                    f"{cell['found']}: {cell['cell']} {cell['variable']}: "
                    f"{cell['why'] or 'rms ' + _figure(cell['relative'])}"
                ),
                soft_wrap=True,
            )
    for one in document["differences"][:MOST]:
        where = f" {one['where']}" if one["where"] else ""
        says = one["says"] or "nothing, or is missing"
        console.print(
            escape(f"differs: {one['file']}{where}: stored {says}; recomputed {one['is'] or 'nothing'}"),
            soft_wrap=True,
        )
    if len(document["differences"]) > MOST:
        console.print(f"... {len(document['differences']) - MOST} more; --json has all")
    for damage in document["damages"][:MOST]:
        console.print(escape(_damage(damage)), soft_wrap=True)
    console.print(f"{document['compared']} cell variables compared in {human_seconds(document['seconds'])}")
    if not document["differences"]:
        console.print("coordinates, units, dims, types, status, tables, records: reproduced")
    for one in document["not_checked"]:
        console.print(escape(f"not checked: {one['what']} ({one['why']})"), soft_wrap=True)
    if any(stage["relative"] for stage in document["stages"]):
        console.print("rms and bound are relative to full scale")


def print_differences(document: Document) -> None:
    """Print, for each stage, the cells that differ between two archives, with size and cause of the differences."""
    console = _out()
    state = "equal" if document["equal"] else "not equal"
    console.print(escape(f"{document['first']} and {document['second']}: {state}"), soft_wrap=True)
    table = _table(
        "",
        ("stage", "left", "name"),
        ("cells", "right", "cells"),
        ("differ", "right", "differing", _counted),
        ("in 1st", "right", "only_first", _counted),
        ("in 2nd", "right", "only_second", _counted),
        ("largest", "right", lambda stage: _figure(stage["largest"]) if stage["differing"] else ""),
        ("rms", "right", lambda stage: _figure(stage["rms"]) if stage["differing"] else ""),
        ("relative", "right", lambda stage: _figure(stage["relative"]) if stage["differing"] else ""),
        rows=document["stages"],
    )
    console.print(table)
    _print_where(console, document)


def _print_where(console: Console, document: Document) -> None:
    """Print the causes of the differences, and the cells that only one archive has."""
    if any(stage["differing"] for stage in document["stages"]):
        console.print(
            "largest, rms: of the difference of the worst cell; relative: rms divided by full scale (inf: it is 0)",
            soft_wrap=True,
        )
    for stage in document["stages"]:
        if stage["since"] and stage["differing"]:
            console.print(escape(f"since  {stage['name']}: {stage['since']}"), soft_wrap=True)
    for stage in document["stages"]:
        for one in stage["worst"]:
            if "why" in one:
                console.print(
                    escape(f"cannot be compared: {one['cell']} {one['variable']}: {one['why']}"), soft_wrap=True
                )
    for which, own in document["only"].items():
        if own["cells"]:
            at = "; ".join(
                f"{dim} {', '.join(f'{v:g}' if isinstance(v, float) else v for v in own['values'][dim][:8])}"
                for dim in own["values"]
            )
            console.print(
                escape(f"only in {document[which]}: {own['cells']} cells{f', at {at}' if at else ''}"), soft_wrap=True
            )


@contextmanager
def reading(silent: bool = False) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar of bytes read on stderr; nothing if stderr is not a terminal."""
    bar = Progress(
        TextColumn("reading"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    if silent or not bar.console.is_terminal:
        yield lambda done, total: None
        return
    task = bar.add_task("reading")

    def told(done: int, total: int) -> None:
        if not bar.live.is_started:
            bar.start()
        bar.update(task, completed=done, total=max(done, total))
        if done >= total:
            bar.stop()

    try:
        yield told
    finally:
        bar.stop()


def print_verified(document: Document) -> None:
    """Print the damage, and the number of bytes read."""
    console = _out()
    for damage in document["damages"][:MOST]:
        console.print(escape(_damage(damage)), soft_wrap=True)
    if len(document["damages"]) > MOST:
        console.print(f"... {len(document['damages']) - MOST} more; --json has all")
    for path in document["beside"][:MOST]:
        console.print(escape(f"foreign: {path}, not written by any run and not verified"), soft_wrap=True)
    if len(document["beside"]) > MOST:
        console.print(f"... {len(document['beside']) - MOST} more foreign files; --json has all")
    if document["partial"]:
        console.print(
            escape(f"left by a killed compact: {document['partial']}; the next compact removes it"),
            soft_wrap=True,
        )
    rate = f", {document['bytes_per_second'] / 1e6:.0f} MB/s" if document["bytes_per_second"] else ""
    read = (
        f"{document['cells']} cells, {document['chunks']} chunks, {human_bytes(document['bytes'])} in "
        f"{human_seconds(document['seconds'])}"
    )
    lost = len(document["cells_lost"])
    places = len(document["damages"])
    found = f"{places} {'damage' if places == 1 else 'damages'}; {lost} {'cell' if lost == 1 else 'cells'} to recompute"
    console.print(escape(f"{document['archive']}: {'whole' if document['whole'] else found}"), soft_wrap=True)
    console.print(f"read {read}{rate}")
    if "sha256" in document:
        console.print(f"sha256 of the archive: {document['sha256']}", soft_wrap=True)
    if not document["whole"]:
        console.print(escape(f"to repair: etendue verify {document['archive']} --repair"), soft_wrap=True)


def _damage(damage: Document) -> str:
    where = f" ({damage['array']})" if damage["array"] and not damage["cell"] else ""
    cell = f", cell {damage['cell']} of {damage['array']}" if damage["cell"] else where
    return short(f"{damage['kind']}: {short(damage['path'], LONGEST)}{cell}: {damage['what']}", 3 * LONGEST)


def print_repaired(document: Document) -> None:
    """Print the damage found, the repairs made, and the damage that remains."""
    console = _out()
    for damage in document["repaired"][:MOST]:
        console.print(escape(f"was {_damage(damage)}"), soft_wrap=True)
    if len(document["repaired"]) > MOST:
        console.print(f"... {len(document['repaired']) - MOST} more; --json has all")
    for text in document["done"][:MOST]:
        console.print(escape(text), soft_wrap=True)
    if document["repaired"]:
        console.print(
            f"{document['computed']} {'cell' if document['computed'] == 1 else 'cells'} computed, {document['failed']} "
            f"failed"
        )
    print_verified(document)
