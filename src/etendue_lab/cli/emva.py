"""The ``emva`` command: measure a simulated sensor as a laboratory would."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, tell


@command("emva")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE|ARCHIVE")
@options.settings("Override a value: camera.sensor=sony-imx363, camera.integration_time='1 s'" + options.REPEAT)
@click.option(
    "--pixels",
    default=192,
    show_default=True,
    metavar="N",
    help="Height and width of the window that is read, in pixels.",
)
@options.JSON
@options.gather
def emva(given: options.Given, pixels: int, as_json: bool) -> None:
    """Measure a sensor according to EMVA 1288 release 4 (linear): values with intervals, beside the expected ones.

    For a pipeline FILE, raw frames of uniform light and of the dark are taken with the lens removed, two at each
    exposure time: system gain, read noise, dark current, full well, DSNU, PRNU, linearity, saturation, sensitivity
    threshold, dynamic range and SNR for each channel. For an ARCHIVE, the frames are those stored: a uniform scene
    swept over reflectance (0 and 1) and integration time, two frames each, as in pipelines/emva.toml; each camera of
    the sweep is measured.

    Exit codes: 0 done, 2 invalid request, 3 some channels could not be measured.
    """
    from etendue.errors import RequestError
    from etendue_lab.emva.study import of_archive, of_pipeline
    from etendue_lab.emva.terminal import print_emva

    if given.file.is_dir():
        if given.settings:
            raise RequestError("--set: cannot change an archive; give its pipeline file instead")
        found = of_archive(given.file, options.installed())
    else:
        found = of_pipeline(given.pipeline(), options.installed(), pixels, None, options.progress(as_json))
    tell(as_json, found.document(), print_emva)
    sys.exit(3 if any(channel.why for channel in found.channels) else 0)
