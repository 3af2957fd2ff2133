"""A comparison as files and on the terminal: table, CSV, JSON, plot, crops.

In:  a ``Comparison``.
Out: rows as plain values; a folder with compare.csv, compare.json, error_against_time.png, crops.png.
"""

from __future__ import annotations

import csv
import json
import math
import os
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from etendue.report.crops import Strip, strip
from etendue.report.work_precision import Point, work_precision
from etendue.studies.compare import FIGURES, Comparison, Row

PLOT, CROPS = "error_against_time.png", "crops.png"
MOST_CROPS = 9
NARROW, WIDE, UNBOUNDED = 112, 150, 200  # columns of a terminal that hold all figures, and the distributions beside them
UNITS = {
    "psnr": "dB", "psnr_encoded": "dB", "rmse": "1", "ssim": "1", "delta_e": "CIEDE2000", "zipper": "1", "false_colour": "CIELAB",
    "mtf50": "cycles/pixel", "mtf50_reference": "cycles/pixel", "seconds": "s", "mpixel_per_second": "Mpixel/s",
    "seconds_per_mpixel": "s/Mpixel",
}  # fmt: skip
DISPENSABLE = ("zipper", "false colour")


def document(found: Comparison) -> dict[str, Any]:
    """The comparison as JSON: what is not known is null."""
    return {
        "pipeline": found.pipeline,
        "axis": found.key,
        "rows": [row_document(found.key, number, row) for number, row in enumerate(found.rows, 1)],
        "reference": {
            "stage": found.reference[0],
            "variable": found.reference[1],
            "without": found.without or None,
        },
        "measured_at": f"{found.variable[0]}.{found.variable[1]}",
        "noise": found.noise,
        "size": list(found.size),
        "at": {key: _plain(value) for key, value in found.at.items()},
        "units": UNITS,
        "notes": found.notes,
    }


def row_document(key: str, number: int, row: Row) -> dict[str, Any]:
    return {
        key: _plain(row.value),
        "label": row.label,
        "rank": number if row.psnr is not None else None,
        "distribution": row.distribution or None,
        "version": row.version or None,
        **{name: _finite(getattr(row, name)) for name in FIGURES},
        "pareto": row.pareto,
        "status": row.status,
        "reason": row.reason or None,
    }


def _finite(value: float | None) -> float | str | None:
    if value is None or math.isnan(value):
        return None
    return value if math.isfinite(value) else "inf" if value > 0 else "-inf"


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool) or value is None else str(value)


def print_comparison(found: Comparison, files: list[Path]) -> None:
    """The table, best first, and what there is to say about it."""
    console = Console(highlight=False, soft_wrap=False)
    if not console.is_terminal:
        console.width = max(console.width, UNBOUNDED)
    height, width = found.size
    title = f"{escape(found.pipeline)}: {escape(found.key)} by PSNR at {found.variable[0]}.{found.variable[1]}, {width} x {height} pixels"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, show_edge=False, pad_edge=False)
    columns = _columns(found)
    shown = [c for c in columns if console.width >= NARROW or c.name not in DISPENSABLE]
    origins = {row.label: f"{row.distribution} {row.version}" for row in found.rows if row.distribution}
    beside = bool(origins) and console.width >= WIDE
    table.add_column("", justify="right", no_wrap=True)
    table.add_column("alternative", overflow="fold")
    for column in shown:
        table.add_column(column.name, justify="right", no_wrap=True)
    if beside:
        table.add_column("from", no_wrap=True)
    for number, row in enumerate((r for r in found.rows if r.psnr is not None), 1):
        end = [origins.get(row.label, "")] if beside else []
        table.add_row(str(number), escape(row.label), *(c.of(row) for c in shown), *end)
    ideal = {row.mtf50_reference for row in found.rows} - {None}
    if len(ideal) == 1:
        known = {"MTF50": _number(ideal.pop(), ".3f")}
        table.add_row("", "reference", *(known.get(c.name, "") for c in shown), *([""] if beside else []), style="dim")
    console.print(table)
    for word, text in _remarks(found, {} if beside else origins):
        console.print(f"{word:<10}{escape(text)}", soft_wrap=True)
    if len(shown) < len(columns):
        console.print(
            f"{'more':<10}{', '.join(DISPENSABLE)}: in compare.csv, and here where the terminal is {NARROW} columns wide", soft_wrap=True
        )
    for path in files:
        console.print(f"{'file':<10}{escape(str(path))}", soft_wrap=True)


def _own_reference(found: Comparison) -> bool:
    return len({row.mtf50_reference for row in found.rows} - {None}) > 1


class _Column(NamedTuple):
    name: str
    of: Callable[[Row], str]


