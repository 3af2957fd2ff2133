"""Commands that take files of other programs in: ``import``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.saying import command, later
from etendue_camera.importing.formats import NAMES

HELP = f"""A spectral cube of another program as a scene: {NAMES}.

Writes the Zarr store that the stage radiance_cube reads: spectral radiance in W m-2 sr-1 nm-1, or reflectance
(1 = white), which the pipeline's illuminant lights at white_luminance. Prints what the values are, the size on the
sensor, and the lines of a pipeline.
"""


@command("import", help=HELP)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="STORE", help="Default: FILE.zarr, here.")
@click.option("--variable", default="", metavar="NAME", help="The array in the file, where there are several.")
@click.option(
    "--axes", default="", metavar="ORDER", help="Of the file, where it is not known: w, y and x, such as yxw."
)
@click.option(
    "--wavelengths", metavar="NM", help="Centres of bands: 400:700:10, 450,550,650, or a file with one a line."
)
@click.option(
    "--level",
    default="",
    metavar="WORD",
    help="What the values are: radiance, photons, relative (reflectance: 1 = white in every band), or a unit of "
    "radiance.",
)
@click.option("--scale", type=click.FloatRange(0, min_open=True), metavar="FACTOR", help="Of the values.")
@click.option(
    "--spacing",
    type=click.FloatRange(0, min_open=True),
    metavar="UM",
    help="Between samples on the sensor, which gives the size there; a pipeline may say it.",
)
@click.option(
    "--white-at", metavar="Y,X[,SIZE]", help="Where a white patch is, in pixels; relative values are divided by it."
)
@click.option(
    "--white-reflectance",
    type=click.FloatRange(0, 2, min_open=True),
    default=1.0,
    show_default=True,
    help="Of that patch.",
)
@click.option("--clip", is_flag=True, help="What is below 0, as noise makes it, is 0.")
@later("etendue_camera.importing.store:import_command")
def take() -> None:
    """The command, whose words are ``HELP``."""
