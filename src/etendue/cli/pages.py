"""Commands that show an archive as a page: ``report``, ``view``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue import streams
from etendue.cli.options import JSON, PLACE
from etendue.cli.saying import blaming, command, say


@command("report")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="File to write; an existing one is replaced. Default: ./ARCHIVE-report.html.",
)
@click.option("--blame", is_flag=True, help="Add each stage's share of the loss; computed now.")
@JSON
def report(place: Path | str, output: Path | None, blame: bool, as_json: bool) -> None:
    """Write a self-contained HTML report: pictures, maps, curves, trade-offs, errors, failures.

    The file opens offline in any browser of 2023 or later. It holds the metrics of all cells and the pictures of at
    most 64. If the run is still in progress, it holds what is finished.
    """
    from etendue.archive import places
    from etendue.present.page.report import report as write

    with places.reading(place) as folder, blaming(blame, as_json) as shares:
        written = write(folder, output or Path(f"{folder.resolve().name}-report.html"), shares)
    if as_json:
        say(
            {
                "file": str(written.path),
                "bytes": written.bytes,
                "cells": written.cells,
                "pictured": written.pictured,
                "failed": written.failed,
            }
        )
        return
    with streams.results():
        click.echo(
            f"{written.path}  {written.bytes / 1e6:.2f} MB, metrics of {written.cells} cells, pictures of "
            f"{written.pictured}"
        )


@command("view")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="Port to listen on. Default: any free port."
)
@click.option("--no-browser", is_flag=True, help="Print the address only.")
def view(place: Path | str, port: int, no_browser: bool) -> None:
    """Serve the report live, with every sample of every stage, to a browser on this machine.

    A run in progress is followed; an archive in an object store is shown as it was at the start. The address contains a
    secret: anyone on this machine who has it can look; nobody can change anything. Stop with Ctrl-C.
    """
    from etendue.archive import places
    from etendue.errors import RequestError
    from etendue.present.page.live import Live
    from etendue.present.page.server import Server

    with places.reading(place) as folder:
        try:
            opened = Server(Live(folder), port)
        except OSError as error:
            raise RequestError(
                f"--port {port}: {(error.strerror or 'refused').lower()}; omit the option to use any free port"
            ) from None
        with opened as server:
            with streams.results():
                click.echo(server.url)
            if not no_browser:
                import webbrowser

                webbrowser.open(server.url)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                click.echo("stopped", err=True)