def _columns(found: Comparison) -> list[_Column]:
    columns = [
        _Column("PSNR", lambda r: _number(r.psnr, ".2f")),
        _Column("encoded", lambda r: _number(r.psnr_encoded, ".2f")),
        _Column("dE00", lambda r: _number(r.delta_e, ".2f")),
        _Column("zipper", lambda r: "-" if r.zipper is None else f"{100 * r.zipper:.1f} %"),
        _Column("false colour", lambda r: _number(r.false_colour, ".2f")),
        _Column("MTF50", lambda r: _number(r.mtf50, ".3f")),
    ]
    if _own_reference(found):  # the axis reaches the reference too
        columns.append(_Column("ideal", lambda r: _number(r.mtf50_reference, ".3f")))
    if any(row.seconds is not None for row in found.rows):
        columns.append(_Column("time", lambda r: _milliseconds(r.seconds)))
        columns.append(_Column("Mpixel/s", lambda r: _number(r.mpixel_per_second, ".1f") + ("*" if r.pareto else " ")))
    return columns


def _remarks(found: Comparison, origins: dict[str, str]) -> list[tuple[str, str]]:
    """Lines below the table: a word, and what it is about."""
    lines = []
    for row in found.rows:
        if row.status != "done":
            origin = f" ({row.distribution} {row.version})" if row.distribution else ""
            lines.append((row.status, f"{row.label}{origin}: {row.reason}"))
    if origins:
        by_origin: dict[str, list[str]] = {}
        for label, origin in origins.items():
            by_origin.setdefault(origin, []).append(label)
        lines += [("from", f"{origin}: {', '.join(labels)}") for origin, labels in by_origin.items()]
    without = f", which does without {found.without}" if found.without else ""
    each = "; each value has its own" if _own_reference(found) else ""
    lines.append(("reference", f"noise-free full planes of the same pixels, through the same later stages{without}{each}"))
    lines.append(("PSNR", "dB, full scale 1; encoded, dE00 (CIEDE2000), zipper, false colour: of the finished picture"))
    lines.append(("MTF50", "cycles/pixel across a slanted edge, noise-free"))
    if any(row.seconds is not None for row in found.rows):
        lines.append(("time", "of the stage alone, one thread; * nothing better is as fast"))
    lines.append(("noise", found.noise))
    if found.at:
        lines.append(("at", f"{', '.join(f'{k} = {_plain(v)}' for k, v in found.at.items())}: the first of the file's sweep"))
    return lines + [("note", text) for text in found.notes]


def _number(value: float | None, form: str) -> str:
    if value is None or math.isnan(value):
        return "-"
    return format(value, form)


def _milliseconds(value: float | None) -> str:
    return "-" if value is None else f"{1e3 * value:.2f} ms" if value < 1 else f"{value:.2f} s"


def write_files(found: Comparison, folder: Path) -> list[Path]:
    """CSV, JSON, and the pictures that there is something to draw for. Each is written whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    written = [_write(folder / "compare.csv", csv_text(found).encode()), _write(folder / "compare.json", _json(found).encode())]
    points = [
        Point(row.label, row.seconds_per_mpixel, row.rmse, row.pareto)
        for row in found.rows
        if row.seconds_per_mpixel and row.rmse  # neither can be 0 on logarithmic axes
    ]
    if points:
        title = f"{found.pipeline}: {found.key}"
        written.append(_write(folder / PLOT, work_precision(points, title, f"rms error of {found.variable[1]}, full scale 1")))
    best = [row for row in found.rows if row.label in found.pictures][:MOST_CROPS]
    if found.reference_picture is not None and best:
        pictures = [Strip("reference", found.reference_picture)]
        pictures += [Strip(f"{row.label}  {_number(row.psnr, '.2f')} dB", found.pictures[row.label]) for row in best]
        encoded = any(row.psnr_encoded is not None for row in best)
        written.append(_write(folder / CROPS, strip(pictures, encoded, f"{found.pipeline}: where they differ most")))
    for name in (PLOT, CROPS):  # of an earlier comparison
        if folder / name not in written:
            (folder / name).unlink(missing_ok=True)
    return written


def csv_text(found: Comparison) -> str:
    text = StringIO()
    rows = document(found)["rows"]
    table = csv.DictWriter(text, list(rows[0]) if rows else ["label"], lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def _json(found: Comparison) -> str:
    return json.dumps(document(found), indent=1, allow_nan=False) + "\n"


def _write(path: Path, data: bytes) -> Path:
    temporary = path.with_name(path.name + ".partial")
    temporary.write_bytes(data)
    os.replace(temporary, path)
    return path
