"""Commands that write something to begin with: ``new``, ``new-plugin``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.options import installed
from etendue.cli.saying import command
from etendue.contract.values.tables import preset_keys

FOLDER = click.option(
    "-o", "--output", type=click.Path(path_type=Path, file_okay=False), metavar="FOLDER", help="Where; default here."
)


@command("new")
@click.argument("name")
@click.option("--template", default="", metavar="NAME", help="Which of those that are installed; default: the first.")
@click.option(
    "--preset",
    *(f"--{key}" for key in sorted(preset_keys())),
    "chosen",
    default="",
    metavar="NAME",
    help="Default: the template's.",
)
@FOLDER
def new(name: str, template: str, chosen: str, output: Path | None) -> None:
    """A commented pipeline NAME.toml to begin with."""
    from etendue.pipeline import beginning
    from etendue.pipeline.new_files import refuse_existing

    of = beginning.template(template)
    text = beginning.text_of(name, chosen, None, of)
    place = (output or Path()) / f"{name}.toml"
    refuse_existing(place)
    text = beginning.text_of(name, chosen, _kept(text), of)
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text, encoding="utf-8")
    click.echo(f"{place}: next: etendue run {place}")


def _kept(text: str) -> dict[str, str]:
    """What each choice under `keep` takes of a pipeline."""
    from etendue.pipeline.file import parse_pipeline
    from etendue.plan.planner import make_plan, summary
    from etendue.telling import human_bytes

    document = summary(make_plan(parse_pipeline(text), installed()))
    by_name = {name: one["bytes"] for stage in document["stages"] for name, one in stage["variables"].items()}
    return {word: human_bytes(size) for word, size in {**by_name, **document["keep"]}.items()}


@command("new-plugin")
@click.argument("name")
@click.option("--role", metavar="ROLE", help="What it is for: one of the roles that `etendue stages` lists.")
@click.option("--like", metavar="STAGE", help="The installed stage it begins as; default: a simple one of the role.")
@FOLDER
def new_plugin(name: str, role: str | None, like: str | None, output: Path | None) -> None:
    """A distribution that brings a stage of your own: it installs, passes the laws of its kind and is ranked by
    `compare` as it stands.

    It inherits the arithmetic of an installed stage; write yours in the place of one line.
    """
    from etendue.pipeline.distribution import beginning, files
    from etendue.pipeline.new_files import write_folder

    one = beginning(installed(), name, role, like)
    place = (output or Path()) / one.distribution
    for path in write_folder(place, files(one)):
        click.echo(path)
    click.echo(
        f"next: pip install -e '{place}[test]', pytest {place}, etendue stages {one.stage}; begins as {one.like}"
    )
