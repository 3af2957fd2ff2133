"""Commands of a run and its archive: ``plan``, ``run``, ``show``."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from etendue import interrupts
from etendue.cli.options import (
    JSON,
    MOST_CELLS,
    PLACE,
    SCHEDULER,
    WORKERS,
    Given,
    Way,
    from_here,
    gather_way,
    installed,
    pipeline_options,
    progress,
)
from etendue.cli.saying import command, say, show, tell
from etendue.types.documents import Document


def _pipeline(given: Given) -> Any:
    pipeline = given.pipeline()
    if (
        given.want and pipeline.keep is not None and pipeline.wanted is not None
    ):  # what is asked for now is kept, whatever the file keeps
        pipeline = replace(pipeline, keep=(*pipeline.keep, *pipeline.wanted))
    if not given.nothing_left_out:
        return pipeline
    from etendue.accuracy.reference import reference_of

    return reference_of(pipeline, installed()).pipeline


def _plan(given: Given, quiet: bool, pipeline: Any = None) -> Any:
    from etendue.plan.planner import make_plan

    pipeline = pipeline or _pipeline(given)
    if quiet or not sys.stderr.isatty():
        return make_plan(pipeline, installed(), not given.nothing_left_out)
    from etendue.present.terminal.progress import planning

    with planning() as told:
        return make_plan(pipeline, installed(), not given.nothing_left_out, told)


@command("plan")
@pipeline_options
@SCHEDULER
@WORKERS
def plan(given: Given, as_json: bool, scheduler: str, workers: int | None) -> None:
    """What would run: stages, cells, bytes, time, what is left out and why.

    What `run` would refuse because the machine is too small, with these workers and into the archive of that name here,
    is said behind it; the exit code is then 5, as that of `run`.
    """
    from etendue.plan.planner import summary, without_collecting
    from etendue.run.machine import check_machine
    from etendue.run.peak_memory import peak_memory, workers_of
    from etendue.run.schedulers import check_scheduler

    here = Path.cwd()  # a plugin may change it
    count = workers_of(check_scheduler(scheduler), workers or 0)
    with without_collecting():  # to the end: looking through a plan that is let go of takes as long as printing it
        made = _plan(given, as_json)
        document = summary(made, peak_memory(made, count).bytes)
        if as_json:
            say(document)
        else:
            from etendue.present.terminal.terminal import print_plan

            show(print_plan, document)
        check_machine(made, here / made.pipeline.name, count)


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
def run(given: Given, way: Way, archive: Path | str | None, measure: bool, hold: float | None, **how: Any) -> None:
    """Run a pipeline: compute what is not there yet, keep it, show it.

    On an archive that exists this resumes. A cell whose stage breaks off, kills its worker process or takes longer than
    --cell-timeout is recorded as failed, the rest goes on. Exit codes: 0 done, 2 the request is wrong, 3 some cells
    failed, 4 the archive is in use, 5 the machine is short or the cluster is gone, 130 or 143 interrupted (the archive
    is intact).
    """
    interrupts.say(interrupts.INTACT)
    here = Path.cwd()  # a plugin may change it
    if hold is not None and (given.tolerance is not None or given.nothing_left_out):
        raise click.UsageError("--hold finds the tolerance: leave out --tolerance and --nothing-left-out")
    from etendue.present.terminal.terminal import outcome_document, print_outcome
    from etendue.run.schedulers import far
    from etendue.session import check_timeout, execute

    options, watched = way.options(**how), progress(way.quiet)
    check_timeout(options)
    pipeline = _pipeline(given)
    place = from_here(here, archive or Path(pipeline.name))
    from etendue.archive import places

    with places.writing(place, far(way.scheduler)) as folder:
        held = _held(pipeline, hold, folder, options, watched) if hold is not None else None
        made = _plan(given, way.silent, replace(pipeline, tolerance=held.tolerance) if held else pipeline)
        _warn(made, way)
        measurement = _measurement(made, options, watched) if measure and not held else None
        outcome = execute(made, folder, options, watched(made) if watched else None)
        measured = _measured(measurement, folder, made) if measurement and not held else None
        if held:
            from etendue.accuracy import holding
            from etendue.accuracy.stating import stated_elsewhere
            from etendue.present.terminal.global_error import held_document

            holding.keep(held, folder)
            measured = held_document(held, stated_elsewhere(made, held.measured, held.places))
    outcome = places.placed(outcome, folder, place)
    if way.as_json:
        say({**outcome_document(outcome), **(measured or {})})
    else:
        show(print_outcome, outcome)
        if measured:
            from etendue.present.terminal.global_error import print_global_error

            show(print_global_error, measured)
    sys.exit(3 if outcome.failed else 0)


@command("rerun")
@click.argument("place", type=PLACE, metavar="ARCHIVE")
@_how
@MOST_CELLS
@JSON
@gather_way
def rerun(place: Path | str, way: Way, **how: Any) -> None:
    """Run an archive again into itself, from the archive alone: the pipeline of its last run, with the files in its
    inputs.

    What is there and right stays; what is missing, damaged, or would come out differently now is computed. Exit codes
    as those of `run`.
    """
    interrupts.say(interrupts.INTACT)
    place = from_here(Path.cwd(), place)  # a plugin may change it
    from etendue.archive import places
    from etendue.archive.again import recorded
    from etendue.present.terminal.terminal import outcome_document, print_outcome
    from etendue.run.schedulers import far
    from etendue.session import check_timeout, execute

    options, watched = way.options(**how), progress(way.quiet)
    check_timeout(options)
    with places.writing(place, far(way.scheduler)) as folder:
        made = _plan(Given(folder), way.silent, recorded(folder).pipeline(options.most_cells))
        _warn(made, way)
        outcome = execute(made, folder, options, watched(made) if watched else None)
    outcome = places.placed(outcome, folder, place)
    tell(way.as_json, outcome_document(outcome), lambda _: print_outcome(outcome))
    sys.exit(3 if outcome.failed else 0)


def _warn(made: Any, way: Way) -> None:
    if not way.as_json:
        from etendue.telling import printable

        for text in made.warnings:
            click.echo(f"note: {printable(text)}", err=True)


def _held(pipeline: Any, asked: float, folder: Path, options: Any, watched: Any) -> Any:
    """The tolerance that holds an error; said in front of the run."""
    from etendue.accuracy.holding import hold
    from etendue.present.terminal.global_error import say_held

    found = hold(pipeline, installed(), asked, options=options, progress=watched, archive=folder)
    for text in say_held(found):
        click.echo(text, err=True)
    return found


def _measurement(made: Any, options: Any, watched: Any) -> Any:
    """What is measured behind a run; what is wrong with it is said before anything runs."""
    from etendue.accuracy.measuring import Measurement

    pipeline = replace(made.pipeline, leave_out=made.leaves_out and made.pipeline.leave_out)
    return Measurement(pipeline, installed(), options=options, progress=watched)


def _measured(measurement: Any, folder: Path, made: Any) -> Document:
    """The global errors of a run, as in ``--json``."""
    from etendue.accuracy.stating import stated_elsewhere
    from etendue.present.terminal.global_error import global_error_document

    found = measurement.remembered(folder)
    stated = stated_elsewhere(made, found, measurement.places)
    return global_error_document(found, measurement.pipeline.tolerance, measurement.pipeline.norm, stated)


@command("show")
@click.argument("place", type=PLACE, metavar="DIR")
@JSON
def archive(place: Path | str, as_json: bool) -> None:
    """What is in an archive: stages, variables, cells; how far a running or broken sweep is."""
    from etendue.archive import places
    from etendue.archive.describe import describe_archive
    from etendue.present.terminal.stored import print_archive

    with places.reading(place, inputs=False) as folder:
        described = places.named(describe_archive(folder), folder, place)
    tell(as_json, described, print_archive)
