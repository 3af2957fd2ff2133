"""Batches on a cluster that is there already: a Dask scheduler at tcp:// or tls://, which may lose workers or be lost itself.

In:  batches in an order in which each stands behind those it reads.
Out: their results. Where workers die of a batch its cells are tried one by one, so that only the guilty one fails.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from etendue.errors import EtendueError, MachineError, RequestError
from etendue.interrupts import is_ours
from etendue.plan.model import CellRef
from etendue.run.batches import Batch, BatchResult, run_batch
from etendue.run.job import Job
from etendue.run.watch import Stop, Stopped
from etendue.run.workers import one_thread_inside
from etendue.telling import plain, said

LOOK = 0.2
ANSWER = "10s"  # how long the scheduler may take to answer at the start


def _report(result: BatchResult) -> tuple[Any, Any]:
    return result.reports, result.kept


def _joined(exports: tuple[CellRef, ...], *parts: BatchResult) -> BatchResult:
    """One batch, from the results of its cells."""
    results = {ref: result for part in parts for ref, result in part.results.items()}
    kept = {ref: arrays for part in parts for ref, arrays in part.kept.items()}
    return BatchResult({ref: results[ref] for ref in exports}, tuple(r for part in parts for r in part.reports), kept)


def run_on_cluster(
    batches: list[Batch], deliver: frozenset[CellRef], before: Callable[[Batch], None], after: Callable[[Batch, BatchResult], None],
    address: str, stop: Stop, cell_timeout: float | None,
) -> None:  # fmt: skip
    try:
        import distributed
    except ImportError:
        raise RequestError(f"--scheduler {address} needs the package distributed: pip install 'etendue[distributed]'") from None
    import logging

    for name in ("distributed", *logging.root.manager.loggerDict):  # what is lost is said once, here
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        client = distributed.Client(address, timeout=ANSWER, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise MachineError(
            f"--scheduler {address}: no Dask scheduler answers there ({' '.join(plain(str(error)).split())[:200]}); start one with "
            "'dask scheduler' and workers with 'dask worker', or use --scheduler threads"
        ) from None
    try:
        with _lost(client, address, stop):
            if not client.scheduler_info(n_workers=-1).get("workers"):
                raise MachineError(f"--scheduler {address}: the scheduler has no workers; start some with: dask worker {address}")
            client.run(one_thread_inside)
            _Run(client, batches, deliver, before, after, stop, cell_timeout).run()
    finally:
        try:
            client.close(timeout=2)
        except Exception:  # a client without its scheduler has nothing to close
            pass


@contextmanager
def _lost(client: Any, address: str, stop: Stop) -> Iterator[None]:
    """What goes wrong because the scheduler is no longer there is said to be that."""
    try:
        yield
    except (EtendueError, Stopped):
        raise
    except BaseException as error:
        if is_ours(error) or (client.status == "running" and not isinstance(error, OSError | TimeoutError)):
            raise
        raise _gone(address) from error


def _gone(address: str) -> MachineError:
    return MachineError(
        f"--scheduler {address}: the scheduler is gone; what is finished is kept: start it again and run again to go on, or go on with "
        "--scheduler threads"
    )


class _Run:
    def __init__(self, client: Any, batches: list[Batch], deliver: Any, before: Any, after: Any, stop: Stop, limit: float | None) -> None:
        self.client, self.deliver, self.before, self.after, self.stop, self.limit = client, deliver, before, after, stop, limit
        self.batches = {batch.number: batch for batch in batches}
        self.futures: dict[int, Any] = {}
        self.readers: dict[int, int] = {}
        for batch in batches:
            for number in batch.imports:
                self.readers[number] = self.readers.get(number, 0) + 1

    def submit(self, batch: Batch) -> Any:
        inputs = sorted(batch.imports)
        return self.client.submit(
            run_batch, tuple(batch.jobs), tuple(batch.exports), tuple(tuple(batch.imports[n]) for n in inputs), self.deliver,
            *(self.futures[n] for n in inputs), pure=False, key=None,
        )  # fmt: skip

    def run(self) -> None:
        for batch in self.batches.values():
            self.before(batch)
            self.futures[batch.number] = self.submit(batch)
        waiting = set(self.batches)
        since: dict[int, float] = {}  # when a batch was first seen at work
        while waiting:
            self.stop.check()
            if self.client.status != "running":
                raise _gone(self.client.scheduler.address if self.client.scheduler else "")
            ready = [n for n in sorted(waiting) if self.futures[n].status != "pending" and self.inputs_stand(n, waiting)]
            for number in ready:
                self.end(number)
                waiting.discard(number)
            if not ready:
                self.look_at_the_clock(waiting, since)
                time.sleep(LOOK / 10)

    def inputs_stand(self, number: int, waiting: set[int]) -> bool:
        return not any(n in waiting for n in self.batches[number].imports)

    def look_at_the_clock(self, waiting: set[int], since: dict[int, float]) -> None:
        """Batches under way for longer than all their cells may take are taken back, and their cells tried one by one."""
        if self.limit is None:
            return
        now = time.monotonic()
        for number in list(waiting):
            if not self.inputs_stand(number, waiting):
                continue
            since.setdefault(number, now)
            if now - since[number] > self.limit * len(self.batches[number].jobs) and self.at_work(self.futures[number]):
                self.kill_the_worker_of(self.futures[number])
                self.finish(self.batches[number], self.one_by_one(self.batches[number]))
                waiting.discard(number)

    def at_work(self, future: Any) -> bool:
        return any(future.key in keys for keys in self.client.processing().values())

    def end(self, number: int) -> None:
        batch, future = self.batches[number], self.futures[number]
        if future.status in ("error", "cancelled", "lost"):  # of its own, or what it reads had failed before it was mended
            future = self.retried(batch)
        self.finish(batch, future)

    def retried(self, batch: Batch) -> Any:
        if len(batch.jobs) > 1 or not batch.imports:
            return self.one_by_one(batch) if _died(self.futures[batch.number]) else self.again(batch)
        return self.again(batch)

    def again(self, batch: Batch) -> Any:
        future = self.submit(batch)
        self.wait(future, None)
        return self.one_by_one(batch) if _died(future) else future

    def one_by_one(self, batch: Batch) -> Any:
        """Every cell of a batch as a task of its own; one of which workers die, or that takes too long, has failed."""
        made: dict[CellRef, Any] = {}
        home = {ref: n for n, refs in batch.imports.items() for ref in refs}
        for job in batch.jobs:
            self.stop.check()
            sources = {ref: made[ref] if ref in made else self.futures[home[ref]] for ref in job.needs}
            future = self.client.submit(*self.alone(job, sources), pure=False, key=None)
            why = self.wait(future, self.limit)
            if why or _died(future):
                why = why or "every worker died that computed it"
                future = self.client.submit(*self.alone(job, sources, why), pure=False, key=None)
                self.wait(future, None)
            made[job.ref] = future
        return self.client.submit(_joined, tuple(batch.exports), *made.values(), pure=False, key=None)

    def alone(self, job: Job, sources: dict[CellRef, Any], why: str = "") -> tuple[Any, ...]:
        imports = tuple((ref,) for ref in sources)
        return (_run_alone, job, imports, self.deliver & {job.ref}, why, *sources.values())

    def wait(self, future: Any, limit: float | None) -> str:
        """Until a task has ended; or why it was given up."""
        began = None
        while future.status == "pending":
            self.stop.check()
            if self.client.status != "running":
                raise OSError("the scheduler is gone")
            if limit is not None:
                now = time.monotonic()
                began = began or (now if self.at_work(future) else None)
                if began is not None and now - began > limit:
                    self.kill_the_worker_of(future)
                    return f"no answer within {limit:g} s: its worker was stopped (--cell-timeout)"
            time.sleep(LOOK / 10)
        return ""

    def kill_the_worker_of(self, future: Any) -> None:
        """A task that runs cannot be stopped but with its worker; a nanny starts another."""
        guilty = [worker for worker, keys in self.client.processing().items() if future.key in keys]
        future.cancel(force=True)
        if guilty:
            self.client.restart_workers(guilty, timeout=30, raise_for_error=False)

    def finish(self, batch: Batch, future: Any) -> None:
        self.futures[batch.number] = future
        reports, kept = self.client.submit(_report, future, pure=False).result()
        self.after(batch, BatchResult({}, reports, kept))
        for n in batch.imports:  # let go of what nobody reads any more
            self.readers[n] -= 1
            if not self.readers[n]:
                del self.futures[n]
        if not self.readers.get(batch.number):
            del self.futures[batch.number]


def _run_alone(job: Job, imports: Any, deliver: Any, why: str, *before: BatchResult) -> BatchResult:
    return run_batch((job,), (job.ref,), imports, deliver, *before, doomed={job.ref: why} if why else {})


def _died(future: Any) -> bool:
    """Whether workers died of a task. What it raised itself, or a scheduler that is lost, is raised."""
    if future.status == "finished":
        return False
    if future.status != "error":
        return True
    error = future.exception()
    if type(error).__name__ in ("KilledWorker", "FutureCancelledError", "CancelledError"):
        return True
    if isinstance(error, EtendueError):
        raise error
    raise MachineError(f"a worker of the cluster broke off: {said(error)}")
