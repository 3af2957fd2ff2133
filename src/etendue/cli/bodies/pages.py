"""``report`` and ``view``."""

from __future__ import annotations

from pathlib import Path

import click

from etendue import streams
from etendue.archive import places
from etendue.cli.saying import blaming, say
from etendue.errors import RequestError
from etendue.present.page.live import Live
from etendue.present.page.report import report as write
from etendue.present.page.server import Server


def report(place: Path | str, output: Path | None, blame: bool, as_json: bool) -> None:
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


def view(place: Path | str, port: int, no_browser: bool) -> None:
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
