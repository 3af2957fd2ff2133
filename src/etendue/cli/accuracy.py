"""The command that walks fidelity knobs: ``accuracy``."""

from __future__ import annotations

import click

from etendue.cli import options
from etendue.cli.saying import command, later


@command("accuracy")
@options.FILE
@click.option(
    "--knob",
    "knobs",
    multiple=True,
    metavar="STAGE.KNOB[=V,V,..]",
    help="Try this knob, also one that the file writes, or precision; settings from the cheapest to the reference"
    + options.REPEAT,
)
@options.settings()
@options.SWEEPS
@options.WANT
@options.TOLERANCE
@click.option(
    "--cells",
    default=1,
    show_default=True,
    type=click.IntRange(1),
    metavar="N",
    help="Points of the sweep; one is its middle.",
)
@click.option(
    "--repeat",
    default=3,
    show_default=True,
    type=click.IntRange(1),
    metavar="N",
    help="Runs of a trial; the least time counts.",
)
@click.option(
    "--trials", "most", default=24, show_default=True, type=click.IntRange(0), metavar="N", help="Combinations at most."
)
@click.option(
    "--verify",
    multiple=True,
    metavar="NAME=VALUE",
    help="Try the cheapest settings there too: scene.file=other.png" + options.REPEAT,
)
@options.output("Table as CSV and JSON, diagram; default ./<name>-accuracy.")
@options.JSON
@options.gather
@later("etendue.cli.bodies.accuracy:accuracy")
def accuracy() -> None:
    """Error against run time: every fidelity knob alone, the front over combinations, the cheapest setting for a
    tolerance.

    Every trial is held against the reference (all knobs at their best setting, nothing left out, 64 bits), both without
    noise and rounding. Without --knob all knobs are tried that the file does not write, and precision; how the scene is
    drawn is tried where it is asked for. The order of convergence is that of the stage's own error. Errors below the
    noise of one frame cannot be seen in one.

    Exit codes: 0 done, 2 the request is wrong.
    """
