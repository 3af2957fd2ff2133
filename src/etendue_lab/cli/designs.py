"""Commands that evaluate a design: ``sensitivity`` and ``yield``."""

from __future__ import annotations

import click

from etendue.cli import options
from etendue.cli.saying import command, later

AT = click.option(
    "--at",
    multiple=True,
    metavar="AXIS=VALUE",
    help="Use only this value of an axis or dim of the metrics" + options.REPEAT,
)


@command("sensitivity")
@click.argument("place", type=options.PLACE, metavar="ARCHIVE")
@click.argument("metrics", nargs=-1, required=True, metavar="METRIC...")
@AT
@options.JSON
@later("etendue_lab.designs.terminal:sensitivity_command")
def sensitivity() -> None:
    """Report the effect of each factor of a design on metrics, from the samples of an archive.

    For a design with method = "saltelli", the command gives first-order and total Sobol' indices with 95 % intervals.
    For any design, it gives standardised regression coefficients, rank correlations, main effects (the share of the
    variance that a factor explains alone), and the share that the product of two factors explains in addition. If the
    sweep has other axes, the command repeats all of this for every combination of their values.
    """


@command("yield")
@click.argument("place", type=options.PLACE, metavar="ARCHIVE")
@click.option(
    "--require",
    "requirements",
    multiple=True,
    required=True,
    metavar="'METRIC >= VALUE'",
    help="Requirement that a unit must meet, with >=, <=, > or <; the value may have a unit" + options.REPEAT,
)
@AT
@options.JSON
@later("etendue_lab.designs.terminal:yield_command")
def yield_() -> None:
    """Report the share of units that pass all requirements; every sample of a design is a unit.

    The share has Wilson's 95 % interval. Requirements are ranked by how many units fail them. For each factor, the
    samples are reweighted to predict the yield if the spread of that factor were a tenth smaller. The prediction has an
    interval, and the number of equally weighted units that would give the same accuracy.
    """
