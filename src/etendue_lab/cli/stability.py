"""The ``stability`` command: test every installed stage, kernels and whole cameras at extremes."""

from __future__ import annotations

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("stability")
@click.argument("stages", nargs=-1, metavar="[STAGE]...")
@click.option("--all", "every", is_flag=True, help="Show every case, not just the worst of each law.")
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    help="Seed of the random numbers with which the statistical laws are tested. Default: 0.",
)
@options.WORKERS
@options.JSON
@later("etendue_lab.stability.terminal:stability_command")
def stability() -> None:
    """Test stages at numerically hard inputs: they must compute, or refuse with a clear message.

    Every installed stage, plugins included, is run with parameters at the ends and corners of their ranges, at zero and
    infinity if allowed, and inside the ranges. It is run in single, double and long double precision, with dark,
    bright, undefined and negative inputs, and with inputs and parameters changed in their last bit. The whole ranges of
    inputs and parameters are searched for jumps. Uniform light must stay uniform up to the border, mirrored and shifted
    pictures must give mirrored and shifted results; no picture may affect the next one or another thread; noise must
    have the declared mean and variance, and no correlation; codes must be rounded to the nearest; a neutral parameter
    must change nothing. Built-in stages are compared with stored references. Then kernels are compared with closed
    forms evaluated to many digits, and whole cameras are run at extreme settings. If STAGE is given, only those stages
    are tested.

    Errors are relative to the largest output value; the condition number is the factor by which a small relative change
    of the input grows in the output.

    Exit codes: 0 all passed, 1 a check failed, 2 invalid request.
    """
