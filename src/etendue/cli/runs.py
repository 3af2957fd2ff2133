"""Commands of a run and its archive: ``plan``, ``run``, ``show``."""

from __future__ import annotations

from typing import Any

import click

from etendue import interrupts
from etendue.cli.options import JSON, MOST_CELLS, PLACE, SCHEDULER, WORKERS, gather_way, pipeline_options
from etendue.cli.saying import command, later


@command("plan")
@pipeline_options
@SCHEDULER
@WORKERS
@later("etendue.cli.bodies.plans:plan")
def plan() -> None:
    """What would run: stages, cells, bytes, time, what is left out and why.

    What `run` would refuse because the machine is too small, with these workers and into the archive of that name here,
    is said behind it; the exit code is then 5, as that of `run`.
    """


def _how(function: Any) -> Any:
    """How a run is done: nothing here changes a bit of the result."""
    for option in (
        click.option("--quiet", is_flag=True, help="No progress."),
        click.option(
            "--prune", is_flag=True, help="Remove finished results of an archive that this run does not keep."
        ),
        click.option(
            "--cell-timeout",
            type=click.FloatRange(0, min_open=True),
            metavar="SECONDS",
            help="A cell that takes longer is stopped and counts as failed. With processes or a cluster only: a thread "
            "cannot be stopped.",
        ),
        click.option("--accept-platform", is_flag=True, help="Go on with cells computed on another platform."),
        click.option("--recompute", is_flag=True, help="Compute again what is already finished."),
        click.option("--durable", is_flag=True, help="Survive a power cut: fsync every chunk and journal line."),
        WORKERS,
        SCHEDULER,
    ):
        function = option(function)
    return function


@command("run")
@pipeline_options
@click.option(
    "--archive",
    type=PLACE,
    metavar="DIR|URL",
    help="Where results are kept: a folder or s3://bucket/prefix/name; default ./<its name>.",
)
@_how
@click.option(
    "--measure", is_flag=True, help="Measure the global error of what is wanted, on sample cells against the reference."
)
@click.option(
    "--hold",
    type=click.FloatRange(0, 1, min_open=True),
    metavar="E",
    help="Find the loosest tolerance with which what is wanted stays within E of the reference, and run with it.",
)
@gather_way
@later("etendue.cli.bodies.runs:run", interrupts.INTACT)
def run() -> None:
    """Run a pipeline: compute what is not there yet, keep it, show it.

    On an archive that exists this resumes. A cell whose stage breaks off, kills its worker process or takes longer than
    --cell-timeout is recorded as failed, the rest goes on. Exit codes: 0 done, 2 the request is wrong, 3 some cells
    failed, 4 the archive is in use, 5 the machine is short or the cluster is gone, 130 or 143 interrupted (the archive
    is intact).
    """


@command("rerun")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@_how
@MOST_CELLS
@JSON
@gather_way
@later("etendue.cli.bodies.runs:rerun", interrupts.INTACT)
def rerun() -> None:
    """Run an archive again into itself, from the archive alone: the pipeline of its last run, with the files in its
    inputs.

    What is there and right stays; what is missing, damaged, or would come out differently now is computed. Exit codes
    as those of `run`.
    """


@command("show")
@click.argument("place", type=PLACE, metavar="DIR")
@JSON
@later("etendue.cli.bodies.archives:show_archive")
def archive() -> None:
    """What is in an archive: stages, variables, cells; how far a running or broken sweep is."""
