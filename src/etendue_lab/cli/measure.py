"""The ``measure`` command: measure photographs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from etendue.cli import options
from etendue.cli.saying import command, tell


@command("measure")
@click.argument("picture", type=click.Path(path_type=Path), metavar="PICTURE")
@click.option(
    "--edge",
    "edges",
    multiple=True,
    metavar="X,Y,W,H",
    help="Rectangle that holds one slanted edge, or auto" + options.REPEAT,
)
@click.option(
    "--star", "stars", multiple=True, metavar="X,Y,R", help="Centre and radius of a Siemens star" + options.REPEAT
)
@click.option(
    "--cycles",
    type=click.IntRange(8, 400),
    metavar="N",
    help="Number of star periods per turn; counted if omitted.",
)
@click.option("--noise", multiple=True, metavar="X,Y,W,H", help="Rectangle that holds a uniform patch" + options.REPEAT)
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
def measure(
    picture: Path, pitch: str | None, as_json: bool, output: Path | None, shown: Path | None, **words: Any
) -> None:
    """Measure a photograph of your own with the same methods as simulated ones; each metric has a 95 % interval.

    MTF of slanted edges and Siemens stars, noise of uniform patches, colour differences of a ColorChecker. Regions are
    in pixels from the upper left corner. If no region is given, the strongest slanted edge is found automatically.
    Reads PNG, JPEG, TIFF, and raw files on their own mosaic (pip install 'etendue[raw]').

    Exit codes: 0 done, 2 invalid request, or a region does not show what it should.
    """
    from etendue.contract.values.units import UnitError, to_unit
    from etendue.errors import RequestError
    from etendue.present.plots.plot import check_suffix
    from etendue_lab.measure import study
    from etendue_lab.measure.drawn import drawn
    from etendue_lab.measure.terminal import print_photograph

    try:
        length = None if pitch is None else to_unit(options.number(pitch), "um")
    except UnitError as error:
        raise RequestError(f"--pitch {error}") from None
    if length is not None and not length > 0:
        raise RequestError(f"--pitch {pitch}: must be a length greater than 0, such as 4um")
    asked = study.MeasurementRequest(**words, pitch=length)
    if output is not None:
        check_suffix(output)
        if (asked.noise or asked.chart) and not (asked.edges or asked.stars):
            raise RequestError("-o: only edges and stars have curves; give --edge or --star")
    if shown is not None:
        check_suffix(shown)
    document = study.measure(picture, asked)
    plot = None if output is None else study.curves(document)
    if plot is not None and output is not None:
        plot.save(output)
    if shown is not None:
        drawn(picture, document).save(shown)
    tell(as_json, document, print_photograph)
