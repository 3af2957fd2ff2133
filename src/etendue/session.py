"""Join plan, run and archive: the part that ``etendue run`` and ``etendue.simulate`` share.

In:  a plan and the place for its results.
Out: an ``Outcome``: the tree, the computed, reused and failed cells, and the rows of the table at the end.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any

from etendue import interrupts
from etendue.archive import places
from etendue.archive.records.provenance import platform_record
from etendue.compute.jobs import make_jobs
from etendue.contract.ports import CellReport, Keeper, Progress, WrittenChunk
from etendue.errors import ArchiveError, RequestError
from etendue.pipeline.file import (
    PipelineFile,
    PipelineSource,
    from_document,
    overridden,
    parse_pipeline,
    read_pipeline,
    refuse_large,
)
from etendue.pipeline.overrides import apply_overrides
from etendue.plan import cost
from etendue.plan.ancestry import ancestry
from etendue.plan.model import CellRef, Plan
from etendue.plan.reports import DONE, FAILED, LEFT_OUT, Reports
from etendue.plan.shown import shown_cells, where_shown
from etendue.run.batches import Batch, BatchResult, partition
from etendue.run.machine import check_machine
from etendue.run.memory import SELDOM_COLLECTING, TREES_OUT, return_freed_memory
from etendue.run.peak_memory import workers_of
from etendue.run.schedulers import How, far
from etendue.run.schedulers import scheduler as scheduler_of
from etendue.run.watch import Stop, run_batches
from etendue.types.documents import Document, DocumentView

LEAST_REMEMBERED = 0.05  # seconds of a run whose rates are remembered; of a shorter one they are mostly overhead

if TYPE_CHECKING:
    from etendue.running import Running
    from etendue.types.arrays import Array


@dataclass
class Options:
    """Options for the execution of a run; no option changes a bit of the result."""

    scheduler: str = "threads"
    workers: int = 0  # 0: one per core
    durable: bool = False
    recompute: bool = False
    accept_platform: bool = False
    prune: bool = False  # whether finished results that the plan does not keep may be removed
    batch_seconds: float = 0.1
    pictures: bool = True  # without an archive: whether to draw a cell of every stage
    hold_seconds: float = 900.0  # of CPU time that the search of ``--hold`` may take
    cell_timeout: float | None = (
        None  # seconds after which a cell is stopped and counts as failed; processes and clusters only
    )
    # For a pipeline recorded in an archive: the reader's own limit on cells; a larger plan is refused.
    most_cells: int | None = None
    restore: frozenset[str] | None = (
        None  # for a repair: names of cells of earlier runs that the archive must also have
    )

    def how(self, stop: Stop, mark: tuple[str, bytes] | None = None) -> How:
        """Return the options for running batches on the scheduler; ``mark``: a file that all workers must see."""
        workers = workers_of(self.scheduler, self.workers)
        return How(self.scheduler, workers, stop, self.cell_timeout, platform_record, mark)


@dataclass
class Outcome:
    """The results of a run, and its counts of cells."""

    plan: Plan
    reports: Reports
    reused: set[CellRef]
    seconds: float
    reasons: dict[str, str] = field(default_factory=dict)
    archive: Path | str | None = None
    tree: Any = None
    pictures: list[Path] = field(default_factory=list)
    arrays: Mapping[CellRef, dict[str, Array]] = field(default_factory=dict)
    shown_at: str = ""  # axis values of the cells in pictures and headline metrics
    removed: int = 0  # cells of earlier runs at other axis values whose results are outdated
    pruned: int = 0  # finished cells removed on request
    stay: list[str] = field(
        default_factory=list
    )  # stages stored earlier and still valid, although 'keep' no longer names them
    mended: list[str] = field(default_factory=list)  # files that were missing or damaged and are written again
    moved: dict[str, int] = field(default_factory=dict)  # shards rewritten, bytes copied for them, bytes computed
    restored: int = 0  # cells of earlier runs that were computed again because they were damaged
    answers: Document | None = None  # the errors of the wanted variables (accuracy.answer), if they were measured
    read: Callable[[CellRef, frozenset[str]], Mapping[str, Array]] | None = None  # variables of a cell in the archive

    def __getstate__(self) -> dict[str, object]:
        """Leave out ``read``, because another process has not opened the archive; kept results are computed again
        there.
        """
        return {**self.__dict__, "read": None}

    def kept(self, ref: CellRef, names: Collection[str]) -> Mapping[str, Array]:
        """Return the arrays, read-only, of those requested variables of a finished cell that the run has kept."""
        report = self.reports.get(ref)
        if report is None or report.status not in ("done", "left_out", "reused"):
            return {}
        try:
            found = self.read(ref, frozenset(names)) if self.read else self.arrays.get(ref, {})
        except (ArchiveError, OSError):  # damaged since: it can be computed again
            return {}
        own = {name: found[name].view() for name in names if name in found}
        for array in own.values():
            array.setflags(write=False)
        return own

    def error_of(self, stage: str, variable: str) -> DocumentView | None:
        """Return the error of a wanted variable at the shown point; None if it was not measured."""
        own = (self.answers or {}).get("shown", {}).values()
        return next((one for one in own if (one["stage"], one["variable"]) == (stage, variable)), None)

    @property
    def failed(self) -> list[CellReport]:
        return self.reports.having(FAILED)

    @property
    def computed(self) -> int:
        return self.reports.count(DONE, LEFT_OUT)

    def __repr__(self) -> str:
        said: str = _outcomes().outcome_text(self)
        return said

    def _repr_html_(self) -> str:
        said: str = _outcomes().outcome_page(self)
        return said


def _outcomes() -> ModuleType:
    from etendue.present.plots.summary import outcomes

    return outcomes


@dataclass
class Collected:
    """Arrays of the requested cells, and the reports of all computed cells."""

    arrays: dict[CellRef, dict[str, Array]] = field(default_factory=dict)
    reports: dict[CellRef, CellReport] = field(default_factory=dict)


@dataclass(frozen=True)
class HeldArrays:
    """The arrays of a cell that was computed earlier, as a read-only ``Target``."""

    arrays: Mapping[str, Array]

    def write(self, arrays: Mapping[str, Any]) -> tuple[WrittenChunk, ...]:
        return ()  # never called: the cell is not computed again

    def read(self, variable: str) -> Array:
        return self.arrays[variable]

    def read_band(self, variable: str, band: int) -> Array:
        found: Array = self.arrays[variable][band]
        return found

    def settle(self) -> None: ...


class _Silent:
    """Progress that is not shown."""

    def begin(self, cells: int) -> None: ...

    def starting(self, stages: tuple[str, ...]) -> None: ...

    def finished(self, reports: tuple[CellReport, ...]) -> None: ...

    def end(self) -> None: ...


def load(source: str | Path | DocumentView | PipelineSource, overrides: DocumentView | None = None) -> PipelineFile:
    """Return a pipeline from a file, TOML text or mapping, or from a pipeline that was read or written in Python."""
    if isinstance(source, PipelineSource):
        return overridden(source.written(), overrides) if overrides else source.written()
    if isinstance(source, Mapping):
        refuse_large(source)  # before copying it: a copy descends into every level
        document = copy.deepcopy(dict(source))  # the caller's mapping must not change
        apply_overrides(document, overrides or {})
        return from_document(document)
    if isinstance(source, str) and "\n" in source:
        return parse_pipeline(source, overrides=overrides)
    return read_pipeline(Path(source), overrides)


def execute(
    plan: Plan,
    archive: str | Path | None = None,
    options: Options | None = None,
    progress: Progress | None = None,
    into: Keeper | None = None,
) -> Outcome:
    """Compute the cells of a plan that are not finished. ``into``: a store for the results instead of an archive.

    An archive may be the URL of an object store: the run works in a local folder, and uploads changed files.

    Raises
    ------
    ArchiveError, ArchiveInUse, MachineError
        Before anything is computed.
    StoreLost
        At any time; finished results are kept.
    """
    options, progress = options or Options(), progress or _Silent()
    check_timeout(options)
    if archive is not None and places.is_url(archive):
        with places.writing(archive, far(options.scheduler)) as folder:
            outcome = execute(plan, folder, options, progress)
        placed: Outcome = places.placed(outcome, folder, archive)
        return placed
    from etendue.running import Running  # slow imports, made while a signal may still end the process

    keeping = into or _keeper(archive, options)
    TREES_OUT.collect()
    with interrupts.held(), SELDOM_COLLECTING:  # signals are handled only at safe points
        drawn = archive is not None or options.pictures
        check_machine(
            plan, Path(archive) if archive is not None else None, workers_of(options.scheduler, options.workers), drawn
        )
        return _execute(plan, keeping, options, progress, Running)


def _execute(plan: Plan, keeping: Keeper, options: Options, progress: Progress, running: type[Running]) -> Outcome:
    began, at = time.perf_counter(), where_shown(plan)
    with keeping as keeper:
        work = keeper.begin(plan)
        shown = dict(work.shown) or {name: work.cells[ref] for name, ref in shown_cells(plan).items()}
        run = running(work, shown, keeper, progress)
        run.compute(options, partition)
        sheet, reports, standing = run.sheet(at), run.reports, run.standing()
        if work.plan is not plan:
            standing = {ref: standing[own] for ref, own in work.cells.items() if own in standing}
        tree, files = keeper.close(run.tables(), sheet, reports.count(FAILED) > 0)

    def read(ref: CellRef, names: frozenset[str]) -> Mapping[str, Array]:
        return keeper.stored([work.cells[ref]], named=names)[work.cells[ref]]

    if work.todo:
        _remember(plan, reports.of(plan, work.cells), archive=keeper.folder is not None)
    reports.reuse(ref for ref in run.earlier if ref in reports)
    if tree is not None:
        TREES_OUT.hand_out(tree, tree.nbytes)
    return Outcome(  # in terms of the request; the store may hold further values of earlier runs
        plan,
        reports.of(plan, work.cells),
        {ref for ref, own in work.cells.items() if own in work.reused},
        time.perf_counter() - began,
        work.reasons,
        keeper.folder,
        tree,
        files,
        standing,
        at,
        work.removed,
        work.pruned,
        work.stay,
        work.mended,
        work.moved,
        run.restored() if options.restore else 0,
        read=None if keeper.keeps_arrays else read,
    )


def _remember(plan: Plan, reports: Reports, archive: bool) -> None:
    """Save the run times of the stages, from which later plans on this machine estimate times."""
    written = (0, 0.0)
    if archive:
        from etendue.archive.sharding.chunks import SPENT

        written = SPENT.taken()
    if not plan.expected and reports.seconds_of() > LEAST_REMEMBERED:
        cost.remember(plan, reports, written)


def collect(
    plan: Plan,
    wanted: Mapping[CellRef, Iterable[str]],
    options: Options | None = None,
    progress: Progress | None = None,
    known: Mapping[CellRef, Mapping[str, Array]] = MappingProxyType({}),
) -> Collected:
    """Compute some variables of some cells of a plan, with all cells that they need, in memory; store nothing.

    ``known``: arrays of cells that need not be computed again.

    Raises
    ------
    MachineError
        Before anything is computed.
    """
    options, progress = options or Options(), progress or _Silent()
    chosen = {ref: frozenset(names) for ref, names in wanted.items()}
    check_timeout(options)
    found = Collected()

    def before(batch: Batch) -> None:
        progress.starting(batch.stages)

    def after(batch: Batch, result: BatchResult) -> None:
        found.reports.update({(r.stage, r.index): r for r in result.reports})
        found.arrays.update(
            {ref: {v: a for v, a in own.items() if v in chosen[ref]} for ref, own in result.kept.items()}
        )
        progress.finished(result.reports)
        result.kept, result.reports = {}, ()

    with interrupts.held(), SELDOM_COLLECTING:
        alone = replace(plan, kept=frozenset())
        held = {ref: HeldArrays(own) for ref, own in known.items()}
        todo = ancestry(alone, chosen, known.keys()) - known.keys()
        jobs = make_jobs(alone, todo, lambda cell: held.get(cell.ref), show=frozenset(chosen))
        progress.begin(len(jobs))
        try:
            interrupts.check()
            batches = partition(jobs, options.batch_seconds)
            return_freed_memory()
            run_batches(batches, frozenset(chosen), before, after, options.how(Stop()))
        finally:
            progress.end()
    return found


def _keeper(archive: str | Path | None, options: Options) -> Keeper:
    if archive is None:
        from etendue.archive.write.memory import MemoryKeeper

        return MemoryKeeper(options.pictures)
    from etendue.archive.write.keeper import ArchiveKeeper

    return ArchiveKeeper(Path(archive), options)


def check_timeout(options: Options) -> None:
    """Refuse a time limit with a scheduler that cannot stop a cell, which requires a separate process."""
    if options.cell_timeout is not None and scheduler_of(options.scheduler).here:
        what = f"--scheduler {options.scheduler} cannot stop a cell"
        raise RequestError(f"--cell-timeout {options.cell_timeout:g}: {what}; use --scheduler processes")
