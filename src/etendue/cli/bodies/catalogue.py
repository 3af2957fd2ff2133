"""``stages``, from the list of an earlier call if nothing has changed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click

from etendue.cli.saying import tell
from etendue.plugins import unchanged
from etendue.present.terminal.catalogue import print_stage, print_stages
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
    """Print the document of the item ``name``, or of all items, as JSON or text."""
    documents = [document(own) for own in ([name] if name else names)]
    if name and not as_json:
        tell(False, documents[0], one)
    else:
        tell(as_json, documents, all)


def stages(name: str | None, as_json: bool) -> None:
    known = unchanged.recall(STAGES)
    if known is None or (name is not None and name not in known["stages"]):
        from etendue.cli.bodies.loaded import loaded

        known = loaded(name)
    every = known["stages"]
    tell_one(as_json, name, list(every), every.__getitem__, print_stage, lambda own: print_stages(own, known["roles"]))
    for text in known["notes"]:
        click.echo(f"note: {printable(text)}", err=True)
