"""Write the output of a command to stdout: a document as JSON, or text for people."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from etendue import streams


class _Command(click.Command):
    """A command with only its results on stdout: output of plugins goes to stderr."""

    def invoke(self, ctx: click.Context) -> Any:
        with streams.plugins_on_stderr():
            return super().invoke(ctx)


command = functools.partial(click.command, cls=_Command)


def say(document: Any) -> None:
    """Print JSON on stdout. Unknown values become null and infinity becomes "inf": JSON has neither NaN nor
    infinity.
    """
    from etendue.result_files import finite

    with streams.results():
        click.echo(json.dumps(_printable(finite(document)), allow_nan=False))


def show(draw: Any, *what: Any) -> None:
    """Print text for people on stdout."""
    with streams.results():
        draw(*what)


def tell(as_json: bool, document: Any, draw: Any) -> None:
    """Print a document, as JSON or as text."""
    if as_json:
        say(document)
    else:
        show(draw, document)


@contextmanager
def blaming(wanted: bool, silent: bool) -> Iterator[Any]:
    """Yield the function that computes each stage's share of the loss, or None if not wanted."""
    if not wanted:
        yield None
        return
    from etendue.plugins.shares import shares_at
    from etendue.present.terminal.progress import trying

    found = shares_at()
    with trying(silent) as told:
        yield lambda folder, at: found(folder, at, told)


def _printable(value: Any) -> Any:
    """Return a document without control characters, since it may be shown on a terminal."""
    from etendue.telling import printable

    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {_printable(key): _printable(own) for key, own in value.items()}
    return [_printable(own) for own in value] if isinstance(value, list | tuple) else value
