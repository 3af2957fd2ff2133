"""Commands that show an archive as a page: ``report``, ``view``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.options import JSON, PLACE
from etendue.cli.saying import command, later


@command("report")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Default ./ARCHIVE-report.html; an older one is replaced.",
)
@click.option("--blame", is_flag=True, help="Also what each stage is owed of what is lost; computed now.")
@JSON
@later("etendue.cli.bodies.pages:report")
def report() -> None:
    """One page to read and send on: pictures, maps, curves, trade-offs, errors, failures.

    A single HTML file that opens in any browser of 2023 or later, offline. It holds the figures of all cells and the
    pictures of at most 64. Of a run that is still going on it holds what is there.
    """


@command("view")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option("--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="Default: any that is free.")
@click.option("--no-browser", is_flag=True, help="Only say the address.")
@later("etendue.cli.bodies.pages:view")
def view() -> None:
    """The same page live, with every pixel of every stage: in a browser, on this machine alone.

    Follows a run that is still going on; of an archive at an object store it shows what was there at the start. The
    address holds a secret: whoever has it, on this machine, can look; nobody can change anything. Ends with Ctrl-C.
    """
