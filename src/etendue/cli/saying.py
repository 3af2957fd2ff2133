"""Write the output of a command to stdout: a document as JSON, or readable text."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from typing import Any

import click

from etendue import interrupts, streams
from etendue.result_files import finite
from etendue.telling import printable


class _Command(click.Command):
    """A command that writes only its own results to stdout; anything that plugins print goes to stderr."""

    def invoke(self, ctx: click.Context) -> Any:
        with streams.plugins_on_stderr():
            return super().invoke(ctx)


command = functools.partial(click.command, cls=_Command)


def later(place: str, interrupted: str = "") -> Callable[[Callable[[], None]], Callable[..., None]]:
    """Return a decorator that gives a command its implementation, ``module:function``, imported only when it is called.

    This keeps ``--help`` fast. ``interrupted``: the message printed if a signal arrives while the command runs.
    """

    def does(declared: Callable[[], None]) -> Callable[..., None]:
        @functools.wraps(declared)
        def called(**words: Any) -> None:
            if interrupted:
                interrupts.say(interrupted)
            from pkgutil import resolve_name

            resolve_name(place)(**words)

        called.__dict__["place"] = place  # lets a test check that the implementation exists
        return called

    return does


def say(document: Any) -> None:
    """Print JSON on stdout. Unknown values become null and infinity becomes "inf": JSON has neither NaN nor
    infinity.
    """
    with streams.results():
        click.echo(json.dumps(_printable(finite(document)), allow_nan=False))


def show(draw: Any, *what: Any) -> None:
    """Print readable text on stdout."""
    with streams.results():
        draw(*what)


def tell(as_json: bool, document: Any, draw: Any) -> None:
    """Print a document, as JSON or as text."""
    if as_json:
        say(document)
    else:
        show(draw, document)


def _printable(value: Any) -> Any:
    """Return a document without control characters, since it may be shown on a terminal."""
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {_printable(key): _printable(own) for key, own in value.items()}
    return [_printable(own) for own in value] if isinstance(value, list | tuple) else value
