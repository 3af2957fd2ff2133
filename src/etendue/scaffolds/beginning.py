"""A commented pipeline to begin with.

In:  its name, a sensor.
Out: the text of the file.
"""

from __future__ import annotations

from importlib.resources import files

from etendue.errors import RequestError
from etendue.spec.pipeline import parse_pipeline
from etendue.spec.presets import preset


def text_of(name: str, sensor: str) -> str:
    """The file of a pipeline of this name.

    Raises
    ------
    RequestError
        The name is none for a pipeline, or there is no such sensor.
    """
    preset(sensor)
    written = files("etendue").joinpath("data", "beginning.toml").read_text(encoding="utf-8")
    text = (
        written.replace("NAME.toml", f"{name}.toml").replace("NAME/", f"{name}/").replace('"NAME"', f'"{name}"').replace("SENSOR", sensor)
    )
    if '"' in name or "\\" in name or "\n" in name or parse_pipeline(text).faults:
        raise RequestError(f"{name!r} is no name for a pipeline: no slash, quotes or control characters, no dot in front")
    return text
