"""Commands that write an archive's pictures for other programs: ``export``."""

from __future__ import annotations

import click

from etendue.cli.options import FOLDER, JSON, PLACE
from etendue.cli.saying import command, later


@command("export")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option("--dng", is_flag=True, help="Raw frames as Digital Negatives.")
@click.option("--tiff", is_flag=True, help="16-bit TIFF: of the raw digital numbers, or of --variable.")
@click.option(
    "--png", is_flag=True, help="8-bit PNG as an eye sees it: of the display values, or of any --variable over y and x."
)
@click.option(
    "--variable",
    "variables",
    multiple=True,
    metavar="NAME",
    help="What TIFF and PNG files show, such as rgb_display; may be repeated.",
)
@click.option(
    "--at",
    multiple=True,
    metavar="AXIS=VALUE",
    help="f_number=2.8; may be repeated. An axis not named: all its values.",
)
@click.option(
    "--stage", default="", metavar="NAME", help="Take it from this stage; default the last one that wrote it."
)
@click.option(
    "-o",
    "--output",
    type=FOLDER,
    metavar="PATH",
    help="A folder, or the file for one picture; default ./ARCHIVE-export.",
)
@click.option("--all", "everything", is_flag=True, help="Also more than 64 files.")
@click.option("--force", is_flag=True, help="Write over files that exist.")
@JSON
@later("etendue_camera.export.command:export_command")
def export() -> None:
    """Pictures of an archive as files for other programs: DNG raw files, 16-bit TIFF, 8-bit PNG.

    Exit codes: 0 all written, 2 the request is wrong, 3 some cells have no picture: they failed, or a run has not
    come to them.
    """
