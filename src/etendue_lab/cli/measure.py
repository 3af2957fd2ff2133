"""Commands that measure photographs: ``measure``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("measure")
@click.argument("picture", type=click.Path(path_type=Path), metavar="PICTURE")
@click.option(
    "--edge", "edges", multiple=True, metavar="X,Y,W,H", help="One slanted edge, in a rectangle; or auto. Repeatable."
)
@click.option(
    "--star", "stars", multiple=True, metavar="X,Y,R", help="A Siemens star: its middle and radius. Repeatable."
)
@click.option(
    "--cycles",
    type=click.IntRange(8, 400),
    metavar="N",
    help="Periods of the stars in one turn; counted where not given.",
)
@click.option("--noise", multiple=True, metavar="X,Y,W,H", help="An even patch. Repeatable.")
@click.option(
    "--chart",
    metavar="X0,Y0,..,X3,Y3",
    help="A ColorChecker: outer corners of dark skin, bluish green, black and white, in this order.",
)
@click.option(
    "--encoding", default="sRGB", show_default=True, metavar="E", help="Of the values: sRGB, BT.709 or linear."
)
@click.option(
    "--space",
    default="sRGB",
    show_default=True,
    metavar="NAME",
    help="Primaries and white: 'Display P3', 'Adobe RGB (1998)', ...",
)
@click.option(
    "--channel",
    type=click.Choice(["luminance", "red", "green", "blue"]),
    help="Of edges and stars. [default: luminance; green of a raw file]",
)
@click.option("--pitch", metavar="LENGTH", help="Of the camera's pixels, such as 4um: frequencies in cycles/mm too.")
@options.JSON
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Curves of edges and stars: .csv, .png, .svg or .pdf.",
)
@click.option(
    "--picture",
    "shown",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The photograph with what was measured outlined: .png, .svg or .pdf.",
)
@later("etendue_lab.measure.terminal:measure_command")
def measure() -> None:
    """A photograph of your own, measured with the instruments that measure simulated ones, each figure with its 95 %
    interval.

    MTF of slanted edges and Siemens stars, noise of even patches, colour differences of a ColorChecker; in pixels from
    the upper left. Without a region the strongest slanted edge is found. PNG, JPEG, TIFF; raw files on their own mosaic
    (pip install 'etendue[raw]').

    Exit codes: 0 done, 2 the request is wrong or the picture does not hold what was said.
    """
