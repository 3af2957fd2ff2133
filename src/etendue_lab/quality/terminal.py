"""Comparison of a camera with the ideal camera of the same scene, on the terminal and as side-by-side pictures.

In:  the document of a comparison; two pictures in XYZ and the map of their difference.
Out: a table; a PNG.
"""

from __future__ import annotations

import math
import sys
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from etendue.cli import options
from etendue.cli.saying import tell
from etendue.contract.arrays.drawn import Drawn
from etendue.present.pictures.appearance import Appearance, rendered
from etendue.present.terminal.cells import Column
from etendue.present.terminal.terminal import _out, _table, escape, short_axes
from etendue.types.arrays import Array
from etendue.types.documents import Document
from etendue_camera.seen import of_channel
from etendue_lab.quality.figures import Shot
from etendue_lab.quality.study import Show, _cell, write
from etendue_lab.quality.study import quality as measure

if TYPE_CHECKING:
    from etendue.types.documents import AxisValues

COLUMNS = (
    ("PSNR linear", "right", "psnr_linear", ".2f", "-"),
    ("PSNR encoded", "right", "psnr_encoded", ".2f", "-"),
    ("SSIM luma", "right", "ssim", ".4f", "-"),
    ("dE00 mean", "right", "de_mean", ".2f", "-"),
    ("dE00 95 %", "right", "de_p95", ".2f", "-"),
    ("S-CIELAB mean", "right", "scielab_mean", ".2f", "-"),
    ("SNR expected", "right", "mean_snr", ".1f", "-"),
    ("SNR flat", "right", "snr_flat", ".1f", "-"),
    ("visible noise", "right", "visible_noise", ".2f", "-"),
    ("range dB", "right", "dr_emva", ".1f", "-"),
    ("clipped", "right", "clipped_fraction", ".2%", "-"),
)
DISPENSABLE = (
    "clipped_fraction",
    "psnr_linear",
    "snr_flat",
    "dr_emva",
    "de_p95",
    "mean_snr",
    "visible_noise",
    "ssim",
    "scielab_mean",
)  # omitted in this order if the terminal is narrow
UNBOUNDED = 10**4  # columns of a terminal that holds every table
LONGEST, GAP = 512, 12  # screen pixels: approximate longer side of a picture; gap between pictures
LEAST_SCALE = 5.0  # minimum CIEDE2000 at the top of the colour bar


def print_quality(document: Document) -> None:
    """Print one line for each cell, and a description of the comparison."""
    console = _out()
    known: list[Column] = [c for c in COLUMNS if any(_known(row[c[2]]) for row in document["rows"])]
    if not any(_known(row["clipped_fraction"]) and row["clipped_fraction"] > 0 for row in document["rows"]):
        known = [c for c in known if c[2] != "clipped_fraction"]  # nothing clipped
    short = short_axes(axis["name"] for axis in document["axes"])
    axes: list[Column] = [
        (f"{short[a['name']]} {a['units'] or ''}".strip().replace(" ", "\n"), "right", a["name"], _axis)
        for a in document["axes"]
    ]
    title = f"{document['pipeline']}: each camera compared with the ideal one of the same scene"
    table, more = _fitting(console, document["rows"], axes, known)
    console.print(escape(title), soft_wrap=True)
    # better to let the terminal wrap lines than to cut numbers
    console.width = max(console.width, _width(console, table))
    console.print(table)
    _print_remarks(console, document, axes, more)


def _print_remarks(console: Console, document: Document, axes: list[Column], more: list[Column]) -> None:
    """Print the remarks below the table."""
    ideal = document["ideal"]
    for row in document["rows"]:
        if row["status"] != "done":
            where = ", ".join(f"{name} = {_axis(row[name])}" for _, _, name, _ in axes) or "the picture"
            _line(console, row["status"], f"{where}: {row['reason']}")
    swapped = ", ".join(f"{use} in place of {name}" for name, use in ideal["replaced"].items())
    _line(console, "ideal", f"the same pipeline without {', '.join(ideal['left_out']) or 'a lens'}, and {swapped}")
    _line(
        console,
        "PSNR",
        "dB, linear to the brightest value of the ideal picture, encoded to 1; dE00: CIEDE2000 on the display; SNR: "
        "ratio, expected for the raw frame and measured in a uniform region",
    )
    _line(console, "viewed", f"at {document['samples_per_degree']:g} pixels per degree (S-CIELAB, visible noise)")
    if more:
        _line(
            console,
            "more",
            f"{', '.join(column for column, *_ in more)}: with --json and -o, or in a wider terminal",
        )
    for text in document["notes"]:
        _line(console, "note", text)
    for path in document["files"]:
        _line(console, "file", path)


