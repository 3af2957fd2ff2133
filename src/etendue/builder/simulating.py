"""``etendue.simulate``: run a pipeline in one call.

In:  a pipeline, and values that override its own.
Out: an ``xarray.DataTree``, with the errors of the wanted variables.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from etendue.accuracy.answers.evaluations import PLANNING
from etendue.accuracy.answers.recalled import answer_errors, recalled, usual_budget
from etendue.archive import places
from etendue.archive.records.choices import with_kept_choices
from etendue.calls import called
from etendue.contract.registry import installed_stages
from etendue.evaluation.asking import overrides_of, raise_failed
from etendue.evaluation.remembering import MEMORY, remembered
from etendue.pipeline.file import PipelineFile, PipelineSource
from etendue.plan import planner
from etendue.present.plots.stated import stated
from etendue.run.schedulers import check_scheduler
from etendue.session import Options, Outcome, execute, load
from etendue.types.documents import DocumentView


@called
def simulate(
    pipeline: str | Path | DocumentView | PipelineSource,
    *,
    archive: str | Path | None = None,
    want: str | Iterable[str] | None = None,
    scheduler: str = "threads",
    workers: int = 0,
    leave_out: bool = True,
    errors: bool | float = True,
    **parameters: Any,
) -> Any:
    """Run a pipeline and return its ``xarray.DataTree``.

    Parameters
    ----------
    pipeline : path, TOML text, mapping, or an ``etendue.Pipeline``
    archive : folder or s3://bucket/prefix/name that keeps the results and from which a run resumes; None: in memory
    want : variable or variables to compute, instead of the file's ``wanted``
    scheduler, workers : as for ``--scheduler`` (``etendue run --help``); number of threads or processes
    leave_out : whether stages may be left out if they have no effect on the results
    errors : whether to measure the errors of the wanted variables, in at most 10 % of the stages' time; a number is the
        maximum time in seconds, ``math.inf``: no limit. The errors are stored as the attributes ``error`` (in the
        variable's unit, or relative to full scale) and ``error_parts``
    **parameters : shared quantities by name, ``stage__parameter`` for parameters of stages, ``seed``, ...; a list makes
        a sweep axis

    Raises
    ------
    RequestError
        The file is invalid; the message lists every fault.
    EtendueError
        If cells failed; the message names the first failed cell.

    Examples
    --------
    >>> import etendue
    >>> tree = etendue.simulate("pipelines/smallest.toml", want="clipped_fraction", seed=2)
    >>> float(tree["exposure_report"]["clipped_fraction"].max()) < 1
    True
    """
    made = at_choices_of(load(pipeline, overrides_of(parameters, want)), archive)
    options = Options(check_scheduler(scheduler), workers)
    if archive is None and MEMORY.results.most and options == Options():
        outcome = remembered(MEMORY.plans.plan(made, leave_out), MEMORY.results, options)
    else:
        plan = planner.make_plan(made, installed_stages(), leave_out)
        outcome = execute(plan, archive, options)
        raise_failed(plan, outcome.failed)
    with_errors(outcome, errors)
    return opened(outcome, archive)


def at_choices_of(pipeline: PipelineFile, archive: str | Path | None) -> PipelineFile:
    """Return the pipeline with its open parameters at the values that an earlier run into this local archive has
    chosen.
    """
    folder = None if archive is None or places.is_url(archive) else Path(archive)
    return with_kept_choices(pipeline, installed_stages(), folder)[0]


def with_errors(outcome: Outcome, errors: bool | float = True) -> None:
    """Measure the errors of a run's wanted variables and add them to the outcome. ``errors``: the maximum time in
    seconds; True for 10 % of the time of its stages; False for no measurement.
    """
    budget = usual_budget(outcome) if isinstance(errors, bool) else errors
    folder = outcome.archive if isinstance(outcome.archive, Path) else None
    if not errors or outcome.failed or (budget < 5 * PLANNING and recalled(outcome.plan, folder) is None):
        return
    found = answer_errors(outcome, installed_stages(), budget, folder)
    outcome.answers = found.document()


def opened(outcome: Outcome, archive: str | Path | None) -> Any:
    """Return the tree of a run, from memory or loaded lazily from its archive, and register the accessor
    ``tree.etendue``.
    """
    from etendue.present.plots import accessor  # noqa: F401  # tree.etendue.plot

    if archive is None:
        return stated(outcome.tree, outcome.answers)
    return stated(places.open_archive(archive), outcome.answers)
