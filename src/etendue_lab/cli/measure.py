"""The ``measure`` command: measure photographs."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("measure")
@click.argument("picture", type=click.Path(path_type=Path), metavar="PICTURE")
@click.option(
    "--edge", "edges", multiple=True, metavar="X,Y,W,H", help="Rectangle that holds one slanted edge, or auto"
)
@click.option("--star", "stars", multiple=True, metavar="X,Y,R", help="Centre and radius of a Siemens star")
@click.option(
    "--cycles",
    type=click.IntRange(8, 400),
    metavar="N",
    help="Number of star periods per turn; counted if omitted.",
)
@click.option("--noise", multiple=True, metavar="X,Y,W,H", help="Rectangle that holds a uniform patch")
@click.option(
    "--chart",
    metavar="X0,Y0,..,X3,Y3",
    help="Corners of a ColorChecker: outer corners of dark skin, bluish green, black and white, in this order.",
)
@click.option(
    "--encoding", default="sRGB", show_default=True, metavar="E", help="Encoding of the values: sRGB, BT.709 or linear."
)
@click.option(
    "--space",
    default="sRGB",
    show_default=True,
    metavar="NAME",
    help="RGB space (primaries and white): 'Display P3', 'Adobe RGB (1998)', ...",
)
@click.option(
    "--channel",
    type=click.Choice(["luminance", "red", "green", "blue"]),
    help="Channel for edges and stars. [default: luminance; green of a raw file]",
)
@click.option("--pitch", metavar="LENGTH", help="Pixel pitch, such as 4um; adds frequencies in cycles/mm.")
@options.JSON
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write the curves of edges and stars: .csv, .png, .svg or .pdf.",
)
@click.option(
    "--picture",
    "shown",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write the photograph with the measured regions outlined: .png, .svg or .pdf.",
)
@later("etendue_lab.measure.terminal:measure_command")
def measure() -> None:
    """Measure your own photograph with the methods that are used for simulated pictures; each metric has a 95 %
    interval.

    The metrics are MTF of slanted edges and Siemens stars, noise of uniform patches, and colour differences of a
    ColorChecker. Regions are in pixels from the upper left corner. If no region is given, the strongest slanted edge is
    found automatically. PNG, JPEG and TIFF can be measured, and raw files without demosaicing (pip install
    'etendue[raw]').

    Exit codes: 0 done, 2 the request is invalid or a region does not show the expected target.
    """
