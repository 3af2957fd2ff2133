"""The ``emva`` command: measure a simulated or a real sensor as a laboratory would."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("emva")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE|ARCHIVE|FRAMES")
@options.settings("Override a value: camera.sensor=sony-imx363, camera.integration_time='1 s'")
@click.option(
    "--pixels",
    default=192,
    show_default=True,
    metavar="N",
    help="Height and width of the window that is read, in pixels.",
)
@click.option("--window", metavar="X,Y,W,H", help="Rectangle of real frames to use, in pixels.")
@click.option("--pattern", metavar="RGGB", help="2 x 2 colour filter array of real frames. Default: mono.")
@options.JSON
@options.gather
@later("etendue_lab.emva.terminal:emva_command")
def emva() -> None:
    """Measure a sensor according to EMVA 1288 release 4 (linear). Values are printed with intervals and with the
    expected values.

    For a pipeline FILE, the lens is removed, and two raw frames of uniform light and two dark frames are simulated at
    each exposure time. The results are system gain, read noise, dark current, full well, DSNU, PRNU, linearity,
    saturation, sensitivity threshold, dynamic range and SNR for each channel. For an ARCHIVE, the stored frames are
    measured, for each camera of the sweep. These frames must show a uniform scene swept over reflectance (0 and 1) and
    integration time, with two frames of each, as in pipelines/emva.toml. Real FRAMES are a folder of PNG, TIFF or DNG
    files, a .npz file, a CSV table (file, time_s, photons or relative_light, kind), or the descriptor of an EMVA
    reference set, with two or more frames of each exposure.

    Exit codes: 0 done, 2 invalid request, 3 some channels could not be measured.
    """
