"""Commands that write starting points: ``new``, ``new-plugin``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.saying import command, later
from etendue.contract.values.tables import preset_keys

FOLDER = click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="FOLDER",
    help="Folder or file to write to. Default: the current folder.",
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
    help="Preset to use. Default: the preset of the template.",
)
@FOLDER
@later("etendue.cli.bodies.beginnings:new")
def new() -> None:
    """Write a commented pipeline, NAME.toml, to start from."""


@command("new-plugin")
@click.argument("name")
@click.option("--role", metavar="ROLE", help="Role of the stage, as listed by `etendue stages`.")
@click.option("--like", metavar="STAGE", help="Installed stage to start from. Default: a simple stage of the role.")
@FOLDER
@later("etendue.cli.bodies.beginnings:new_plugin")
def new_plugin() -> None:
    """Create a package with a stage of your own. It can be installed as it is, passes the tests of its role
    (`etendue.testing`), and can be ranked by `compare`.

    The new stage inherits its computation from an installed stage; replace the line that calls it with your own code.
    """
