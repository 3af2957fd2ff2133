"""``quantities``, and the documents of ``stages`` from the installed stages themselves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from etendue.cli.bodies.catalogue import STAGES, tell_one
from etendue.cli.options import installed
from etendue.contract.listing import quantity_document, role_documents, stage_document
from etendue.contract.values import quantities as shared
from etendue.contract.values.tables import tables
from etendue.errors import RequestError, nearest
from etendue.plugins import discovery, unchanged
from etendue.present.terminal.catalogue import print_quantities, print_quantity

if TYPE_CHECKING:
    from etendue.types.documents import Document


def _check(what: str, name: str | None, names: Sequence[str], hook: str) -> None:
    if name is not None and name not in names:
        raise RequestError(f"unknown {what} {name!r}{nearest(name, names)}{discovery.installed().missed(hook, name)}")


def loaded(name: str | None) -> Document:
    """Load one stage, or all, and return their documents; the documents of all stages are cached if every stage could
    be loaded.
    """
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
    head, _, tail = (name or "").partition(".")
    name = tail if tail and head in tables() else name
    _check(f"{next(iter(tables()))} quantity", name, shared.names(), "quantities")
    registry = installed() if name else None
    tell_one(
        as_json, name, shared.names(), lambda own: quantity_document(own, registry), print_quantity, print_quantities
    )
