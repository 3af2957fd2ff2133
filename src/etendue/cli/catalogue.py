"""Commands that list what is installed: ``stages``, ``quantities``, ``schema``."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from etendue.cli.options import JSON, NAME, installed
from etendue.cli.saying import command, say, tell


def tell_one(
    as_json: bool, name: str | None, names: Sequence[str], document: Callable[[str], Any], one: Any, all: Any
) -> None:
    """Print the document of the named item, or those of all."""
    documents = [document(own) for own in ([name] if name else names)]
    if name and not as_json:
        tell(False, documents[0], one)
    else:
        tell(as_json, documents, all)


def _check(what: str, name: str | None, names: Sequence[str], hook: str) -> None:
    from etendue.errors import RequestError, nearest
    from etendue.plugins import discovery

    if name is not None and name not in names:
        raise RequestError(f"unknown {what} {name!r}{nearest(name, names)}{discovery.installed().missed(hook, name)}")


@command("stages")
@NAME
@JSON
def stages(name: str | None, as_json: bool) -> None:
    """List installed stages with their package, inputs, outputs and parameters."""
    from etendue.present.terminal.catalogue import print_stage, print_stages, stage_document
    from etendue.telling import printable

    registry = installed()
    _check("stage", name, registry.names(), "stages")
    tell_one(as_json, name, registry.names(), lambda own: stage_document(registry, own), print_stage, print_stages)
    for text in () if name else registry.found.notes():
        click.echo(f"note: {printable(text)}", err=True)


@command("quantities")
@NAME
@JSON
def quantities(name: str | None, as_json: bool) -> None:
    """List the quantities that stages share: meaning, unit, range, default, and the stages that use each."""
    from etendue.contract.values import quantities as shared
    from etendue.contract.values.tables import tables
    from etendue.present.terminal.catalogue import print_quantities, print_quantity, quantity_document

    head, _, tail = (name or "").partition(".")
    name = tail if tail and head in tables() else name
    _check(f"{next(iter(tables()))} quantity", name, shared.names(), "quantities")
    registry = installed() if name else None
    tell_one(
        as_json, name, shared.names(), lambda own: quantity_document(own, registry), print_quantity, print_quantities
    )


@command("schema")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write to this file instead of stdout.",
)
def schema(output: Path | None) -> None:
    """Print a JSON Schema of pipeline files, including the stages and quantities of installed plugins, for completion
    and checks in editors.

    With the schema in a file, put `#:schema ./etendue.schema.json` on the first line of a pipeline: editors that use
    taplo (such as VS Code with Even Better TOML) then find it.
    """
    from etendue.pipeline.schema import schema as make

    document = make(installed())
    if output is None:
        say(document)
    else:
        output.write_text(json.dumps(document, indent=1), encoding="utf-8")
        click.echo(f"{output}: to use it in an editor, start a pipeline with the line '#:schema ./{output.name}'")
