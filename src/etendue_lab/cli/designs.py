"""Commands that evaluate a design: ``sensitivity`` and ``yield``."""

from __future__ import annotations

import click

from etendue.cli import options
from etendue.cli.saying import command, later

AT = click.option(
    "--at",
    multiple=True,
    metavar="AXIS=VALUE",
    help="Only this value of an axis or dim of the metrics" + options.REPEAT,
)


@command("sensitivity")
@click.argument("place", type=options.PLACE, metavar="ARCHIVE")
@click.argument("metrics", nargs=-1, required=True, metavar="METRIC...")
@AT
@options.JSON
@later("etendue_lab.designs.terminal:sensitivity_command")
def sensitivity() -> None:
    """Report which factors of a design matter for metrics, from the samples of an archive.

    For a design with method = "saltelli": first-order and total Sobol' indices with 95 % intervals. For any design:
    standardised regression coefficients, rank correlations, main effects (the share of the variance that the mean over
    a factor explains) and products of pairs. At every combination of the other axes of the sweep.
    """


@command("yield")
@click.argument("place", type=options.PLACE, metavar="ARCHIVE")
@click.option(
    "--require",
    "requirements",
    multiple=True,
    required=True,
    metavar="'METRIC >= VALUE'",
    help="What a unit must fulfil, with >=, <=, > or <; the value may have a unit" + options.REPEAT,
)
@AT
@options.JSON
@later("etendue_lab.designs.terminal:yield_command")
def yield_() -> None:
    """Report which share of units passes: every sample of a design is a unit.

    The share has Wilson's 95 % interval. Requirements are ranked by how many units fail them. For each factor the yield
    with a spread that is smaller by a tenth is found from the same samples with other weights, with its interval and
    the number of units of equal weight that would tell as much.
    """
