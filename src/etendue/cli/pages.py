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
    help="File to write; an existing file is replaced. Default: ./ARCHIVE-report.html.",
)
@click.option("--blame", is_flag=True, help="Also compute and add each stage's share of the loss of quality.")
@JSON
@later("etendue.cli.bodies.pages:report")
def report() -> None:
    """Write a self-contained HTML report: pictures, maps, curves, trade-offs, errors, failures.

    The file opens offline in any browser of 2023 or later. It holds the metrics of all cells and the pictures of at
    most 64 cells. If the run is still in progress, the file contains the finished cells.
    """


@command("view")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="Port to listen on. Default: any free port."
)
@click.option("--no-browser", is_flag=True, help="Print the address only.")
@later("etendue.cli.bodies.pages:view")
def view() -> None:
    """Serve the report live, with every sample of every stage, to a browser on this machine.

    The page follows a run in progress; an archive in an object store is shown in the state that it has when the command
    starts. The address contains a secret: users of this machine who know this address can open the page, but nobody can
    change anything. Stop with Ctrl-C.
    """
