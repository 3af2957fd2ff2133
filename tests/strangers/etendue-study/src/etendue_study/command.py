"""The command ``slopes``."""

import click

from etendue.cli import options
from etendue.cli.saying import command, say, show


@command("slopes")
@options.FILE
@click.argument("moved", metavar="NAME=V,V")
@options.JSON
def slopes(file, moved, as_json):
    """How far every figure of a pipeline moves when a quantity has the second of two values in place of the first.

    Exit codes: 0 done, 2 the request is wrong.
    """
    from etendue import Pipeline
    from etendue.api import RequestError
    from etendue_study.study import slopes as found

    name, _, values = moved.partition("=")
    ends = values.split(",")
    if len(ends) != 2 or not all(ends):
        raise RequestError(f"{moved!r} has no two values; write tone=1000,1100")
    changes = found(Pipeline.read(file), **{name: [_number(value) for value in ends]})
    if as_json:
        say(changes)
    else:
        show(_print, changes)


def _number(text):
    try:
        return float(text)
    except ValueError:
        return text


def _print(changes):
    for name, change in changes.items():
        click.echo(f"{name:30s} {100 * change:+.1f} %")
