"""``run`` and ``rerun``."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from etendue.accuracy.answers.error import AnswerErrors
from etendue.accuracy.answers.recalled import AT_LEAST, answer_errors, usual_budget
from etendue.archive import places
from etendue.archive.records.choices import with_kept_choices
from etendue.archive.records.remembered import ANSWER, forget
from etendue.archive.records.rerun import recorded
from etendue.cli.bodies.plans import pipeline_of, planned
from etendue.cli.options import Given, Way, from_here, installed, progress
from etendue.cli.saying import say, show
from etendue.present.terminal.outcome import outcome_document, print_outcome
from etendue.run.memory import return_freed_memory
from etendue.run.schedulers import far
from etendue.session import Options, Outcome, check_timeout, execute
from etendue.telling import printable
from etendue.types.documents import Document


def run(
    given: Given,
    way: Way,
    archive: Path | str | None,
    measure: bool,
    hold: tuple[tuple[str, float], ...],
    errors: bool,
    **how: Any,
) -> None:
    here = Path.cwd()  # a plugin may change it
    if hold and (given.tolerance is not None or given.nothing_left_out):
        raise click.UsageError("--hold finds the tolerance: omit --tolerance and --nothing-left-out")
    options, watched = way.options(**how), progress(way.quiet)
    check_timeout(options)
    pipeline = pipeline_of(given)
    place = from_here(here, archive or Path(pipeline.name))
    if measure or hold:
        from etendue.cli.bodies import measured as global_errors
    with places.writing(place, far(way.scheduler)) as folder:
        held = global_errors.held(pipeline, hold, folder, options, watched) if hold else None
        chosen, notes = with_kept_choices(pipeline, installed(), folder)
        made = planned(given, way.silent, global_errors.with_values(pipeline, held) if held else chosen)
        _warn(made, way, [] if held else notes)
        measurement = global_errors.measurement(made, options, watched) if measure and not held else None
        outcome = execute(made, folder, options, watched(made) if watched else None)
        measured = global_errors.measured(measurement, folder, made) if measurement and not held else None
        if held:
            measured = global_errors.kept(held, folder, made)
        return_freed_memory()  # errors are measured in float64
        outcome.answers = _answers(outcome, folder, watched, held_seconds(held, options, measure), errors, held)
        if held and measured and outcome.answers:
            measured["hold"]["beyond"] = global_errors.beyond(held, outcome.answers)
    _tell_run(places.placed(outcome, folder, place), measured, way)
    sys.exit(3 if outcome.failed else 0)


def _tell_run(outcome: Outcome, measured: Document | None, way: Way) -> None:
    """Print the outcome of a run and the errors that were measured, as JSON or as text."""
    if way.as_json:
        answers = {"answer": outcome.answers} if outcome.answers else {}
        say({**outcome_document(outcome), **answers, **(measured or {})})
        return
    show(print_outcome, outcome)
    if measured:
        from etendue.present.terminal.global_error import print_global_error

        show(print_global_error, measured)


def held_seconds(held: Any, options: Options, measure: bool) -> float:
    """Return the time (s) that the measurement of errors may take however short the run was: no limit with ``measure``,
    else what the search for open values has left of its budget, but at least ``AT_LEAST``.
    """
    if measure or not (held and held.chosen):
        return math.inf if measure else AT_LEAST
    left: float = options.hold_seconds - held.seconds - held.chosen.seconds
    return max(AT_LEAST, left)


def _answers(
    outcome: Outcome, folder: Path, watched: Any, most: float, errors: bool = True, held: Any = None
) -> Document | None:
    """Return the errors of the wanted variables; None if they are not requested or if cells failed. In that case the
    errors of an earlier run are removed from the archive, because they describe other values. ``most``: time (s) that
    the measurement may take even if this exceeds the usual share of the run.
    """
    if outcome.failed or not errors:
        forget(folder, ANSWER)
        return None
    budget = max(most, usual_budget(outcome))
    try:
        parts = held.chosen.parts if held and held.chosen else {}
        return answer_errors(outcome, installed(), budget, folder, watched, parts).document()
    except KeyboardInterrupt:  # the run is complete; only the measurement of its error failed
        return AnswerErrors({}, {}, {}, why="interrupted").document()


def rerun(place: Path | str, way: Way, **how: Any) -> None:
    place = from_here(Path.cwd(), place)  # a plugin may change it
    options, watched = way.options(**how), progress(way.quiet)
    check_timeout(options)
    with places.writing(place, far(way.scheduler)) as folder:
        made = planned(Given(folder), way.silent, recorded(folder).pipeline(options.most_cells))
        _warn(made, way)
        outcome = execute(made, folder, options, watched(made) if watched else None)
        outcome.answers = _answers(outcome, folder, watched, AT_LEAST)
    _tell_run(places.placed(outcome, folder, place), None, way)
    sys.exit(3 if outcome.failed else 0)


def _warn(made: Any, way: Way, notes: Sequence[str] = ()) -> None:
    if not way.as_json:
        for text in (*notes, *made.warnings):
            click.echo(f"note: {printable(text)}", err=True)
