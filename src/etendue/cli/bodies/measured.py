"""``--measure`` and ``--hold`` of ``run``: the global error, measured after the run or limited before it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from etendue.accuracy import holding
from etendue.accuracy.measuring import Measurement
from etendue.accuracy.pilot import stated_elsewhere
from etendue.cli.options import installed
from etendue.plan.wiring.automatic import with_chosen
from etendue.present.terminal.answer_texts import plus_minus
from etendue.present.terminal.global_error import global_error_document, not_held
from etendue.telling import human_bytes, human_seconds

if TYPE_CHECKING:
    from etendue.pipeline.file import PipelineFile
    from etendue.plan.model import Plan
    from etendue.session import Options
    from etendue.types.documents import Document, DocumentView


def held(
    pipeline: PipelineFile, asked: tuple[tuple[str, float], ...], folder: Path, options: Options, watched: Any
) -> holding.HeldTolerance:
    """Find the local tolerance at which the errors stay within their limits ``asked``, and print it before the run."""
    own = dict(asked)
    goals = holding.Asked(own.pop("", None), own)
    found = holding.hold(pipeline, installed(), goals, options=options, progress=watched, archive=folder)
    for text in _choices(found.chosen) if found.chosen else ():
        click.echo(text, err=True)
    when = f"measured in {human_seconds(found.seconds)} of CPU time"
    told = f"hold {found.asked}: local tolerance {found.tolerance:g}, "
    told += "found by an earlier run" if found.remembered else when
    said = [told]
    if found.needed:
        need = f"{human_seconds(found.needed.seconds)} more and {human_bytes(found.needed.bytes)} of memory"
        said.append(f"not searched further: the next run would take about {need}; allow more with --hold-seconds")
    for text in (*said, *not_held(found.document(), found.measured.errors)):
        click.echo(text, err=True)
    return found


def _choices(chosen: Any) -> list[str]:
    """Return lines with the values chosen for the pipeline's open parameters, and why none is finer."""
    every = {f"{stage}.{name}": value for stage, own in chosen.values.items() for name, value in own.items()}
    told = ", ".join(
        f"{name} = {value:.4g}{' (refined)' if name in chosen.refined else ''}" for name, value in every.items()
    )
    said = [f"chosen{' by an earlier run' if chosen.kept else ''}: {told}"]
    for name, why in chosen.missed.items():
        said.append(f"{'too coarse here' if chosen.kept else 'not fine enough'} for {name}: {why}")
    if chosen.needed:
        said.append(f"not refined further: {chosen.needed}")
    if chosen.missed and chosen.kept:
        said.append("the archive keeps the values of its first run; to choose new values, run into another archive")
    return said


def with_values(pipeline: PipelineFile, held: holding.HeldTolerance) -> PipelineFile:
    """Return the pipeline with the tolerance that ``--hold`` found, and the values of its open parameters."""
    chosen = with_chosen(pipeline, held.chosen.values) if held.chosen else pipeline
    # The record of the run holds the tolerance as if it had been given, so that the record can be checked.
    overrides = tuple({**dict(chosen.overrides), "tolerance": held.tolerance}.items())
    return replace(chosen, tolerance=held.tolerance, overrides=overrides)


def kept(held: holding.HeldTolerance, folder: Path, made: Plan) -> Document:
    """Store in the archive the errors that the run keeps within limits, and return them in the form of ``--json``."""
    holding.keep(held, folder, made)
    stated = stated_elsewhere(made, held.measured, held.places)
    document = global_error_document(held.measured, held.asked.relative or held.tolerance, held.norm, stated)
    for name in held.asked.own:
        document["global_error"][name]["held"] = name not in held.missed
    document["measured"] |= {"seconds": held.seconds, "remembered": held.remembered}
    return {**document, "hold": held.document()}


def measurement(made: Plan, options: Options, watched: Any) -> Measurement:
    """Prepare the measurement that follows a run; invalid requests are refused before anything runs."""
    pipeline = replace(made.pipeline, leave_out=made.leaves_out and made.pipeline.leave_out)
    return Measurement(pipeline, installed(), options=options, progress=watched)


def measured(measurement: Measurement, folder: Path, made: Plan) -> Document:
    """Return the global errors of a run in the form of ``--json``."""
    found = measurement.remembered(folder)
    stated = stated_elsewhere(made, found, measurement.places)
    return global_error_document(found, measurement.pipeline.tolerance, measurement.pipeline.norm, stated)


def beyond(held: holding.HeldTolerance, answers: DocumentView) -> list[str]:
    """Return a sentence for each variable whose error exceeds the requested limit: ``--hold`` refines only the
    discretisations that the pipeline leaves open.
    """
    said = []
    whole = replace(held.asked, spent={})
    for name, limit in whole.limits(held.measured).items():
        error = answers["errors"].get(name)
        if error is None or not error["parts"]:
            continue
        unit = error["unit"]
        most = limit * (held.measured.errors[name].scale or 1.0) if unit else limit
        size = "rms" if held.norm == "rms" else "max"
        parts = {part: own[size] for part, own in error["parts"].items() if held.chosen or part != "omissions"}
        if parts and sum(parts.values()) > most:
            worst = max(parts, key=lambda part: parts[part])
            remedy = ""
            if worst != "omissions":
                finer = answers["remedies"].get(worst, "")
                remedy = f"; refine this parameter in the pipeline{f': {finer}' if finer else ''}"
            missed = (
                "not held"
                if name in held.missed
                else "the error relative to the reference is within the limit, but the error of the answer is not"
            )
            said.append(f"{missed}: {name} is off by {plus_minus(error, unit)}, mostly by its {worst}{remedy}")
    return said
