"""A commented pipeline to begin with, from a template that a distribution brings by ``etendue_templates``.

In:  a template, its name, a preset, bytes that each choice under `keep` stores.
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
    """``path``: the text, with NAME and PRESET to be replaced and KEPT where the choices of `keep` stand; ``keep``:
    what each keeps; ``preset``: the one that is taken where none is named, '' where the text names none."""

    path: Path
    preset: str = ""
    keep: Mapping[str, str] = field(default_factory=dict)


def template(name: str = "") -> Template:
    """The template of a name, or the first that there is.

    Raises
    ------
    RequestError
        There is none of that name, or none at all.
    """
    names = discovery.installed().names("templates")
    brought = discovery.installed().first("templates", name or (names[0] if names else ""))
    if brought is None:
        raise RequestError(
            f"there is no template {name!r}{nearest(name, names)}"
            if names
            else "nothing that is installed brings a template"
        )
    return discovery.made_of(Template, f"the template {name!r}", brought)


def text_of(name: str, chosen: str = "", kept: Mapping[str, str] | None = None, of: Template | None = None) -> str:
    """The file of a pipeline of this name. ``chosen``: a preset; ``kept``: what each choice under `keep` takes.

    Raises
    ------
    RequestError
        The name is none for a pipeline, or there is no such preset.
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
            f"{name!r} is no name for a pipeline: no slash, quotes or control characters, no dot in front"
        )
    return text
