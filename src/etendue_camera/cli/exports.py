"""The command ``export``, which writes pictures of an archive for other programs."""

from __future__ import annotations

import click

from etendue.cli.options import FOLDER, JSON, PLACE
from etendue.cli.saying import command, later


@command("export")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option("--dng", is_flag=True, help="Write raw frames as Digital Negatives (DNG).")
@click.option("--tiff", is_flag=True, help="Write 16-bit TIFF of the raw digital numbers, or of --variable.")
@click.option(
    "--png",
    is_flag=True,
    help="Write 8-bit PNG of the display values, or of any --variable over y and x, in the colours that the eye sees.",
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
    help="Axis value, such as f_number=2.8; may be repeated. All values of other axes are exported.",
)
@click.option(
    "--stage", default="", metavar="NAME", help="Stage to read from. Default: the last stage that wrote the variable."
)
@click.option(
    "-o",
    "--output",
    type=FOLDER,
    metavar="PATH",
    help="Folder, or file for a single picture. Default: ./ARCHIVE-export.",
)
@click.option("--all", "everything", is_flag=True, help="Allow more than 64 files.")
@click.option("--force", is_flag=True, help="Overwrite existing files.")
@JSON
@later("etendue_camera.export.command:export_command")
def export() -> None:
    """Export pictures of an archive for other programs: DNG raw files, 16-bit TIFF, 8-bit PNG.

    Exit codes: 0 all written, 2 invalid request, 3 some cells have no picture, because they failed or were not
    computed yet.
    """
