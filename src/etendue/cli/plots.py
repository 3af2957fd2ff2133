"""The ``plot`` command: plots of an archive."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli.options import JSON, PLACE
from etendue.cli.saying import command, later


@command("plot")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@click.argument("words", nargs=-1, metavar="[KIND] [VARIABLE]...")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help=".png, .svg, .pdf, or .csv for the numbers. Default: ./ARCHIVE-KIND.png.",
)
@click.option("--list", "listing", is_flag=True, help="List kinds, variables and axes, then exit.")
@click.option(
    "--at", multiple=True, metavar="DIM=VALUE", help="Select along an axis: gain=2.8, stage=filter; may be repeated."
)
@click.option("--x", default="", metavar="DIM", help="Axis to show along x.")
@click.option("--y", default="", metavar="DIM", help="Axis to show along y of a map.")
@click.option("--lines", default="", metavar="DIM", help="Axis to show as separate lines.")
@click.option("--panels", default="", metavar="DIM,DIM", help="Axis to show as panels; two at most, such as gain,time.")
@click.option(
    "--better", default="", metavar="WORD,WORD", help="For pareto: higher or lower, for each metric in order."
)
@click.option(
    "--blame",
    is_flag=True,
    help="For budget: also compute and add each stage's share of the loss of quality.",
)
@JSON
@later("etendue.cli.bodies.plots:plot")
def plot() -> None:
    """Plot the content of an archive: maps and curves of metrics, Pareto fronts, pictures, budgets.

    \b
    etendue plot sweep                                    the archive "sweep", in a kind of plot that suits it
    etendue plot sweep --list                             list metrics and axes
    etendue plot sweep map METRIC -o map.svg              a metric over two axes, a third as panels
    etendue plot sweep pareto METRIC METRIC               Pareto front of two metrics, labelled
    etendue plot sweep curves METRIC --x time --lines gain
    etendue plot sweep strip                              pictures of all stages, each with an enlarged detail
    etendue plot sweep show PICTURE --at gain=2.8 --at spacing=4um --at time=10ms
    etendue plot sweep budget                             time, error, omissions by stage; --blame adds losses

    Plugins may add kinds: --list names them.
    """
