"""``stages`` and ``quantities``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click

from etendue.cli.options import installed
from etendue.cli.saying import tell
from etendue.contract.values import quantities as shared
from etendue.contract.values.tables import tables
from etendue.errors import RequestError, nearest
from etendue.plugins import discovery
from etendue.present.terminal.catalogue import (
    print_quantities,
    print_quantity,
    print_stage,
    print_stages,
    quantity_document,
    stage_document,
)
from etendue.telling import printable

if TYPE_CHECKING:
    from etendue.types.documents import Document


def tell_one(
    as_json: bool,
    name: str | None,
    names: Sequence[str],
    document: Callable[[str], Document],
    one: Callable[[Document], None],
    all: Callable[[list[Document]], None],
) -> None:
    """Print the document of the named item, or those of all."""
    documents = [document(own) for own in ([name] if name else names)]
    if name and not as_json:
        tell(False, documents[0], one)
    else:
        tell(as_json, documents, all)


def _check(what: str, name: str | None, names: Sequence[str], hook: str) -> None:
    if name is not None and name not in names:
        raise RequestError(f"unknown {what} {name!r}{nearest(name, names)}{discovery.installed().missed(hook, name)}")


def stages(name: str | None, as_json: bool) -> None:
    registry = installed()
    _check("stage", name, registry.names(), "stages")
    tell_one(as_json, name, registry.names(), lambda own: stage_document(registry, own), print_stage, print_stages)
    for text in () if name else registry.found.notes():
        click.echo(f"note: {printable(text)}", err=True)


def quantities(name: str | None, as_json: bool) -> None:
    head, _, tail = (name or "").partition(".")
    name = tail if tail and head in tables() else name
    _check(f"{next(iter(tables()))} quantity", name, shared.names(), "quantities")
    registry = installed() if name else None
    tell_one(
        as_json, name, shared.names(), lambda own: quantity_document(own, registry), print_quantity, print_quantities
    )
