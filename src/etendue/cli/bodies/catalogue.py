"""``stages`` and ``quantities``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click

from etendue.cli.options import installed
from etendue.cli.saying import tell
from etendue.errors import RequestError, nearest
from etendue.plugins import unchanged
from etendue.present.terminal.catalogue import print_quantities, print_quantity, print_stage, print_stages
from etendue.telling import printable

if TYPE_CHECKING:
    from etendue.types.documents import Document

STAGES = "stages"


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
    from etendue.plugins import discovery

    if name is not None and name not in names:
        raise RequestError(f"unknown {what} {name!r}{nearest(name, names)}{discovery.installed().missed(hook, name)}")


def stages(name: str | None, as_json: bool) -> None:
    known = unchanged.recall(STAGES)
    if known is None or (name is not None and name not in known["stages"]):
        known = _loaded(name)
    every = known["stages"]
    tell_one(as_json, name, list(every), every.__getitem__, print_stage, lambda own: print_stages(own, known["roles"]))
    for text in known["notes"]:
        click.echo(f"note: {printable(text)}", err=True)


def _loaded(name: str | None) -> Document:
    """Load one stage, or all, and return their documents; those of all are kept if nothing is amiss."""
    from etendue.contract.listing import role_documents, stage_document

    registry = installed()
    _check("stage", name, registry.names(), STAGES)
    documents = {own: stage_document(registry, own) for own in ([name] if name else registry.names())}
    if name:
        return {"stages": documents, "roles": {}, "notes": []}
    found = {"stages": documents, "roles": role_documents(), "notes": registry.found.notes()}
    if not (found["notes"] or any("broken" in own for own in documents.values())):
        unchanged.keep(STAGES, found, {"etendue", *(point.module.partition(".")[0] for point in registry.found.points)})
    return found


def quantities(name: str | None, as_json: bool) -> None:
    from etendue.contract.listing import quantity_document
    from etendue.contract.values import quantities as shared
    from etendue.contract.values.tables import tables

    head, _, tail = (name or "").partition(".")
    name = tail if tail and head in tables() else name
    _check(f"{next(iter(tables()))} quantity", name, shared.names(), "quantities")
    registry = installed() if name else None
    tell_one(
        as_json, name, shared.names(), lambda own: quantity_document(own, registry), print_quantity, print_quantities
    )