def _fitting(
    console: Console, rows: list[Document], axes: list[Column], known: list[Column]
) -> tuple[Table, list[Column]]:
    """Return a table with as many columns as fit the terminal, and a list of the omitted columns."""
    done = [row if row["status"] == "done" else row | dict.fromkeys(column[2] for column in known) for row in rows]
    table, more = _rows(done, [*axes, *known]), []
    for name in DISPENSABLE:
        if not console.is_terminal or _width(console, table) <= console.width:
            break
        more += [column for column in known if column[2] == name]
        known = [column for column in known if column[2] != name]
        table = _rows(done, [*axes, *known])
    return table, more


def _rows(rows: list[Document], columns: list[Column]) -> Table:
    return _table("", *((name.replace(" ", "\n", 1), *rest) for name, *rest in columns), rows=rows)


def _width(console: Console, table: Table) -> int:
    """Return the width (characters) of a table without a limit."""
    return console.measure(table, options=console.options.update(max_width=UNBOUNDED)).maximum


def _line(console: Console, word: str, text: str) -> None:
    console.print(f"{word:<10}{escape(text)}", soft_wrap=True)


def side_by_side(picture: Array, reference: Array, shown: Any, white: Any, title: str) -> bytes:
    """Return camera, ideal camera and the map of CIEDE2000 as one PNG, at a whole number of screen pixels per pixel.

    ``picture`` and ``reference`` are XYZ within the range of their display. They are shown as to an eye adapted to
    ``white``, the white of that display.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = Drawn("linear", 1.0, viewer=tuple(white))
    own = Appearance(drawn, of_channel(drawn, None, "XYZ"))
    panels = [rendered(drawn, own.rgb(one), 1.0) for one in (picture, reference)]
    rows, columns = shown.shape
    scale = max(1, LONGEST // max(rows, columns))
    high, wide = rows * scale, columns * scale
    head, foot, bar = 44, 24, 70
    width, height = 3 * wide + 4 * GAP + bar, high + head + foot
    figure = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(0.5, 1 - 12 / height, title, ha="center", va="center", fontsize=10)
    top = max(LEAST_SCALE, float(np.quantile(shown, 0.99)))
    names = ("camera", "ideal camera", f"CIEDE2000, mean {float(np.mean(shown)):.2f}")
    for number, (panel, name) in enumerate(zip([*panels, shown], names, strict=True)):
        left = GAP + number * (wide + GAP)
        axes = figure.add_axes((left / width, foot / height, wide / width, high / height))
        axes.set_axis_off()
        image = axes.imshow(panel, interpolation="nearest", aspect="auto", cmap="viridis", vmin=0, vmax=top)
        figure.text((left + wide / 2) / width, (foot + high + 4) / height, name, ha="center", va="bottom", fontsize=9)
    place = figure.add_axes(((4 * GAP + 3 * wide) / width, foot / height, 14 / width, high / height))
    figure.colorbar(image, cax=place)
    place.tick_params(labelsize=8)
    file = BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _known(value: Any) -> bool:
    return value is not None and not (isinstance(value, float) and math.isnan(value))


def _axis(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def pictures_of(name: str) -> Show:
    """Return a function that draws camera, ideal camera and their difference."""

    def show(number: int, at: AxisValues, shot: Shot, ideal: Shot, shown: Any) -> tuple[str, bytes]:
        where = ", ".join(f"{key} = {_cell(value)}" for key, value in at.items())
        picture = side_by_side(shot.xyz(), ideal.xyz(), shown, shot.to_xyz.sum(axis=1), f"{name}  {where}".strip())
        return f"quality_{number:03d}.png", picture

    return show


def quality_command(
    given: options.Given,
    way: options.Way,
    samples_per_degree: float,
    without: tuple[str, ...],
    keep: tuple[str, ...],
    pictures: int,
    output: Path | None,
) -> None:
    pipeline, leave_out = given.pipeline(), not given.nothing_left_out
    found = measure(
        pipeline,
        options.installed(),
        samples_per_degree,
        without,
        keep,
        leave_out,
        way.options(),
        options.progress(way.silent),
        pictures_of(pipeline.name) if output else None,
        output,
        pictures,
    )
    if output:
        write(found, output)
    tell(way.as_json, found.document(), print_quality)
    sys.exit(3 if found.failed else 0)
