"""The command that writes an archive anew: ``compact``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.options import FOLDER, JSON, PLACE
from etendue.cli.saying import command, tell
from etendue.types.documents import Document

SHOWN = 6  # groups of which the name is said


@command("compact")
@click.argument("place", type=PLACE, metavar="DIR")
@click.argument("new", type=FOLDER, metavar="[NEW]", required=False)
@JSON
def compact(place: Path | str, new: Path | None, as_json: bool) -> None:
    """Write an archive anew: axes that grew sorted, shards as of a fresh sweep, the same bits in every array.

    In its place: killed at any instant the archive is whole, the old one or the new one, and the same command goes on.
    With NEW, DIR is only read, and NEW is whole or not there. Also of an archive with a file for every cell, as earlier
    versions wrote it.
    """
    if new is None:
        if not isinstance(place, Path):
            raise click.UsageError(f"{place} is not written anew in its place: name a folder, NEW, and copy that up")
        from etendue.archive.in_place import compact_in_place

        done = compact_in_place(place)
    else:
        from etendue.archive import places
        from etendue.archive.compact import compact as write_anew

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
    from etendue.telling import printable

    click.echo(f"{document['cells']} cells in {document['shards']} shards, {document['bytes']} bytes")
    groups: dict[str, list[str]] = {}
    for group, dims in document["sorted"].items():
        groups.setdefault(", ".join(dims), []).append(group)
    for dims, names in groups.items():
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        click.echo(printable(f"sorted   {dims} of {', '.join(names[:SHOWN])}{more}"))
    if document["written"]:
        click.echo(f"written  {document['written']} bytes, {document['amplification']:.2f} for each byte of cells")
    else:
        click.echo("nothing to be written: it is as a fresh sweep would leave it")
    click.echo(printable(f"archive  {document['archive']}"))
