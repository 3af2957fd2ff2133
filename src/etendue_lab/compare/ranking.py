"""A comparison as files and on the terminal: table, CSV, JSON, plot, crops.

In:  a ``Comparison``.
Out: rows as plain values; a folder with compare.csv, compare.json, error_against_time.png, crops.png.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from etendue.cli import options
from etendue.cli.saying import say, show
from etendue.present.pictures.crops import Strip, strip
from etendue.present.terminal.cells import Column
from etendue.present.terminal.terminal import _out, _table, escape
from etendue.present.terminal.work_precision import Point, work_precision
from etendue.result_files import check_folder, finite, write_whole
from etendue.types.documents import Document
from etendue_lab.compare.axis import parse_axis
from etendue_lab.compare.compared import FIGURES, ComparedRow
from etendue_lab.compare.study import Comparison
from etendue_lab.compare.study import compare as measure

if TYPE_CHECKING:
    from etendue.types.documents import Scalar

PLOT, CROPS = "error_against_time.png", "crops.png"
MOST_CROPS = 9
# columns of a terminal that fit all metrics, and the distributions beside them
NARROW, WIDE, UNBOUNDED = (112, 150, 200)
UNITS = {
    "psnr": "dB",
    "psnr_white": "dB",
    "psnr_encoded": "dB",
    "rmse": "1",
    "ssim": "1",
    "delta_e": "CIEDE2000",
    "zipper": "1",
    "false_colour": "CIELAB",
    "mtf50": "cycles/pixel",
    "mtf50_reference": "cycles/pixel",
    "seconds": "s",
    "mpixel_per_second": "Mpixel/s",
    "seconds_per_mpixel": "s/Mpixel",
    "error": "1",
}
DISPENSABLE = ("zipper", "false colour")


def document(found: Comparison) -> Document:
    """Return the comparison as JSON: unknown values are null."""
    return {
        "pipeline": found.pipeline,
        "axis": found.key,
        "rank_by": found.rank_by,
        "rows": [row_document(found, number, row) for number, row in enumerate(found.rows, 1)],
        "reference": {
            "stage": found.reference[0],
            "variable": found.reference[1],
            "without": found.without or None,
            "of_each_value": found.own_reference,
        },
        "measured_at": f"{found.variable[0]}.{found.variable[1]}",
        "noise": found.noise,
        "size": list(found.size),
        "at": {key: _plain(value) for key, value in found.at.items()},
        "first_of_sweep": list(found.first),
        "units": UNITS | ({found.key: found.units} if found.units else {}),
        "notes": found.notes,
    }


def row_document(found: Comparison, number: int, row: ComparedRow) -> Document:
    return {
        found.key: _plain(row.value),
        "label": row.label,
        "rank": number if getattr(row, found.rank_by) is not None else None,
        "distribution": row.distribution or None,
        "version": row.version or None,
        **{name: finite(getattr(row, name)) for name in FIGURES},
        "pareto": row.pareto,
        "status": row.status,
        "reason": row.reason or None,
    }


def _plain(value: object) -> Scalar:
    return value if isinstance(value, str | int | float | bool) or value is None else str(value)


def print_comparison(found: Comparison, files: list[Path]) -> None:
    """Print the table, best first, and remarks."""
    console = _out()
    if not console.is_terminal:
        console.width = max(console.width, UNBOUNDED)
    columns = _columns(found)
    shown = [c for c in columns if console.width >= NARROW or c[0] not in DISPENSABLE]
    origins = {id(row): f"{row.distribution} {row.version}" for row in found.rows if row.distribution}
    beside = bool(origins) and console.width >= WIDE
    console.print(_table_of(found, [*shown, *([FROM] if beside else [])]))
    for word, text in _remarks(found, {} if beside else origins):
        console.print(f"{word:<10}{escape(text)}", soft_wrap=True)
    if len(shown) < len(columns):
        console.print(
            f"{'more':<10}{', '.join(DISPENSABLE)}: in compare.csv, and here if the terminal is {NARROW} columns wide",
            soft_wrap=True,
        )
    for path in files:
        console.print(f"{'file':<10}{escape(str(path))}", soft_wrap=True)


def _table_of(found: Comparison, shown: list[Column]) -> Table:
    """Return the table of alternatives. If MTF50 of the reference is the same for all rows, the last line shows it."""
    height, width = found.size
    title = f"{escape(found.pipeline)}: {escape(found.key)} by {_ranked_by(found)}, {width} x {height} pixels"
    rows = [{"rank": number} | vars(row) for number, row in enumerate((r for r in found.rows if r.psnr is not None), 1)]
    columns = (("", "right", "rank"), ("alternative", "left", "label"), *shown)
    table = _table(title, *columns, rows=rows, wrap=("alternative",))
    ideal = {row.mtf50_reference for row in found.rows} - {None}
    if len(ideal) == 1:
        known = {"alternative": "reference", "MTF50": _number(ideal.pop(), ".3f")}
        table.add_row(*(known.get(name, "") for name, *_ in columns), style="dim")
    return table


def _ranked_by(found: Comparison) -> str:
    place = f"{found.variable[0]}.{found.variable[1]}"
    if found.rank_by == "psnr_encoded":
        return "PSNR of the encoded picture"
    return f"PSNR at {place}" + (
        ", relative to the brightest value of each reference" if found.rank_by == "psnr_white" else ""
    )


def _columns(found: Comparison) -> list[Column]:
    columns: list[Column] = [
        ("PSNR", "right", "psnr", ".2f", "-"),
        *([("own scale", "right", "psnr_white", ".2f", "-")] if found.rank_by == "psnr_white" else []),
        ("encoded", "right", "psnr_encoded", ".2f", "-"),
        ("dE00", "right", "delta_e", ".2f", "-"),
        ("zipper", "right", "zipper", lambda share: f"{100 * share:.1f} %", "-"),
        ("false colour", "right", "false_colour", ".2f", "-"),
        ("MTF50", "right", "mtf50", ".3f", "-"),
    ]
    if len({row.mtf50_reference for row in found.rows} - {None}) > 1:
        columns.append(("ideal", "right", "mtf50_reference", ".3f", "-"))
    if any(row.seconds is not None for row in found.rows):
        columns += [("error", "right", "error", ".2g", "-"), ("time", "right", "seconds", _seconds, "-"), SPEED]
    return columns


def _remarks(found: Comparison, origins: dict[int, str]) -> list[tuple[str, str]]:
    """Return the lines below the table, each as a keyword and its explanation."""
    lines = []
    for row in found.rows:
        if row.status != "done":
            origin = f" ({row.distribution} {row.version})" if row.distribution else ""
            lines.append((row.status, f"{row.label}{origin}: {row.reason}"))
    if origins:
        by_origin: dict[str, list[str]] = {}
        for row in found.rows:
            if id(row) in origins:
                by_origin.setdefault(origins[id(row)], []).append(row.label)
        lines += [("from", f"{origin}: {', '.join(labels)}") for origin, labels in by_origin.items()]
    without = f", without {found.without}" if found.without else ""
    each = "; each value has its own reference" if found.own_reference else ""
    lines.append(
        ("reference", f"noise-free full planes of the same pixels through the same later stages{without}{each}")
    )
    if found.own_reference:
        lines.append(
            (
                "rank",
                f"by {_ranked_by(found)}: references of different light cannot be compared on one linear scale",
            )
        )
    lines.append(("PSNR", "dB, full scale 1; encoded, dE00 (CIEDE2000), zipper, false colour: on the finished picture"))
    lines.append(("MTF50", "cycles/pixel across a slanted edge, noise-free; ideal: the value for the reference"))
    if any(row.seconds is not None for row in found.rows):
        lines.append(
            ("error", "rms, full scale 1, of the ranking metric; plotted against time in error_against_time.png")
        )
        lines.append(("time", "of the stage alone, one thread; * on the Pareto front"))
    lines.append(("noise", found.noise))
    for keys, text in (
        ([k for k in found.at if k not in found.first], "from the file, in place of its sweep"),
        (found.first, "the first value of the file's sweep"),
    ):
        if keys:
            lines.append(("at", f"{', '.join(f'{k} = {_plain(found.at[k])}' for k in keys)}: {text}"))
    return lines + [("note", text) for text in found.notes]


def _number(value: float | None, form: str) -> str:
    if value is None or math.isnan(value):
        return "-"
    return format(value, form)


def _seconds(value: float) -> str:
    return f"{1e3 * value:.2f} ms" if value < 1 else f"{value:.2f} s"


FROM = ("from", "left", lambda row: f"{row['distribution']} {row['version']}" if row["distribution"] else "")
SPEED = ("Mpixel/s", "right", lambda r: _number(r["mpixel_per_second"], ".1f") + ("*" if r["pareto"] else " "))


def write_files(found: Comparison, folder: Path) -> list[Path]:
    """Write CSV, JSON, and the pictures that have content. All are made before the first is written."""
    pictures = {PLOT: _plot(found), CROPS: _crops(found)}  # may add a note
    files = {"compare.csv": csv_text(found).encode(), "compare.json": _json(found).encode()}
    written = write_whole(folder, files | {name: data for name, data in pictures.items() if data})
    for name, data in pictures.items():
        if not data:  # left by an earlier comparison
            (folder / name).unlink(missing_ok=True)
    return written


def _plot(found: Comparison) -> bytes:
    """Plot the error of the ranking metric against run time; empty if there is nothing to plot."""
    points = []
    for row in found.rows:
        if row.seconds_per_mpixel and row.error:  # neither can be 0 on logarithmic axes
            points.append(Point(row.label, row.seconds_per_mpixel, row.error, row.pareto))
    lacking = [row.label for row in found.rows if row.seconds_per_mpixel and getattr(row, found.rank_by) == math.inf]
    if lacking and points:
        found.notes.append(f"{PLOT} has logarithmic axes and cannot show zero error; not shown: {', '.join(lacking)}")
    if not points:
        return b""
    what = "the encoded picture" if found.rank_by == "psnr_encoded" else found.variable[1]
    scale = "brightest value of its reference" if found.rank_by == "psnr_white" else "full scale"
    return work_precision(points, f"{found.pipeline}: {found.key}", f"rms error of {what}, {scale} 1")


def _crops(found: Comparison) -> bytes:
    """Show the best alternatives side by side with the reference of the best one. Pictures of another size whose place
    on the image plane is unknown are left out and named in a note.
    """
    best = [(row, row.position) for row in found.rows if row.position is not None and row.position in found.pictures]
    if not best:
        return b""
    reference = found.reference_pictures[best[0][1]]
    # Otherwise crops of different sizes would not show the same part of the scene.
    placed = all(at in found.planes for _, at in best)
    alike = [(row, at) for row, at in best if placed or found.pictures[at].shape == reference.shape]
    if len(alike) < len(best):
        labels = [row.label for row, at in best if (row, at) not in alike]
        found.notes.append(
            f"{CROPS} shows only pictures with the size of the best picture; not shown: {', '.join(labels)}"
        )
    if not alike:
        return b""
    if len(alike) > MOST_CROPS:
        others = ", ".join(row.label for row, _ in alike[MOST_CROPS:])
        found.notes.append(
            f"{CROPS} shows the best {MOST_CROPS} of {len(alike)}; use --axis '{found.key}=...' with fewer to see: "
            f"{others}"
        )
    strips = [
        Strip(
            f"reference of {best[0][0].label}" if found.own_reference else "reference",
            reference,
            found.planes.get(best[0][1]),
        )
    ]
    for row, at in alike[:MOST_CROPS]:
        strips.append(
            Strip(
                f"{row.label}  {_number(getattr(row, found.rank_by), '.2f')} dB",
                found.pictures[at],
                found.planes.get(at),
            )
        )
    encoded = any(row.psnr_encoded is not None for row, _ in alike)
    return strip(strips, encoded, f"{found.pipeline}: where they differ most")


def csv_text(found: Comparison) -> str:
    text = StringIO()
    rows = document(found)["rows"]
    table = csv.DictWriter(text, list(rows[0]) if rows else ["label"], lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()


def _json(found: Comparison) -> str:
    return json.dumps(document(found), indent=1, allow_nan=False) + "\n"


def compare_command(
    given: options.Given,
    way: options.Way,
    axis: str,
    repeat: int,
    noise_free: bool,
    no_mtf50: bool,
    output: Path | None,
) -> None:
    pipeline = given.pipeline()
    how, progress = way.options(), options.progress(way.silent)
    along = parse_axis(axis, options.number)
    folder = output or Path(
        f"{pipeline.name}-compare-{along.key.removesuffix('.use').removeprefix('camera.').replace('.', '_')}"
    )
    found = measure(pipeline, along, repeat, noise_free, how, progress, not no_mtf50, lambda: check_folder(folder))
    files = write_files(found, folder)
    if way.as_json:
        say({**document(found), "files": [str(path) for path in files]})
    else:
        show(print_comparison, found, files)
    sys.exit(3 if found.failed or found.lacking else 0)
