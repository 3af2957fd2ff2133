"""The ``accuracy`` command: search the accuracy settings (knobs)."""

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
    help="Knob to try, even if the file sets it; =A,B gives its settings, from the cheapest to the reference"
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
    help="Number of sweep points to use; 1 takes the middle of the sweep.",
)
@click.option(
    "--repeat",
    default=3,
    show_default=True,
    type=click.IntRange(1),
    metavar="N",
    help="Number of cold and warm runs of each trial.",
)
@click.option(
    "--by",
    default="warm",
    show_default=True,
    type=click.Choice(["warm", "cold"]),
    help="Time to compare. Warm: with the tables of an earlier run, as in a sweep. Cold: with all tables computed "
    "again.",
)
@click.option(
    "--trials",
    "most",
    default=24,
    show_default=True,
    type=click.IntRange(0),
    metavar="N",
    help="Maximum number of combinations of settings to try.",
)
@click.option(
    "--verify",
    multiple=True,
    metavar="NAME=VALUE",
    help="Also check the cheapest settings on another scene, such as scene.file=other.png" + options.REPEAT,
)
@options.output("Folder for table (CSV, JSON) and plot. Default: ./<name>-accuracy.")
@options.JSON
@options.gather
@later("etendue.cli.bodies.accuracy:accuracy")
def accuracy() -> None:
    """Measure error against run time for each accuracy setting (knob) and find the cheapest combination for a
    tolerance.

    Every trial is compared with the reference (all knobs at their finest setting, no stage left out, 64 bits), both
    without noise and rounding. Without --knob, the command tries all knobs that the file does not set, the precision,
    and the discretisations (bins, spacing, surround), coarser and finer than in the file; the error of a combination
    includes the error of its discretisation. The order of convergence describes the error at the output of the knob's
    own stage. Errors below the noise of a single frame are invisible in that frame.

    Exit codes: 0 done, 2 invalid request.
    """
