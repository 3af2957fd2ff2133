"""The command that writes an archive anew: ``compact``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from etendue.cli.options import JSON
from etendue.cli.saying import command, tell


@command("compact")
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@click.argument("new", type=click.Path(path_type=Path), metavar="NEW")
@JSON
def compact(folder: Path, new: Path, as_json: bool) -> None:
    """Write an archive anew: axes that grew sorted, shards as of a fresh sweep, the same bits in every array.

    Also of an archive with a file for every cell, as earlier versions wrote it. DIR is only read; NEW is whole or not there.
    """
    from etendue.archive.compact import compact as write_anew

    done = write_anew(folder, new)
    document: dict[str, Any] = {
        "archive": str(done.folder), "cells": done.cells, "shards": done.shards, "bytes": done.bytes, "sorted": dict(done.sorted),
    }  # fmt: skip
    tell(as_json, document, _print)


def _print(document: dict[str, Any]) -> None:
    from etendue.telling import printable

    click.echo(f"{document['cells']} cells in {document['shards']} shards, {document['bytes']} bytes")
    for group, dims in document["sorted"].items():
        click.echo(printable(f"sorted: {', '.join(dims)} of {group}"))
    click.echo(printable(f"archive  {document['archive']}"))
