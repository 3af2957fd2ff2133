"""The command ``sensors``, which lists installed sensors."""

from __future__ import annotations

from etendue.cli.options import JSON, NAME
from etendue.cli.saying import command, later


@command("sensors")
@NAME
@JSON
@later("etendue_camera.cli.sensors:sensors_command")
def sensors() -> None:
    """List sensors for [camera] sensor = "NAME" in a pipeline. With a name: each value with its source."""
