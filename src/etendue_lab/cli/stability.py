"""The command ``stability``: every installed stage, kernels and whole cameras at extremes."""

from __future__ import annotations

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("stability")
@click.argument("stages", nargs=-1, metavar="[STAGE]...")
@click.option("--all", "every", is_flag=True, help="A row for each case, not the worst of each law.")
@options.WORKERS
@options.JSON
@later("etendue_lab.stability.terminal:stability_command")
def stability() -> None:
    """Try stages where numbers are hard: do they compute, or refuse in words?

    Every installed stage, plugins too, at the ends and in the corners of every range that it declares, at zero and
    infinity where they are allowed, and inside; in single, double and long double precision; with inputs that are dark,
    bright, undefined or negative; with inputs and parameters moved by their last bit. Then the kernels against closed
    forms of many digits, and whole cameras at extremes. With names: these stages alone.

    An error is relative to the largest value of what is written; condition is how many times a small change grows.

    Exit codes: 0 all hold, 1 a check failed, 2 the request is wrong.
    """
