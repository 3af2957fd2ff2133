"""``--measure`` and ``--hold`` of ``run``: the global error, measured behind it or held in front of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from etendue.accuracy import holding
from etendue.accuracy.measuring import Measurement
from etendue.accuracy.pilot import stated_elsewhere
from etendue.cli.options import installed
from etendue.present.terminal.global_error import global_error_document, held_document, say_held

if TYPE_CHECKING:
    from etendue.types.documents import Document


def held(pipeline: Any, asked: float, folder: Path, options: Any, watched: Any) -> Any:
    """Find the tolerance that holds an error, and print it before the run."""
    found = holding.hold(pipeline, installed(), asked, options=options, progress=watched, archive=folder)
    for text in say_held(found):
        click.echo(text, err=True)
    return found


def kept(held: Any, folder: Path, made: Any) -> Document:
    """The errors that a run holds, kept in its archive; as in ``--json``."""
    holding.keep(held, folder)
    return held_document(held, stated_elsewhere(made, held.measured, held.places))


def measurement(made: Any, options: Any, watched: Any) -> Any:
    """Prepare the measurement that follows a run; invalid requests are refused before anything runs."""
    pipeline = replace(made.pipeline, leave_out=made.leaves_out and made.pipeline.leave_out)
    return Measurement(pipeline, installed(), options=options, progress=watched)


def measured(measurement: Any, folder: Path, made: Any) -> Document:
    """Return the global errors of a run, as in ``--json``."""
    found = measurement.remembered(folder)
    stated = stated_elsewhere(made, found, measurement.places)
    return global_error_document(found, measurement.pipeline.tolerance, measurement.pipeline.norm, stated)
