"""Join plan, run and archive: what ``etendue run`` and ``etendue.simulate`` both do.

In:  a plan and where to put it.
Out: an ``Outcome``: the tree, what was computed, reused and failed, and the rows of the table at the end.
"""

from __future__ import annotations

import copy
import os
import threading
import time
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from etendue import interrupts
from etendue.errors import ArchiveError, RequestError, nearest
from etendue.plan import planner
from etendue.plan.machine import check_machine
from etendue.plan.model import CellRef, Plan
from etendue.plan.resume import select
from etendue.plan.shown import shown_cells, where_shown
from etendue.registry import installed_stages
from etendue.run.batches import Batch, BatchResult, partition
from etendue.run.jobs import make_jobs
from etendue.run.memory import keep_freed_memory
from etendue.run.serial import run_serial
from etendue.run.watch import Stop, watched
from etendue.spec.pipeline import Pipeline, from_document, parse_pipeline, read_pipeline
from etendue.spec.ports import CellReport, Progress


@dataclass
class Options:
    """How a run is done; nothing here changes a bit of the result."""

    scheduler: str = "threads"
    workers: int = 0  # 0: one per core
    durable: bool = False
    recompute: bool = False
    accept_platform: bool = False
    prune: bool = False  # whether finished results that the plan does not keep may be removed
    batch_seconds: float = 0.1
    pictures: bool = True  # without an archive: whether a cell of every stage is drawn
    cell_timeout: float | None = None  # seconds after which a cell is stopped and has failed; processes and clusters only


@dataclass
class Outcome:
    """What a run did."""

    plan: Plan
    reports: dict[CellRef, CellReport]
    reused: set[CellRef]
    seconds: float
    reasons: dict[str, str] = field(default_factory=dict)
    archive: Path | None = None
    tree: Any = None
    pictures: list[Path] = field(default_factory=list)
    arrays: dict[CellRef, dict[str, Any]] = field(default_factory=dict)
    shown_at: str = ""  # axis values of the cells in the pictures and headlines
    removed: int = 0  # cells of earlier runs, at other axis values, that would come out differently now
    pruned: int = 0  # finished cells removed because it was asked for
    stay: list[str] = field(default_factory=list)  # stages stored earlier and right, though 'keep' no longer names them
    mended: list[str] = field(default_factory=list)  # files of the archive that were missing or damaged, and are written again

    @property
    def failed(self) -> list[CellReport]:
        return [r for r in self.reports.values() if r.status == "failed"]

    @property
    def computed(self) -> int:
        return sum(r.status in ("done", "left_out") for r in self.reports.values())


class _Silent:
    """Progress nobody watches."""

    def begin(self, cells: int) -> None: ...

    def starting(self, stages: tuple[str, ...]) -> None: ...

    def finished(self, reports: tuple[CellReport, ...]) -> None: ...

    def end(self) -> None: ...


def load(source: str | Path | Mapping[str, Any] | Pipeline, overrides: Mapping[str, Any] | None = None) -> Pipeline:
    """A pipeline from a file, TOML text or mapping."""
    if isinstance(source, Pipeline):
        return source
    if isinstance(source, Mapping):
        return from_document(source)
    if isinstance(source, str) and "\n" in source:
        return parse_pipeline(source, overrides=overrides)
    return read_pipeline(Path(source), overrides)


