"""Commands that run pipelines: ``plan``, ``run``, ``rerun``, ``show``."""

from __future__ import annotations

from typing import Any

import click

from etendue import interrupts
from etendue.cli.options import HELD, JSON, MOST_CELLS, PLACE, SCHEDULER, WORKERS, gather_way, pipeline_options
from etendue.cli.saying import command, later


@command("plan")
@pipeline_options
@SCHEDULER
@WORKERS
@later("etendue.cli.bodies.plans:plan")
def plan() -> None:
    """Show what a run would do: stages, cells, bytes, time, and the stages that it would leave out, with the reason.

    If the machine does not have enough memory or disk space to run the plan (with these workers, into ./<name>), the
    reason is printed after the plan and the exit code is 5, as for `run`.
    """


def _how(function: Any) -> Any:
    """Add the options that control the execution of a run; none of them changes a bit of the result."""
    for option in (
        click.option("--quiet", is_flag=True, help="Show no progress."),
        click.option(
            "--prune", is_flag=True, help="Remove from the archive the finished results that this run does not keep."
        ),
        click.option(
            "--cell-timeout",
            type=click.FloatRange(0, min_open=True),
            metavar="SECONDS",
            help="Stop a cell that takes longer and count it as failed. Only with processes or a cluster: threads "
            "cannot be stopped.",
        ),
        click.option("--accept-platform", is_flag=True, help="Continue with cells computed on another platform."),
        click.option("--recompute", is_flag=True, help="Recompute finished cells."),
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
    help="Where to store results: a folder or s3://bucket/prefix/name. Default: ./<name of the pipeline>.",
)
@_how
@click.option(
    "--measure",
    is_flag=True,
    help="Measure the error of the wanted variables caused by all omissions and coarser settings, on sample cells.",
)
@click.option(
    "--hold",
    type=HELD,
    multiple=True,
    metavar="E|METRIC=E",
    help="Find the loosest tolerance that keeps every wanted variable within E of the reference, relative to full "
    "scale, or METRIC within E in its own unit (repeatable). If the file sets parameters to 'auto', also refine them "
    "until the total error, including discretisation, is within E. Then run with these values.",
)
@click.option(
    "--hold-seconds",
    type=click.FloatRange(0),
    default=900.0,
    show_default=True,
    help="Maximum CPU time of the search by --hold, in seconds.",
)
@click.option(
    "--errors/--no-errors",
    default=True,
    help="State the error of every wanted variable, measured by test runs (the pilot) that take at most 10 % of the "
    "run or 0.2 s, whichever is more; --measure removes this limit.",
)
@gather_way
@later("etendue.cli.bodies.runs:run", interrupts.INTACT)
def run() -> None:
    """Run a pipeline: compute missing cells, store them in an archive, print a summary.

    An existing archive is resumed. A cell is recorded as failed if its stage fails, kills its worker process or takes
    longer than --cell-timeout; the other cells continue.

    Exit codes: 0 done, 2 invalid request, 3 some cells failed, 4 archive in use, 5 out of memory or disk, or cluster
    lost, 130 or 143 interrupted (the archive is intact).
    """


@command("rerun")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@_how
@MOST_CELLS
@JSON
@gather_way
@later("etendue.cli.bodies.runs:rerun", interrupts.INTACT)
def rerun() -> None:
    """Bring an archive up to date, from the archive alone: run the archive's last pipeline again with the stored input
    files.

    Results that are present and valid stay. Results that are missing, damaged or out of date (code or input files have
    changed) are computed. Exit codes are the same as for `run`.
    """


@command("show")
@click.argument("place", type=PLACE, metavar="DIR")
@JSON
@later("etendue.cli.bodies.archives:show_archive")
def archive() -> None:
    """Summarise an archive: stages, variables, cells, and the progress of a running or interrupted sweep."""
