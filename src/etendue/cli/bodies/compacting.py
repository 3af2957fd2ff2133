"""``compact``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from etendue.archive import places
from etendue.archive.write.compact import compact as write_anew
from etendue.archive.write.in_place import compact_in_place
from etendue.cli.saying import tell
from etendue.telling import printable

if TYPE_CHECKING:
    from etendue.types.documents import Document

SHOWN = 6  # groups listed by name


def compact(place: Path | str, new: Path | None, as_json: bool) -> None:
    if new is None:
        if not isinstance(place, Path):
            raise click.UsageError(f"{place} cannot be rewritten in place: give a local folder NEW and upload it")
        done = compact_in_place(place)
    else:
        with places.reading(place) as folder:
            done = write_anew(folder, new)
    document: Document = {
        "archive": str(done.folder),
        "cells": done.cells,
        "shards": done.shards,
        "bytes": done.bytes,
        "sorted": dict(done.sorted),
        "written": done.written,
        "amplification": done.amplification,
    }
    tell(as_json, document, _print)


def _print(document: Document) -> None:
    click.echo(f"{document['cells']} cells in {document['shards']} shards, {document['bytes']} bytes")
    groups: dict[str, list[str]] = {}
    for group, dims in document["sorted"].items():
        groups.setdefault(", ".join(dims), []).append(group)
    for dims, names in groups.items():
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        click.echo(printable(f"sorted   {dims} of {', '.join(names[:SHOWN])}{more}"))
    if document["written"]:
        click.echo(f"written  {document['written']} bytes, {document['amplification']:.2f} per byte of cells")
    else:
        click.echo("nothing to do: the archive is laid out as by a fresh sweep")
    click.echo(printable(f"archive  {document['archive']}"))
