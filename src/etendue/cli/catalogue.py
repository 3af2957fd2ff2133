"""Commands that say what is installed: ``stages``, ``quantities``, ``schema``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.options import JSON, NAME
from etendue.cli.saying import command, later


@command("stages")
@NAME
@JSON
@later("etendue.cli.bodies.catalogue:stages")
def stages() -> None:
    """What is installed, from which distribution, what it reads and writes, its parameters."""


@command("quantities")
@NAME
@JSON
@later("etendue.cli.bodies.catalogue:quantities")
def quantities() -> None:
    """The quantities that stages share: meaning, unit, range, default, and which stages take one."""


@command("schema")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="A file instead of the terminal.",
)
@later("etendue.cli.bodies.beginnings:schema")
def schema() -> None:
    """A JSON Schema of pipeline files, with the stages and quantities of installed plugins: editors complete and check
    by it.

    With the schema in a file, `#:schema ./etendue.schema.json` as the first line of a pipeline tells editors that use
    taplo (such as VS Code with Even Better TOML) where it is.
    """
