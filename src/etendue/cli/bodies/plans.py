"""``plan``, and planning a pipeline as given on the command line."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from etendue.accuracy.answers.cached import cached
from etendue.archive.records.choices import with_kept_choices
from etendue.cli.options import Given, installed
from etendue.cli.saying import say, show
from etendue.pipeline.file import overridden
from etendue.plan.planner import make_plan, summary
from etendue.process import NOT_COLLECTING
from etendue.run.machine import check_machine
from etendue.run.peak_memory import peak_memory, workers_of
from etendue.run.schedulers import check_scheduler

if TYPE_CHECKING:
    from etendue.pipeline.file import PipelineFile
    from etendue.plan.model import Plan


def pipeline_of(given: Given) -> PipelineFile:
    """Return the requested pipeline: the file with the options of the command line applied."""
    pipeline = given.pipeline()
    # variables requested on the command line are kept in addition to those of the file
    if given.want and pipeline.keep is not None and pipeline.wanted is not None:
        pipeline = overridden(pipeline, {"keep": [*pipeline.keep, *pipeline.wanted]})  # recorded, so reproducible
    if not given.nothing_left_out:
        return pipeline
    from etendue.accuracy.reference import reference_overrides

    return overridden(pipeline, reference_overrides(pipeline, installed()))


def planned(given: Given, quiet: bool, pipeline: PipelineFile | None = None) -> Plan:
    """Return the plan of the pipeline; on a terminal, show progress if planning takes long."""
    pipeline = pipeline or pipeline_of(given)
    if quiet or not sys.stderr.isatty():
        return make_plan(pipeline, installed(), not given.nothing_left_out)
    from etendue.present.terminal.progress import planning

    with planning() as told:
        return make_plan(pipeline, installed(), not given.nothing_left_out, told)


def plan(given: Given, as_json: bool, scheduler: str, workers: int | None) -> None:
    here = Path.cwd()  # a plugin may change it
    count = workers_of(check_scheduler(scheduler), workers or 0)
    with NOT_COLLECTING:  # until the end: collecting the garbage of a discarded plan takes as long as printing it
        pipeline = pipeline_of(given)
        pipeline, notes = with_kept_choices(pipeline, installed(), here / pipeline.name)
        made = planned(given, as_json, pipeline)
        made = replace(made, warnings=(*notes, *made.warnings))
        document = summary(made, peak_memory(made, count).bytes) | {"answer": cached(made)}
        if as_json:
            say(document)
        else:
            from etendue.present.terminal.answers import print_plan_with_errors

            show(print_plan_with_errors, document)
        check_machine(made, here / made.pipeline.name, count)
