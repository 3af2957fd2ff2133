"""The ``emva`` command: measure a simulated sensor as a laboratory would."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("emva")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE|ARCHIVE")
@options.settings("Override a value: camera.sensor=sony-imx363, camera.integration_time='1 s'")
@click.option(
    "--pixels",
    default=192,
    show_default=True,
    metavar="N",
    help="Height and width of the window that is read, in pixels.",
)
@options.JSON
@options.gather
@later("etendue_lab.emva.terminal:emva_command")
def emva() -> None:
    """Measure a sensor according to EMVA 1288 release 4 (linear): values with intervals, beside the expected ones.

    For a pipeline FILE, raw frames of uniform light and of the dark are taken with the lens removed, two at each
    exposure time: system gain, read noise, dark current, full well, DSNU, PRNU, linearity, saturation, sensitivity
    threshold, dynamic range and SNR for each channel. For an ARCHIVE, the frames are those stored: a uniform scene
    swept over reflectance (0 and 1) and integration time, two frames each, as in pipelines/emva.toml; each camera of
    the sweep is measured.

    Exit codes: 0 done, 2 invalid request, 3 some channels could not be measured.
    """
