"""``new``, ``new-plugin`` and ``schema``: files to start from."""

from __future__ import annotations

import json
from pathlib import Path

import click

from etendue.cli.options import installed
from etendue.cli.saying import say
from etendue.pipeline import beginning, distribution
from etendue.pipeline.file import parse_pipeline
from etendue.pipeline.new_files import refuse_existing, write_folder
from etendue.pipeline.schema import schema as schema_of
from etendue.plan.planner import make_plan, summary
from etendue.telling import human_bytes


def new(name: str, template: str, chosen: str, output: Path | None) -> None:
    of, name = beginning.template(template), name.removesuffix(".toml")
    text = beginning.text_of(name, chosen, None, of)
    place = (output or Path()) / f"{name}.toml"
    refuse_existing(place)
    text = beginning.text_of(name, chosen, _kept(text), of)
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text, encoding="utf-8")
    click.echo(f"{place}: next: etendue run {place}")


def new_plugin(name: str, role: str | None, like: str | None, output: Path | None) -> None:
    one = distribution.beginning(installed(), name, role, like)
    place = (output or Path()) / one.distribution
    for path in write_folder(place, distribution.files(one)):
        click.echo(path)
    click.echo(f"next: pip install -e '{place}[test]', pytest {place}, etendue stages {one.stage}; based on {one.like}")


def _kept(text: str) -> dict[str, str]:
    """Return the stored size, as text, for each variable and for each choice of `keep`."""
    document = summary(make_plan(parse_pipeline(text), installed()))
    by_name = {name: one["bytes"] for stage in document["stages"] for name, one in stage["variables"].items()}
    return {word: human_bytes(size) for word, size in {**by_name, **document["keep"]}.items()}


def schema(output: Path | None) -> None:
    document = schema_of(installed())
    if output is None:
        say(document)
    else:
        output.write_text(json.dumps(document, indent=1), encoding="utf-8")
        click.echo(f"{output}: to use it in an editor, start a pipeline with the line '#:schema ./{output.name}'")
