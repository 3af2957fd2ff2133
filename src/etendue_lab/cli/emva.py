"""Commands that measure what was simulated as a laboratory would: ``emva``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("emva")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE|ARCHIVE")
@options.settings("camera.sensor=sony-imx363, camera.integration_time='1 s'; repeatable.")
@click.option(
    "--pixels", default=192, show_default=True, metavar="N", help="Of the window that is read, along y and x."
)
@options.JSON
@options.gather
@later("etendue_lab.emva.terminal:emva_command")
def emva() -> None:
    """A sensor measured after EMVA 1288 release 4 (linear): its figures with intervals, beside what they should be.

    Of a pipeline FILE raw frames are taken of a uniform light and of the dark, two at each exposure time, with the lens
    taken off: system gain, read noise, dark current, full well, DSNU, PRNU, linearity, saturation, sensitivity
    threshold, dynamic range and SNR for each channel. Of an ARCHIVE the frames are those that it holds: of a uniform
    scene, swept over reflectance (0 and 1) and integration time, two frames each, as pipelines/emva.toml takes them;
    each camera of the sweep is measured.

    Exit codes: 0 done, 2 the request is wrong, 3 some channels could not be measured.
    """
