"""Commands that write something to begin with: ``new``, ``new-plugin``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.saying import command, later
from etendue.contract.tables import preset_keys

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
@later("etendue.cli.bodies.beginnings:new")
def new() -> None:
    """A commented pipeline NAME.toml to begin with."""


@command("new-plugin")
@click.argument("name")
@click.option("--role", metavar="ROLE", help="What it is for: one of the roles that `etendue stages` lists.")
@click.option("--like", metavar="STAGE", help="The installed stage it begins as; default: a simple one of the role.")
@FOLDER
@later("etendue.cli.bodies.beginnings:new_plugin")
def new_plugin() -> None:
    """A distribution that brings a stage of your own: it installs, passes the laws of its kind and is ranked by
    `compare` as it stands.

    It inherits the arithmetic of an installed stage; write yours in the place of one line.
    """
