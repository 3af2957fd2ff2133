"""The command ``sensors``, which lists installed sensors."""

from __future__ import annotations

from etendue.cli.catalogue import tell_one
from etendue.cli.options import JSON, NAME
from etendue.cli.saying import command


@command("sensors")
@NAME
@JSON
def sensors(name: str | None, as_json: bool) -> None:
    """List sensors for [camera] sensor = "NAME" in a pipeline. With a name: each value with its source."""
    from etendue.pipeline.presets import preset_names
    from etendue_camera.cli.sensors import print_sensor, print_sensors, sensor_document

    tell_one(as_json, name, preset_names(), sensor_document, print_sensor, print_sensors)
