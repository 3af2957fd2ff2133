"""Commands that list installed items: ``stages``, ``quantities``, ``schema``."""

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
    """List installed stages with their package, inputs, outputs and parameters."""


@command("quantities")
@NAME
@JSON
@later("etendue.cli.bodies.loaded:quantities")
def quantities() -> None:
    """List the quantities that stages share: meaning, unit, range, default, and the stages that use them."""


@command("schema")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write to this file instead of stdout.",
)
@later("etendue.cli.bodies.beginnings:schema")
def schema() -> None:
    """Print a JSON Schema of pipeline files, including the stages and quantities of installed plugins, for completion
    and checks in editors.

    With the schema in a file, put `#:schema ./etendue.schema.json` on the first line of a pipeline: editors that use
    taplo (such as VS Code with Even Better TOML) then find it.
    """
