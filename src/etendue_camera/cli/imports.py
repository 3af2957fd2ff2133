"""The command ``import``, which reads files of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.saying import command, later
from etendue_camera.importing.formats import NAMES

HELP = f"""Import a spectral cube of another program as a scene: {NAMES}.

Write the Zarr store that the stage radiance_cube reads: spectral radiance in W m-2 sr-1 nm-1, or reflectance
(1 = white) for the pipeline's illuminant at white_luminance. Print the type of the values, the size on the sensor,
and lines for a pipeline.
"""


@command("import", help=HELP)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="STORE",
    help="Store to write. Default: FILE.zarr in the current folder.",
)
@click.option("--variable", default="", metavar="NAME", help="Array to read, if the file has several.")
@click.option(
    "--axes", default="", metavar="ORDER", help="Axis order of the file, if unknown: w, y and x, such as yxw."
)
@click.option("--wavelengths", metavar="NM", help="Band centres: 400:700:10, 450,550,650, or a file with one per line.")
@click.option(
    "--level",
    default="",
    metavar="WORD",
    help="Type of the values: radiance, photons, relative (reflectance: 1 = white in every band), or a unit of "
    "radiance.",
)
@click.option(
    "--scale",
    type=click.FloatRange(0, min_open=True),
    metavar="FACTOR",
    help="Factor by which the values are multiplied.",
)
@click.option(
    "--spacing",
    type=click.FloatRange(0, min_open=True),
    metavar="UM",
    help="Sample spacing on the sensor, which determines the size of the picture; may also be given in the pipeline.",
)
@click.option(
    "--white-at", metavar="Y,X[,SIZE]", help="Position of a white patch, in pixels; values are divided by its spectrum."
)
@click.option(
    "--white-reflectance",
    type=click.FloatRange(0, 2, min_open=True),
    default=1.0,
    show_default=True,
    help="Reflectance of the white patch.",
)
@click.option("--clip", is_flag=True, help="Set negative values, such as from noise, to 0.")
@later("etendue_camera.importing.store:import_command")
def take() -> None:
    """Run the command; its help is ``HELP``."""
