"""Plots of an archive: ``plot``."""

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
    help=".png, .svg, .pdf, or .csv: the numbers. Default ./ARCHIVE-KIND.png.",
)
@click.option("--list", "listing", is_flag=True, help="Say which kinds, variables and axes there are.")
@click.option("--at", multiple=True, metavar="DIM=VALUE", help="gain=2.8, stage=filter; may be repeated.")
@click.option("--x", default="", metavar="DIM", help="What runs along x.")
@click.option("--y", default="", metavar="DIM", help="What runs along y of a map.")
@click.option("--lines", default="", metavar="DIM", help="What lines of curves tell apart.")
@click.option("--panels", default="", metavar="DIM,DIM", help="What panels tell apart, at most two.")
@click.option(
    "--better", default="", metavar="WORD,WORD", help="Of a front: higher or lower, for each figure in order."
)
@click.option("--blame", is_flag=True, help="Of a budget: also what each stage is owed of what is lost; computed now.")
@JSON
@later("etendue.cli.bodies.plots:plot")
def plot() -> None:
    """Draw what an archive holds: figures over axes, curves, fronts, pictures, budgets.

    \b
    etendue plot sweep                                    what fits what it holds
    etendue plot sweep --list                             which figures and axes there are
    etendue plot sweep map FIGURE -o map.svg              numbers over two axes, a third as panels
    etendue plot sweep pareto FIGURE FIGURE               the front of two figures, named
    etendue plot sweep curves FIGURE --x time --lines gain
    etendue plot sweep strip                              all stages as pictures, a part of each enlarged
    etendue plot sweep show PICTURE --at gain=2.8 --at spacing=4um --at time=10ms
    etendue plot sweep budget                             run time, error, omissions by stage; --blame: and losses

    Other kinds come with what is installed: --list names them.
    """
