"""The commands ``sensors``, which lists installed sensors, and ``cameras``, which lists bodies and lenses."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.options import JSON, NAME
from etendue.cli.saying import command, later


@command("sensors")
@NAME
@JSON
@later("etendue_camera.cli.sensors:sensors_command")
def sensors() -> None:
    """List sensors for [camera] sensor = "NAME" in a pipeline. If a name is given, its values are listed with their
    sources.
    """


@command("cameras")
@NAME
@click.option("--lenses", is_flag=True, help="List lenses instead of bodies.")
@click.option("--search", metavar="TEXT", help="List bodies and lenses whose names contain all these words.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write a body, lens or sensitivity to a file.",
)
@JSON
@later("etendue_camera.cli.cameras:cameras_command")
def cameras() -> None:
    """List the camera bodies and lenses that a pipeline can name: body = "NAME" and lens = "NAME" under [camera].

    If a name is given, its values are listed with their sources. NAME may also be a file: a DNG, a camconst.json, a
    tuning of libcamera, a sensitivity of rawtoaces-data.
    """