def execute(
    plan: Plan,
    archive: str | Path | None = None,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Compute what a plan asks for and is not there yet.

    Raises
    ------
    ArchiveError, ArchiveInUse, MachineError
        Before anything is computed.
    """
    options, progress = options or Options(), progress or _Silent()
    check_timeout(options)
    from etendue.report import pictures, tables  # noqa: F401  # seconds of imports, while a signal may still end everything

    if archive is not None:
        from etendue.archive import store  # noqa: F401
    with interrupts.held():  # signals are answered where nothing is torn
        return _execute(plan, archive, options, progress)


def _execute(plan: Plan, archive: str | Path | None, options: Options, progress: Progress) -> Outcome:
    check_machine(plan, Path(archive) if archive is not None else None)
    if archive is None:
        return _in_memory(plan, options, progress)
    from etendue.archive import inputs, keeping, provenance
    from etendue.archive.store import Archive

    began = time.perf_counter()
    asked = plan
    with Archive(Path(archive), options.durable) as store:
        plan, stay, pruned = keeping.with_stored(asked, store, options.prune)
        requested = keeping.same_cells(asked, plan)
        store.use(plan)
        old, entries = store.record, store.journal.entries
        _check_platform(store, old, options, provenance.platform_record())
        finished = set() if options.recompute else {ref for ref in plan.cells if store.finished(ref)}
        todo = select(plan, finished, set(requested.values()))
        outdated = set(plan.cells) - finished - todo - set(requested.values())
        removed = sum(store.has_files(ref) for ref in outdated)
        known = any(entry.event == "done" for entry in entries.values())
        reasons = provenance.reasons(old, plan) if known else {}
        again = {ref[0] for ref in todo}
        reasons = {name: why for name, why in reasons.items() if name in again}
        for name, count in store.damaged.items():
            reasons.setdefault(name, f"{count} stored {'cell is' if count == 1 else 'cells are'} missing or damaged on disk")
        store.begin(todo, finished, outdated)
        store.journal.begin_run(_by_stage(requested.values()), _by_stage(todo))
        resolved = inputs.resolve_pipeline(asked)
        store.mended += inputs.copy_inputs(store.folder, resolved.inputs, options.durable)
        if todo or not store.recorded:
            told = {"tolerance": plan.pipeline.tolerance, "scheduler": options.scheduler}
            provenance.write_record(store.folder, plan, asked, resolved, told, options.durable)
        shown = {name: requested[ref] for name, ref in shown_cells(asked).items()}
        show = frozenset(ref for ref in shown.values() if ref in todo)
        jobs = make_jobs(plan, todo, store.target, show=show)
        reports: dict[CellRef, CellReport] = {}
        arrays: dict[CellRef, dict[str, Any]] = {}
        lock = threading.Lock()

        def before(batch: Batch) -> None:
            with lock:
                store.starting(job.ref for job in batch.jobs if job.task == "compute")
            progress.starting(tuple(dict.fromkeys(job.ref[0] for job in batch.jobs)))

        def after(batch: Batch, result: BatchResult) -> None:
            fresh = [r for r in result.reports if r.status != "loaded"]
            with lock:
                store.reported(fresh)
            reports.update({(r.stage, r.index): r for r in fresh})
            arrays.update(result.kept)  # type: ignore[arg-type]
            progress.finished(tuple(fresh))

        outcome = Outcome(
            plan, reports, finished - todo, 0.0, reasons, store.folder, arrays=arrays, removed=removed, pruned=pruned, stay=stay,
            mended=store.mended,
        )  # fmt: skip
        from etendue.report import pictures, tables

        progress.begin(len(todo))
        stop = Stop()
        try:
            interrupts.check()
            _run(partition(jobs, options.batch_seconds), show, before, after, options, stop)
        except KeyboardInterrupt:  # what is finished can be looked at, and the next run goes on from it
            _merge_journal(outcome, store)
            stored = _as_stored(outcome, store)
            store.close_run({"ledger": tables.ledger(plan, stored), "summary": tables.summary(plan, stored)})
            store.write_manifest()
            store.sweep(stop.abandoned)
            raise
        finally:
            progress.end()
        if outcome.failed:  # a worker that was stopped may have left a file half written
            store.sweep()
        _merge_journal(outcome, store)
        stored = _as_stored(outcome, store)
        kept_tables = {"ledger": tables.ledger(plan, stored), "summary": tables.summary(plan, stored)}
        sheet = store.folder / "contact_sheet.png"
        keys = [plan.cells[ref].key for ref in shown.values()]
        if arrays or store.shown() != keys or not store.sheet_is_whole():
            frames = pictures.render(plan, shown, {**_stored(plan, store, todo, shown), **arrays})
            if frames:
                kept_tables["frames"] = pictures.frames_table(frames)
                kept_tables["frames"]["attrs"] = {**kept_tables["frames"].get("attrs", {}), "shown": keys, "at": where_shown(asked)}
                drawn = sheet.with_name(".contact_sheet.partial.png")  # beside its place: a link there is not followed
                drawn.unlink(missing_ok=True)
                pictures.contact_sheet(frames, drawn, f"{plan.pipeline.name}{where_shown(asked)}")
                os.replace(drawn, sheet)
        if sheet.exists():
            outcome.pictures = [sheet]
        arrays.update(_stored(plan, store, todo, shown, figures_only=True))
        store.close_run(kept_tables)
        provenance.write_crate(store.folder, plan, options.durable)
        store.write_manifest()
    return _as_asked(outcome, asked, requested, time.perf_counter() - began)


def _as_asked(outcome: Outcome, asked: Plan, requested: Mapping[CellRef, CellRef], seconds: float) -> Outcome:
    """The outcome in terms of what was asked for; values of earlier runs beside it are the archive's affair."""
    outcome.plan, outcome.seconds, outcome.shown_at = asked, seconds, where_shown(asked)
    outcome.reports = {ref: replace(outcome.reports[own], index=ref[1]) for ref, own in requested.items() if own in outcome.reports}
    outcome.reused = {ref for ref, own in requested.items() if own in outcome.reused}
    outcome.arrays = {ref: outcome.arrays[own] for ref, own in requested.items() if own in outcome.arrays}
    return outcome


def _stored(
    plan: Plan, store: Any, todo: set[CellRef], shown: Mapping[str, CellRef], figures_only: bool = False
) -> dict[CellRef, dict[str, Any]]:
    """Arrays of the shown cells that were not computed now but are stored; all of them, or plain figures only."""
    found = {}
    for name, ref in shown.items():
        if ref not in todo:
            target = store.target(plan.cells[ref])
            writes = plan.node(name).writes
            chosen = [v for v in writes if (name, v) in plan.kept and not (figures_only and set(writes[v].dims) - {"stage"})]
            found[ref] = {v: target.read(v) for v in chosen}
    return found


def _merge_journal(outcome: Outcome, store: Any) -> None:
    """Reports of reused cells, as the journal has them."""
    for ref in outcome.reused:
        entry = store.journal.entries.get(store.names[ref])
        if entry is not None and ref not in outcome.reports and entry.event == "done":
            kept = {chunk.path for chunk in store.laid.chunk_paths(outcome.plan.cells[ref])}
            files = tuple(file for file in entry.files if file.path in kept)
            outcome.reports[ref] = CellReport(
                *ref, "reused", entry.seconds, files, clipped=entry.clipped, clipped_flux=entry.clipped_flux, floored=entry.floored
            )


def _as_stored(outcome: Outcome, store: Any) -> dict[CellRef, CellReport]:
    """Reports for the tables of an archive: what became of a cell, whichever run computed it."""
    return {
        ref: replace(r, status=store.journal.entries[store.names[ref]].status) if r.status == "reused" else r
        for ref, r in outcome.reports.items()
    }


def _in_memory(plan: Plan, options: Options, progress: Progress) -> Outcome:
    from etendue.archive.memory import MemoryArchive
    from etendue.report import pictures, tables

    began = time.perf_counter()
    todo = set(plan.cells)
    show = frozenset(shown_cells(plan).values()) if options.pictures else frozenset()
    jobs = make_jobs(plan, todo, lambda cell: None, deliver_all=True, show=show)
    memory = MemoryArchive(plan)
    reports: dict[CellRef, CellReport] = {}
    arrays: dict[CellRef, dict[str, Any]] = {}

    def after(batch: Batch, result: BatchResult) -> None:
        reports.update({(r.stage, r.index): r for r in result.reports})
        arrays.update({ref: memory.put(ref, found) for ref, found in result.kept.items()})
        result.kept.clear()  # the scheduler holds on to its results; their arrays stand in the tree now
        progress.finished(result.reports)

    progress.begin(len(todo))
    try:
        _run(
            partition(jobs, options.batch_seconds),
            frozenset(todo),
            lambda b: progress.starting(tuple({j.ref[0] for j in b.jobs})),
            after,
            options,
            Stop(),
        )
    finally:
        progress.end()
    status = {ref: {"done": "done", "left_out": "left_out"}.get(r.status, r.status) for ref, r in reports.items()}
    frames = pictures.render(plan, shown_cells(plan), arrays) if options.pictures else []
    kept = {"ledger": tables.ledger(plan, reports), "summary": tables.summary(plan, reports)}
    if frames:
        kept["frames"] = pictures.frames_table(frames)
    tree = memory.tree(status, kept)
    return Outcome(plan, reports, set(), time.perf_counter() - began, tree=tree, arrays=arrays, shown_at=where_shown(plan))


def _run(batches: list[Batch], deliver: frozenset[CellRef], before: Any, after: Any, options: Options, stop: Stop) -> None:
    from threadpoolctl import threadpool_limits

    keep_freed_memory()
    if options.scheduler in ("serial", "threads") and any("colour-science" in j.stage.libraries for b in batches for j in b.jobs):
        from etendue import spectra

        spectra.load_library()  # a second of imports is not the run time of whichever stage comes first
    with threadpool_limits(1):  # the results must not depend on how many threads a library would like
        if options.scheduler == "serial":
            watched(lambda: run_serial(batches, deliver, before, after, stop), stop)
            return
        from etendue.run.parallel import run_parallel

        workers = options.workers or os.cpu_count() or 1
        watched(lambda: run_parallel(batches, deliver, before, after, options.scheduler, workers, stop, options.cell_timeout), stop)


def check_scheduler(text: str) -> str:
    names = ("serial", "threads", "processes")
    if text not in names and not text.startswith(("tcp://", "tls://")):
        raise RequestError(f"--scheduler {text}: there is no such scheduler{nearest(text, names)}, or tcp://host:port")
    return text


def check_timeout(options: Options) -> None:
    """A time limit is a promise to stop a cell, which only a process of its own allows."""
    if options.cell_timeout is not None and options.scheduler in ("serial", "threads"):
        what = f"with --scheduler {options.scheduler} nothing can stop a cell"
        raise RequestError(f"--cell-timeout {options.cell_timeout:g}: {what}; use --scheduler processes")


def _by_stage(refs: Iterable[CellRef]) -> dict[str, int]:
    return dict(Counter(name for name, _ in refs))


def _check_platform(store: Any, old: Mapping[str, Any] | None, options: Options, now: Mapping[str, Any]) -> None:
    if options.accept_platform or options.recompute:
        return
    way_out = "Go on with its finished cells: --accept-platform; compute all again: --recompute"
    if old is None:
        if any(entry.event == "done" for entry in store.journal.entries.values()):
            raise ArchiveError(f"no record in {store.folder / 'runs'} can be read, which say on what its cells were computed. {way_out}")
        return
    if old["platform"] == dict(now):
        return
    changed = ", ".join(f"{k} {old['platform'].get(k)} -> {now[k]}" for k in now if old["platform"].get(k) != now[k])
    raise ArchiveError(f"{store.folder} was begun on another platform ({changed}), where bits may differ. {way_out}")


def simulate(
    pipeline: str | Path | Mapping[str, Any] | Pipeline,
    *,
    archive: str | Path | None = None,
    want: Iterable[str] | None = None,
    scheduler: str = "threads",
    workers: int = 0,
    leave_out: bool = True,
    **parameters: Any,
) -> Any:
    """Run a pipeline and return its ``xarray.DataTree``.

    Parameters
    ----------
    pipeline : path, TOML text, or mapping
    archive : folder to keep and resume, or None to stay in memory
    want : variables to compute, instead of the file's ``wanted``
    scheduler, workers : ``serial``, ``threads``, ``processes`` or ``tcp://...``; threads or processes to use
    leave_out : whether what the scene does not need may be left out
    **parameters : camera quantities by name, ``stage__parameter`` for others; a list makes a sweep axis

    Raises
    ------
    RequestError
        With every fault of the file.
    EtendueError
        When cells failed: the message names them.

    Examples
    --------
    >>> tree = etendue.simulate("pipelines/smallest.toml", f_number=[2, 4])  # doctest: +SKIP
    """
    overrides: dict[str, Any] = {}
    for name, value in parameters.items():
        key = name.replace("__", ".") if "__" in name else name
        if hasattr(value, "tolist"):
            value = value.tolist()
        if isinstance(value, list | tuple | dict):
            overrides[f"sweep.{key}"] = list(value) if not isinstance(value, dict) else value
        else:
            overrides[key if "." in key else f"camera.{key}"] = value
    if want is not None:
        overrides["wanted"] = list(want)
    if isinstance(pipeline, Mapping):
        from etendue.spec.pipeline import apply_overrides, refuse_large

        refuse_large(pipeline)  # before it is copied, level by level
        document = copy.deepcopy(dict(pipeline))  # what the caller gave stays as it is, also for the next call
        apply_overrides(document, overrides)
        made = from_document(document)
    else:
        made = load(pipeline, overrides)
    plan = planner.make_plan(made, installed_stages(), leave_out)
    outcome = execute(plan, archive, Options(check_scheduler(scheduler), workers))
    if outcome.failed:
        first = outcome.failed[0]
        from etendue.errors import PluginError

        ref = (first.stage, first.index)
        raise PluginError(
            f"{len(outcome.failed)} cells failed; the first: {first.stage} {plan.labels(ref)}, {plan.origin(ref)}: {first.message}"
        )
    if archive is None:
        return outcome.tree
    import xarray

    return xarray.open_datatree(Path(archive) / "data.zarr", engine="zarr")
