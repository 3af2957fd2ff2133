"""A commented pipeline to begin with.

In:  its name, a sensor, bytes that each choice under `keep` stores.
Out: the text of the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files

from etendue.errors import RequestError
from etendue.pipeline.file import parse_pipeline
from etendue.pipeline.presets import preset

CHOICES = {"all": "everything", "looks": "pictures and figures, not the bands of light", "rgb_display": "the picture alone"}


def text_of(name: str, sensor: str, kept: Mapping[str, str] | None = None) -> str:
    """The file of a pipeline of this name. ``kept``: what each of `CHOICES` takes.

    Raises
    ------
    RequestError
        The name is none for a pipeline, or there is no such sensor.
    """
    preset(sensor)
    written = files("etendue").joinpath("data", "beginning.toml").read_text(encoding="utf-8")
    words = {"all": '"all"'} | {word: f'["{word}"]' for word in CHOICES if word != "all"}
    choices = "\n".join(f"#   {words[word]:17s}{what}{f', {kept[word]}' if kept else ''}" for word, what in CHOICES.items())
    text = (
        written.replace("NAME.toml", f"{name}.toml")
        .replace("NAME/", f"{name}/")
        .replace('"NAME"', f'"{name}"')
        .replace("SENSOR", sensor)
        .replace("KEPT", choices)
    )
    if '"' in name or "\\" in name or "\n" in name or parse_pipeline(text).faults:
        raise RequestError(f"{name!r} is no name for a pipeline: no slash, quotes or control characters, no dot in front")
    return text
