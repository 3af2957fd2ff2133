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
    help="Default ./ARCHIVE-report.html; an older one is replaced.",
)
@click.option("--blame", is_flag=True, help="Also what each stage is owed of what is lost; computed now.")
@JSON
def report(place: Path | str, output: Path | None, blame: bool, as_json: bool) -> None:
    """One page to read and send on: pictures, maps, curves, trade-offs, errors, failures.

    A single HTML file that opens in any browser of 2023 or later, offline. It holds the figures of all cells and the
    pictures of at most 64. Of a run that is still going on it holds what is there.
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
            f"{written.path}  {written.bytes / 1e6:.2f} MB, figures of {written.cells} cells, pictures of "
            f"{written.pictured}"
        )


@command("view")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.option("--port", type=click.IntRange(0, 65535), default=0, metavar="N", help="Default: any that is free.")
@click.option("--no-browser", is_flag=True, help="Only say the address.")
def view(place: Path | str, port: int, no_browser: bool) -> None:
    """The same page live, with every pixel of every stage: in a browser, on this machine alone.

    Follows a run that is still going on; of an archive at an object store it shows what was there at the start. The
    address holds a secret: whoever has it, on this machine, can look; nobody can change anything. Ends with Ctrl-C.
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
                f"--port {port}: {(error.strerror or 'refused').lower()}; without it any port that is free is taken"
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
                click.echo("ended", err=True)
