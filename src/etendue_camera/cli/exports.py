"""The command ``export``, which writes pictures of an archive for other programs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from etendue import streams
from etendue.cli.options import FOLDER, JSON, PLACE
from etendue.cli.saying import command, say


@command("export")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option("--dng", is_flag=True, help="Write raw frames as Digital Negatives (DNG).")
@click.option("--tiff", is_flag=True, help="Write 16-bit TIFF of the raw digital numbers, or of --variable.")
@click.option(
    "--png",
    is_flag=True,
    help="Write 8-bit PNG as an eye sees it, of the display values, or of any --variable over y and x.",
)
@click.option(
    "--variable",
    "variables",
    multiple=True,
    metavar="NAME",
    help="Variable for TIFF and PNG files, such as rgb_display; may be repeated.",
)
@click.option(
    "--at",
    multiple=True,
    metavar="AXIS=VALUE",
    help="Axis value, such as f_number=2.8; may be repeated. Axes not given: all values.",
)
@click.option(
    "--stage", default="", metavar="NAME", help="Stage to read from; default: the last that wrote the variable."
)
@click.option(
    "-o",
    "--output",
    type=FOLDER,
    metavar="PATH",
    help="A folder, or a file for a single picture; default: ./ARCHIVE-export.",
)
@click.option("--all", "everything", is_flag=True, help="Allow more than 64 files.")
@click.option("--force", is_flag=True, help="Overwrite existing files.")
@JSON
def export(place: Path | str, as_json: bool, **words: Any) -> None:
    """Export pictures of an archive for other programs: DNG raw files, 16-bit TIFF, 8-bit PNG.

    Exit codes: 0 all written, 2 invalid request, 3 some cells have no picture, because they failed or were not
    computed yet.
    """
    from etendue.archive import places
    from etendue_camera.export.command import ExportRequest
    from etendue_camera.export.command import export as write

    with places.reading(place) as folder:
        done = write(ExportRequest(folder, **words))
    if as_json:
        say(
            {
                "files": [str(path) for path in done.files],
                "skipped": [{"at": where, "why": why} for where, why in done.skipped],
            }
        )
    else:
        with streams.results():
            for path in done.files[:10]:
                click.echo(str(path))
            if len(done.files) > 10:
                click.echo(f"... {len(done.files)} files in {done.folder}")
        for text in done.notes:
            click.echo(f"note: {text}", err=True)
        for where, why in done.skipped:
            click.echo(f"{where}: no picture, the cell is {why}", err=True)
    sys.exit(3 if done.skipped else 0)
