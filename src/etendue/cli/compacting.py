"""The command that writes an archive anew: ``compact``."""

from __future__ import annotations

import click

from etendue.cli.options import FOLDER, JSON, PLACE
from etendue.cli.saying import command, later


@command("compact")
@click.argument("place", type=PLACE, metavar="DIR")
@click.argument("new", type=FOLDER, metavar="[NEW]", required=False)
@JSON
@later("etendue.cli.bodies.compacting:compact")
def compact() -> None:
    """Write an archive anew: axes that grew sorted, shards as of a fresh sweep, the same bits in every array.

    In its place: killed at any instant the archive is whole, the old one or the new one, and the same command goes on.
    With NEW, DIR is only read, and NEW is whole or not there. Also of an archive with a file for every cell, as earlier
    versions wrote it.
    """
