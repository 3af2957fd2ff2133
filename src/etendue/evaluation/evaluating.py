"""Compute some variables of some cells of a plan; results that are already in memory are not computed again.

In:  a plan, the wanted variables, the results of earlier evaluations.
Out: the arrays and reports of the wanted cells; new results are added for later evaluations.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from etendue import interrupts
from etendue.compute.job import Job
from etendue.compute.jobs import make_jobs
from etendue.contract.ports import CellReport
from etendue.evaluation.results import Entry, Results
from etendue.plan.ancestry import ancestry
from etendue.plan.model import Cell, CellRef, Plan
from etendue.run.batches import Batch, BatchResult, partition
from etendue.run.memory import SELDOM_COLLECTING
from etendue.run.watch import Stop, run_batches, run_briefly
from etendue.session import HeldArrays, Options

if TYPE_CHECKING:
    from etendue.types.arrays import Array

Wanted = Mapping[CellRef, frozenset[str]]
SHORT = 0.25  # estimated seconds of cells below which threads take longer than they save


@dataclass
class Evaluated:
    """The arrays and reports of the wanted cells. ``computed``: the cells that this evaluation has computed."""

    arrays: dict[CellRef, dict[str, Array]] = field(default_factory=dict)
    reports: dict[CellRef, CellReport] = field(default_factory=dict)
    computed: list[CellReport] = field(default_factory=list)
    failed: list[CellReport] = field(default_factory=list)


def evaluate(plan: Plan, wanted: Wanted, results: Results, options: Options | None = None) -> Evaluated:
    """Return the wanted variables of cells.

    Raises
    ------
    MachineError
        If the machine, not a stage, ends the run.
    """
    options = options or Options()
    alone = replace(plan, kept=frozenset())
    held = {ref: entry for ref, cell in plan.cells.items() if (entry := _held(cell, results)) is not None}
    known, todo, jobs = _left_to_do(alone, wanted, held)
    found = Evaluated()
    for ref in known:
        entry, names = held[ref], {*wanted.get(ref, ()), *(jobs[ref].deliver if ref in jobs else ())}
        results.used(plan.cells[ref].key, entry.report, {name: entry.arrays[name] for name in names})
        if ref in wanted:
            found.arrays[ref] = {name: held[ref].arrays[name] for name in wanted[ref]}
            found.reports[ref] = replace(held[ref].report, stage=ref[0], index=ref[1])

    def after(batch: Batch, result: BatchResult) -> None:
        for report in result.reports:
            ref = (report.stage, report.index)
            if report.status in ("failed", "skipped"):
                found.failed += [report] if report.status == "failed" else []
                found.reports[ref] = report
            elif report.status != "loaded":
                arrays = {n: a for n, a in result.kept.get(ref, {}).items() if type(a) is np.ndarray}
                found.computed.append(report)
                found.reports[ref] = report
                if ref in wanted:
                    found.arrays[ref] = {name: arrays[name] for name in wanted[ref] if name in arrays}
                if plan.cells[ref].left_out is None:
                    results.put(plan.cells[ref].key, report, arrays)
        result.kept, result.reports = {}, ()

    if todo:
        batches = partition(jobs, options.batch_seconds)
        with interrupts.held(), SELDOM_COLLECTING:
            interrupts.check()
            if sum(batch.seconds for batch in batches) < SHORT:
                run_briefly(batches, frozenset(todo), after)
            else:
                run_batches(batches, frozenset(todo), lambda batch: None, after, options.how(Stop()))
    return found


def _held(cell: Cell, results: Results) -> Entry | None:
    """Return the results of a cell that are in memory; None for a left-out cell, which has its input's key."""
    return None if cell.left_out is not None or not cell.key else results.seen(cell.key)


def _left_to_do(
    plan: Plan, wanted: Wanted, held: Mapping[CellRef, Entry]
) -> tuple[Set[CellRef], Set[CellRef], Mapping[CellRef, Job]]:
    """Return the cells to read from memory, the cells to compute, and the jobs of all these cells."""
    roots = set(wanted)
    known = {ref for ref, entry in held.items() if wanted.get(ref, frozenset()) <= entry.arrays.keys()}
    while True:
        todo = ancestry(plan, roots, known) - known

        def target(cell: Cell) -> Any:
            return HeldArrays(held[cell.ref].arrays) if cell.ref in held else None

        show = frozenset(ref for ref, names in wanted.items() if names and ref in todo)
        own = {ref: replace(job, give=None) for ref, job in make_jobs(plan, todo, target, show=show).items()}
        # If a later cell reads variables of a known cell that are not in memory, the known cell is computed, too.
        lacking = {
            ref
            for ref, job in own.items()
            if ref not in todo and not set(job.deliver) <= (held[ref].arrays.keys() if ref in held else set())
        }
        if not lacking:
            used = {ref for ref in known if ref in own or ref in wanted}
            return used, todo, own
        known -= lacking
        roots |= lacking
