"""The ``calibrate`` command: a sensor file from real frames."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("calibrate")
@click.argument("frames", type=click.Path(path_type=Path), metavar="FRAMES")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE.toml", help="Write the sensor file.")
@click.option("--check", is_flag=True, help="Simulate the frames with the fitted camera and compare, level by level.")
@click.option(
    "--figure",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Draw the photon transfer curve, measured and predicted: .png, .svg or .pdf.",
)
@click.option("--pitch", type=click.FloatRange(0, min_open=True), metavar="UM", help="Pixel pitch, um.")
@click.option(
    "--aperture",
    type=click.FloatRange(0, 1, min_open=True),
    metavar="SHARE",
    help="Side of a pixel's light-sensitive square, as a fraction of the pitch: 1 with microlenses.",
)
@click.option(
    "--edge",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Raw frame of a slanted edge, from which the blur of the lens is fitted. Needs --pitch and --aperture.",
)
@click.option("--edge-window", metavar="X,Y,W,H", help="Rectangle of the edge, in pixels.")
@click.option("--window", metavar="X,Y,W,H", help="Rectangle of the frames to use, in pixels.")
@click.option(
    "--pattern",
    metavar="RGGB",
    help="2 x 2 colour filter array of the frames. Default: the array stated by a DNG, otherwise mono.",
)
@options.JSON
@later("etendue_lab.calibrate.terminal:calibrate_command")
def calibrate() -> None:
    """Calibrate a sensor from real frames: flat fields, at least two at every exposure, and dark frames, at least two.

    FRAMES: a folder of PNG, TIFF or DNG files, a .npz file, a CSV table (file, time_s, photons or relative_light,
    kind), or the descriptor of an EMVA reference set. The sensor file contains every value with its 95 % interval and
    the method by which it was found. Use it with [camera] sensor = "./FILE.toml", or as a value of a sweep.

    Exit codes: 0 done, 2 invalid request, 3 a check found a level outside its limits.
    """
