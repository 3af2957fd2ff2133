"""The ``compact`` command: rewrite an archive."""

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
    """Rewrite an archive with sorted axes and the shards of a fresh sweep; every array keeps its bits.

    Without NEW the archive is rewritten in place. If the command is killed, the archive is still complete, old or
    new; run the same command again to continue. With NEW, DIR is only read, and NEW is either complete or absent.
    Archives of earlier versions, with one file per cell, are accepted too.
    """
