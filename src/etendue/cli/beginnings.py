"""Commands that write starting points: ``new``, ``new-plugin``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.options import installed
from etendue.cli.saying import command
from etendue.contract.values.tables import preset_keys

FOLDER = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="Where to write. Default: here.",
)


@command("new")
@click.argument("name")
@click.option("--template", default="", metavar="NAME", help="Installed template to use. Default: the first.")
@click.option(
    "--preset",
    *(f"--{key}" for key in sorted(preset_keys())),
    "chosen",
    default="",
    metavar="NAME",
    help="Preset to use. Default: the template's.",
)
@FOLDER
def new(name: str, template: str, chosen: str, output: Path | None) -> None:
    """Write a commented pipeline, NAME.toml, to start from."""
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
    """Return the size of what each choice of `keep` stores for a pipeline."""
    from etendue.pipeline.file import parse_pipeline
    from etendue.plan.planner import make_plan, summary
    from etendue.telling import human_bytes

    document = summary(make_plan(parse_pipeline(text), installed()))
    by_name = {name: one["bytes"] for stage in document["stages"] for name, one in stage["variables"].items()}
    return {word: human_bytes(size) for word, size in {**by_name, **document["keep"]}.items()}


@command("new-plugin")
@click.argument("name")
@click.option("--role", metavar="ROLE", help="Role of the stage, as listed by `etendue stages`.")
@click.option("--like", metavar="STAGE", help="Installed stage to start from. Default: a simple one of the role.")
@FOLDER
def new_plugin(name: str, role: str | None, like: str | None, output: Path | None) -> None:
    """Create a package with a stage of your own. It installs, passes the laws of its role and is ranked by `compare` as
    it is.

    The stage inherits the computation of an installed one; replace one line with yours.
    """
    from etendue.pipeline.distribution import beginning, files
    from etendue.pipeline.new_files import write_folder

    one = beginning(installed(), name, role, like)
    place = (output or Path()) / one.distribution
    for path in write_folder(place, files(one)):
        click.echo(path)
    click.echo(f"next: pip install -e '{place}[test]', pytest {place}, etendue stages {one.stage}; based on {one.like}")
