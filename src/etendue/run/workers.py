"""Worker processes that may die. Each serves one thread of the run; a worker reports the start of every cell, so that
the thread can name the cell during which its worker died.

In:  batches, as plain values.
Out: their results. If its worker dies on a cell, or a cell exceeds its time limit, that cell fails, and a new worker
     computes the rest of the batch.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import multiprocessing.util
import pickle
import queue
import signal
import sys
import threading
import time
import warnings
from collections.abc import Mapping, Set
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

import cloudpickle

from etendue.compute.job import Job
from etendue.errors import EtendueError, MachineError
from etendue.interrupts import end_now, is_ours
from etendue.plan.model import CellRef
from etendue.plugins.guests import Guest, in_a_worker
from etendue.run.batches import BatchResult, Names, run_batch
from etendue.run.memory import keep_freed_memory
from etendue.run.one_thread import ONE_THREAD
from etendue.run.watch import GRACE, Stop, Stopped
from etendue.streams import show_warning
from etendue.telling import said

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

# signals from outside: the cell gets a second chance
FROM_OUTSIDE = frozenset({signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT})
LOOK = 0.2
STARTING = 120.0  # seconds added to a time limit for the worker's imports


# -- in the worker ------------------------------------------------------------------------------------------


def begin_worker() -> None:
    """Prepare a new worker process: Ctrl-C is left to the owner, and the worker ends if its owner is killed."""
    keep_freed_memory()
    # One BLAS thread, also in libraries imported later, for the life of the process: results must not depend on the
    # number of threads.
    ONE_THREAD.__enter__()
    in_a_worker()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.showwarning = show_warning
    owner = multiprocessing.parent_process()
    if owner is not None:
        threading.Thread(target=_end_with, args=(owner,), daemon=True).start()


def _end_with(owner: BaseProcess) -> None:
    owner.join()
    end_now(1)


def serve(pipe: Connection) -> None:
    """Compute batches as they arrive, reporting each cell that starts, until the owner closes the pipe."""
    begin_worker()

    def tell(data: bytes) -> None:
        try:
            pipe.send_bytes(data)
        except OSError:  # the owner was killed
            end_now(1)

    while True:
        try:
            data = pipe.recv_bytes()
        except (EOFError, OSError):
            multiprocessing.util._run_finalizers()  # type: ignore[attr-defined]  # locks of libraries would otherwise be reported as leaked
            end_now(0)  # do not wait for threads that a plugin has left behind
        try:
            with Guest("a plugin, when it was imported,"):
                jobs, exports, imports, deliver, doomed, before = pickle.loads(data)
            result = run_batch(
                jobs, exports, imports, deliver, *before, doomed=doomed, at=lambda number: tell(f"@{number}".encode())
            )
            answer = b"=" + cloudpickle.dumps(result, protocol=pickle.HIGHEST_PROTOCOL)
            del result, before
        except EtendueError as error:  # a machine fault, or the archive has another owner: raised again in the owner
            answer = b"!" + pickle.dumps((type(error), str(error)))
        except BaseException as error:
            answer = b"!" + pickle.dumps((MachineError, f"a worker failed: {said(error)}"))
        tell(answer)


# -- in the owner -------------------------------------------------------------------------------------------


class Died(Exception):
    """A worker has died: the job of the batch at which it died (-1: before the first), and the cause."""

    def __init__(self, at: int, how: str, from_outside: bool) -> None:
        super().__init__(how)
        self.at, self.how, self.from_outside = at, how, from_outside


class Worker:
    """One worker process, and the pipe to it."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=serve, args=(theirs,), name="etendue worker")
        # The child inherits this signal mask from its first instruction on: Ctrl-C goes to all processes of a terminal,
        # and only the owner should handle it.
        kept = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, kept)
        theirs.close()

    def ask(self, data: bytes, stop: Stop, limit: float | None) -> BatchResult:
        """Return the result of a batch. Raise ``Died`` if the worker dies, ``Stopped`` if the run is stopped and the
        worker does not finish soon.
        """
        at, since, end = -1, time.monotonic(), None
        try:
            self.pipe.send_bytes(data)
            while True:
                if multiprocessing.connection.wait([self.pipe, self.process.sentinel], LOOK) and self.pipe.poll():
                    answer = self.pipe.recv_bytes()
                    if answer[:1] == b"@":
                        at, since = int(answer[1:]), time.monotonic()
                        continue
                    if answer[:1] == b"!":
                        kind, text = pickle.loads(answer[1:])
                        raise kind(text)
                    result: BatchResult = pickle.loads(memoryview(answer)[1:])
                    return result
                if not self.process.is_alive():
                    raise EOFError
                if stop.asked:
                    end = end or time.monotonic() + 0.7 * GRACE
                    if time.monotonic() > end:
                        self.kill()
                        raise Stopped
                allowed = None if limit is None else limit + (STARTING if at < 0 else 0.0)
                if allowed is not None and time.monotonic() - since > allowed:
                    self.kill()
                    raise Died(at, f"no answer within {limit:g} s: its worker was stopped (--cell-timeout)", False)
        except (EOFError, OSError):
            self.process.join(5)
            code = self.process.exitcode
            self.kill()
            if code is not None and code < 0:
                name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
                hint = "; the system kills processes that use too much memory" if -code == signal.SIGKILL else ""
                raise Died(at, f"its worker process died of {name}{hint}", -code in FROM_OUTSIDE) from None
            raise Died(at, f"its worker process ended with exit code {code}", False) from None

    def kill(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()

    def end(self) -> None:
        """Close the pipe; an idle worker then ends."""
        try:
            self.pipe.close()
            self.process.join(2)
        finally:
            self.process.kill()
            self.process.join()


class Crew:
    """A fixed number of slots for workers. A worker is started when its slot is first used, and keeps this slot."""

    def __init__(self, places: int, stop: Stop, cell_timeout: float | None = None) -> None:
        quiet_tracker()
        self.stop, self.limit = stop, cell_timeout
        self.free: queue.LifoQueue[Worker | None] = queue.LifoQueue()
        for _ in range(places):
            self.free.put(None)

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *_: object) -> None:
        idle = [worker for worker in _all(self.free) if worker is not None]
        for worker in idle:
            worker.pipe.close()
        for worker in idle:
            worker.end()

    def run_batch(
        self,
        jobs: tuple[Job, ...],
        exports: Mapping[CellRef, Names],
        imports: tuple[tuple[CellRef, ...], ...],
        deliver: Set[CellRef],
        *before: BatchResult,
    ) -> BatchResult:
        """Run ``run_batch`` in a worker, repeated until all cells that kill workers are known."""
        own = frozenset(job.ref for job in jobs)
        needed = tuple(
            BatchResult({r: source.results[r] for r in refs if r in source.results}, (), {})
            for refs, source in zip(imports, before, strict=True)
        )
        doomed: dict[CellRef, str] = dict(unfit(jobs))
        jobs = tuple(job if job.ref not in doomed else job.without_stage() for job in jobs)
        second_chance: set[int] = set()
        while True:
            self.stop.check()
            data = cloudpickle.dumps(
                (jobs, exports, imports, deliver & own, doomed, needed), protocol=pickle.HIGHEST_PROTOCOL
            )
            worker = self.free.get()
            try:
                worker = worker or Worker()
                return worker.ask(data, self.stop, self.limit)
            except Died as death:
                worker = None
                self.stop.check()  # killed together with its owner
                if death.from_outside or death.at < 0:
                    if death.at not in second_chance:
                        second_chance.add(death.at)
                        continue
                if death.at < 0:
                    how = f"{death.how} before it began; a script that uses processes needs: if __name__ == '__main__':"
                    doomed |= {job.ref: how for job in jobs}
                    return run_batch(jobs, exports, imports, deliver, *before, doomed=doomed)
                doomed[jobs[death.at].ref] = death.how
            except Stopped:
                worker = None
                raise
            finally:
                self.free.put(worker)


def quiet_tracker() -> None:
    """Start Python's resource tracker without warnings: cleaning up after killed workers is expected here."""
    option = "ignore:resource_tracker:UserWarning"
    sys.warnoptions.append(option)
    try:
        resource_tracker.ensure_running()
    finally:
        sys.warnoptions.remove(option)


def _all(places: queue.LifoQueue[Worker | None]) -> list[Worker | None]:
    found = []
    while not places.empty():
        found.append(places.get_nowait())
    return found


def unfit(jobs: tuple[Job, ...]) -> Mapping[CellRef, str]:
    """Return the jobs whose stage cannot be sent to another process, with the reason."""
    try:
        cloudpickle.dumps([job.stage for job in jobs])
        return {}
    except BaseException as error:
        if is_ours(error):
            raise
    found = {}
    for job in jobs:
        try:
            cloudpickle.dumps((job.stage, job.segment, job.looking))
        except BaseException as error:
            if is_ours(error):
                raise
            found[job.ref] = f"its stage cannot be sent to another process: {said(error)}"
    return found
