"""Recompute batches whose workers died, cell by cell and with no other batch running, so that only the cell that kills
its worker fails.

In:  a batch; the results that it reads.
Out: its result. A cell that kills every worker that tries it, or that takes too long, becomes a failed cell.
"""

from __future__ import annotations

from collections.abc import Set
from typing import Any

from etendue.compute.job import Job
from etendue.errors import MachineError
from etendue.plan.model import CellRef
from etendue.run.batches import Batch
from etendue.run.cluster.alike import Common
from etendue.run.cluster.tasks import as_bytes, compute, joined
from etendue.run.cluster.watching import Watching


class Suspects:
    """Batches whose workers died. ``results``: results of ended batches, which are lost if the workers that hold them
    die.
    """

    def __init__(
        self,
        client: Any,
        batches: dict[int, Batch],
        results: dict[int, Any],
        deliver: Set[CellRef],
        common: Common,
        watching: Watching,
    ) -> None:
        self.client, self.batches, self.results, self.deliver = client, batches, results, deliver
        self.common, self.watching = common, watching
        self.doomed: dict[CellRef, str] = {}

    def one_by_one(self, batch: Batch) -> Any:
        """Return the result of a batch, computed with one task per cell."""
        known = set(self.doomed)
        for number in batch.imports:  # lost with a worker, and workers died recomputing it
            if self.results[number].status not in ("finished", "pending"):
                self.results[number] = self.again(number)
        if self.doomed.keys() - known:
            raise MachineError("workers die while recomputing lost results; finished results are kept: run again")
        return self.cells(batch, self.results)

    def again(self, number: int) -> Any:
        """Compute a finished batch again and return its result."""
        batch, sound = self.batches[number], ("finished", "pending")
        there = {n: self.results[n] for n in batch.imports if n in self.results and self.results[n].status in sound}
        return self.cells(batch, {n: there[n] if n in there else self.again(n) for n in batch.imports})

    def cells(self, batch: Batch, results: dict[int, Any]) -> Any:
        made: dict[CellRef, Any] = {}
        home = {ref: n for n, refs in batch.imports.items() for ref in refs}
        for job in batch.jobs:
            sources = {ref: made[ref] if ref in made else results[home[ref]] for ref in job.needs}
            if job.ref not in self.doomed:
                made[job.ref] = self.alone(job, sources)
                why = self.tried(made[job.ref])
                if not why:
                    continue
                self.doomed[job.ref] = why
            made[job.ref] = self.alone(job, sources)
            self.watching.wait(made[job.ref])
        return self.client.submit(joined, tuple(batch.exports), *made.values(), pure=False)

    def alone(self, job: Job, sources: dict[CellRef, Any]) -> Any:
        doomed = {job.ref: self.doomed[job.ref]} if job.ref in self.doomed else {}
        data = as_bytes((job,), {job.ref: None}, tuple((ref,) for ref in sources), self.deliver, doomed)
        return self.client.submit(compute, self.common, data, *sources.values(), pure=False)

    def tried(self, future: Any) -> str:
        """Return the reason why a cell that was tried alone has failed; '' if it has not failed."""
        watching = self.watching
        watching.too_much.clear()
        why = watching.wait(future, watching.limit)
        if why or not watching.died(future):
            return why
        if watching.too_much:
            return (
                f"it needs more memory than a worker may use ({watching.may_hold / 1e9:.2f} GB): every worker that "
                f"tried it alone was stopped, at {max(watching.too_much) / 1e9:.2f} GB. Give workers more memory "
                f"(dask worker --memory-limit), or make frames smaller"
            )
        return (
            "every worker that computed it died, although it ran alone: it crashes its process, or takes more memory "
            "than the machine has"
        )
