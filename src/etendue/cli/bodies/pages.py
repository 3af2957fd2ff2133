"""``report`` and ``view``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from etendue import streams
from etendue.archive import places
from etendue.cli.saying import say
from etendue.errors import RequestError
from etendue.plugins.shares import shares_at
from etendue.present.page.document import start_of
from etendue.present.page.live import Live
from etendue.present.page.opened import Opened
from etendue.present.page.report import report as write
from etendue.present.page.server import Server

if TYPE_CHECKING:
    from etendue.types.documents import AxisValue


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
            f"{written.path}  {written.bytes / 1e6:.2f} MB, metrics of {written.cells} cells, pictures of "
            f"{written.pictured}"
        )


def view(place: Path | str, port: int, no_browser: bool) -> None:
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


@contextmanager
def blaming(wanted: bool, silent: bool) -> Iterator[Any]:
    """Yield the function that computes each stage's share of the loss, or None if not wanted."""
    if not wanted:
        yield None
        return
    from etendue.present.terminal.progress import trying

    found = shares_at()
    with trying(silent) as told:
        yield lambda folder, at: found(folder, at, told)


def begun_at(folder: Path) -> dict[str, AxisValue]:
    """Return the axis values of the cell shown first in the report and on the contact sheet of an archive."""
    opened = Opened(folder)
    start = start_of(opened)
    return {axis.dim: axis.values[start[axis.dim]] for axis in opened.axes}
