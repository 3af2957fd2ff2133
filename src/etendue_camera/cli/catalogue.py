"""What a camera has installed: ``sensors``."""

from __future__ import annotations

from etendue.cli.options import JSON, NAME
from etendue.cli.saying import command, later


@command("sensors")
@NAME
@JSON
@later("etendue_camera.cli.sensors:sensors_command")
def sensors() -> None:
    """Sensors that a pipeline may name: [camera] sensor = "NAME". With a name: each value and where it comes from."""
