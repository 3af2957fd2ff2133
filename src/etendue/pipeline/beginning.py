"""A commented pipeline to start from, made from a template that a distribution provides by ``etendue_templates``.

In:  a template, its name, a preset, the bytes that each choice under `keep` stores.
Out: the text of the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from etendue.errors import RequestError, nearest
from etendue.pipeline.file import parse_pipeline
from etendue.pipeline.presets import preset
from etendue.plugins import discovery


@dataclass(frozen=True)
class Template:
    """``path``: the text, with NAME and PRESET to be replaced, and KEPT in the place of the choices of `keep`;
    ``keep``: a description of each choice; ``preset``: the default preset, '' if the text names none.
    """

    path: Path
    preset: str = ""
    keep: Mapping[str, str] = field(default_factory=dict)


def template(name: str = "") -> Template:
    """Return the template of a name, or the first template.

    Raises
    ------
    RequestError
        If no template has this name, or there are no templates.
    """
    names = discovery.installed().names("templates")
    brought = discovery.installed().first("templates", name or (names[0] if names else ""))
    if brought is None:
        raise RequestError(
            f"unknown template {name!r}{nearest(name, names)}"
            if names
            else "no installed distribution provides a template"
        )
    return discovery.made_of(Template, f"the template {name!r}", brought)


def text_of(name: str, chosen: str = "", kept: Mapping[str, str] | None = None, of: Template | None = None) -> str:
    """Return the pipeline file for this name. ``chosen``: a preset; ``kept``: the size of each choice under `keep`.

    Raises
    ------
    RequestError
        If the name is not valid for a pipeline, or the preset is unknown.
    """
    of = of or template()
    if of.preset:
        preset(chosen or of.preset)
    words = {"all": '"all"'} | {word: f'["{word}"]' for word in of.keep if word != "all"}
    choices = "\n".join(
        f"#   {words[word]:17s}{what}{f', {kept[word]}' if kept else ''}" for word, what in of.keep.items()
    )
    text = (
        Path(of.path)
        .read_text(encoding="utf-8")
        .replace("NAME.toml", f"{name}.toml")
        .replace("NAME/", f"{name}/")
        .replace('"NAME"', f'"{name}"')
        .replace("PRESET", chosen or of.preset)
        .replace("KEPT", choices)
    )
    if '"' in name or "\\" in name or "\n" in name or parse_pipeline(text).faults:
        raise RequestError(
            f"{name!r} is not a valid pipeline name: it must not contain a slash, quotes or control characters, nor "
            f"start with a dot"
        )
    return text
