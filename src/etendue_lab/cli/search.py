"""Commands that evaluate many cameras: ``optimise`` searches for the best, ``pairs`` draws them at random."""

from __future__ import annotations

from pathlib import Path

import click

from etendue.cli import options
from etendue.cli.saying import command, later


def _texts(name: str, metavar: str, help: str) -> options.Adds:
    return click.option(f"--{name}", multiple=True, metavar=metavar, help=help + options.REPEAT)


@command("optimise")
@options.FILE
@_texts("minimise", "METRIC", "Minimise this metric: rms, mtf50[mean]")
@_texts("maximise", "METRIC", "Maximise this metric")
@_texts("subject", "LIMIT", "Stay within a limit: 'clipped_fraction <= 0.01', 'pixel_pitch <= 3'")
@_texts(
    "over", "NAME=LOW:HIGH", "Search a setting: f_number=1.4:8, integration_time='1 ms:20 ms:log', demosaic.use=a,b"
)
@options.settings()
@click.option("--trials", default=100, show_default=True, type=click.IntRange(1), metavar="N", help="Number of trials.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), metavar="N", help="Seed of the search.")
@click.option(
    "--sampler",
    default="model",
    show_default=True,
    type=click.Choice(["model", "tpe", "nsga2", "random"]),
    help="Method of choosing the next settings: a model of the trials, optuna's tpe or nsga2, or random.",
)
@options.output("Folder for the trials and the picture of their history. Default: ./<name>-search.")
@options.JSON
@options.gather
@later("etendue_lab.search.terminal:optimise_command", "stopped; the same command continues with the next trial")
def optimise() -> None:
    """Search for the settings that make a metric best, within limits.

    Every trial runs the camera with new settings and recomputes only the cells that they affect. Finished trials are
    kept in the folder: after an interruption the same command continues, and ends with the same trials as an
    uninterrupted search; a larger --trials extends a finished search. A limit on a searched setting narrows its range.
    If a trial exceeds a limit, the optimiser receives the excess. A trial that fails, or that a stage refuses, counts
    as far beyond the limit. With several goals, the result is the Pareto front: the trials that no other trial beats in
    all goals.

    Needs optuna: pip install 'etendue[optimise]'.

    Exit codes: 0 done, 2 invalid request, 3 no trial meets all limits.
    """


@command("pairs")
@options.FILE
@click.option(
    "--photographs",
    required=True,
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder of pictures (PNG, JPEG, TIFF), searched with its subfolders, or one file.",
)
@_texts(
    "over",
    "NAME=LOW:HIGH",
    "Draw a setting at random: f_number=1.4:8, integration_time='1 ms:20 ms:log', demosaic.use=a,b",
)
@click.option(
    "--variable",
    "variables",
    multiple=True,
    metavar="VARIABLE",
    help="Variable of a pair; default: raw and expected_charge" + options.REPEAT,
)
@options.settings()
@click.option("--count", default=1000, show_default=True, type=click.IntRange(1), metavar="N", help="Number of pairs.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), metavar="N", help="Seed of all draws.")
@click.option(
    "--block", default=64, show_default=True, type=click.IntRange(1), metavar="N", help="Number of pairs in a file."
)
@options.WORKERS
@options.output("Folder for the files. Default: ./<name>-pairs.")
@options.JSON
@options.gather
@later("etendue_lab.pairs.terminal:pairs_command", "stopped; the same command continues with the next file")
def pairs() -> None:
    """Make training data: pictures of random cameras, each with its noise-free values.

    Every pair is one photograph seen by one camera whose settings are drawn at random from the ranges given by --over.
    It consists of the raw frame (raw) and the noise-free mean charge of the same pixels (expected_charge), or of any
    other variables with the dims y x or channel y x. A pair depends only on the seed and its number (0, 1, ...): it is
    the same on any machine of one platform, in any order and with any --workers.

    A file pairs-00000.npz holds each variable as float32 (number, channel, y, x); pairs-00000.json holds the settings
    of its pairs. Complete files are kept: after an interruption, or with a larger --count, the same command continues.

    Exit codes: 0 done, 2 invalid request.
    """
