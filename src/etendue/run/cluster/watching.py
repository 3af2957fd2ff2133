"""Watch a cluster: its workers, the time that each cell takes, and the tasks during which workers died.

In:  a client, and events of its workers.
Out: readable errors if a cluster cannot continue; workers that hang are ended.
"""

from __future__ import annotations

import time
from typing import Any

from etendue.errors import EtendueError, MachineError
from etendue.interrupts import end_now
from etendue.run.watch import Stop
from etendue.run.workers import STARTING
from etendue.telling import said

PATIENCE = 60.0  # seconds without a running worker after which the run ends with an error
AGAIN = 1.0  # seconds between two requests to the scheduler
DEATHS = ("KilledWorker", "FutureCancelledError", "CancelledError")


class SchedulerLost(Exception):
    """The scheduler is lost."""


class Watching:
    """A context manager for the time in which batches run. ``topic``: the Dask topic under which workers report the
    start of a cell.
    """

    def __init__(self, client: Any, stop: Stop, limit: float | None, run: str) -> None:
        self.client, self.stop, self.limit, self.topic = client, stop, limit, f"etendue-{run}"
        self.begun: dict[int, float] = {}  # when the newest cell of each batch started
        self.seen: dict[int, float] = {}  # when each batch was first seen
        self.counted, self.asked = 0, 0.0
        self.progress = time.monotonic()
        self.too_much: list[int] = []  # bytes of workers that were stopped for exceeding their memory limit
        self.may_hold = 0

    def __enter__(self) -> Watching:
        if self.limit is not None:
            self.client.subscribe_topic(self.topic, self._cell)
        self.client.subscribe_topic("worker-restart-memory", self._memory)
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self.limit is not None:
                self.client.unsubscribe_topic(self.topic)
            self.client.unsubscribe_topic("worker-restart-memory")
        except Exception:  # the scheduler may be lost
            pass

    def _cell(self, event: Any) -> None:
        self.begun[int(event[1])] = time.monotonic()

    def _memory(self, event: Any) -> None:
        self.too_much.append(int(event[1].get("rss", 0)))

    def moved(self) -> None:
        self.progress = time.monotonic()

    def threads(self) -> int:
        """Return the number of worker threads, polled from time to time."""
        if time.monotonic() - self.asked > AGAIN:
            self.look(True)
        return self.counted

    def look(self, waiting: bool) -> None:
        """Check that at least one worker is running.

        Raises
        ------
        MachineError
            No worker has been running for too long.
        Lost
            The scheduler is lost.
        """
        if self.client.status != "running":
            raise SchedulerLost
        now = time.monotonic()
        if now - self.asked < AGAIN:
            return
        workers = self.client.scheduler_info(n_workers=-1)["workers"].values()
        self.asked, self.counted = time.monotonic(), sum(worker["nthreads"] for worker in workers)
        self.may_hold = min((worker["memory_limit"] or 0 for worker in workers), default=0)
        if not waiting or any(worker["status"] == "running" for worker in workers):
            self.progress = now
            return
        if now - self.progress > PATIENCE:
            if not workers:
                why = f"there has been no worker for {PATIENCE:.0f} s"
            else:
                states = ", ".join(sorted({str(worker["status"]) for worker in workers}))
                why = (
                    f"no worker has been running for {PATIENCE:.0f} s (they are {states}; a worker pauses if "
                    "its memory is nearly full)"
                )
            raise MachineError(
                f"{why}; finished results are kept: start workers (with more memory) and run again to continue"
            )

    def overdue(self, under_way: dict[int, int]) -> list[int]:
        """Return the running batches (number -> cells) in which a cell takes too long."""
        if self.limit is None:
            return []
        now = time.monotonic()
        self.seen = {n: self.seen.get(n, now) for n in under_way}
        self.begun = {n: at for n, at in self.begun.items() if n in under_way}
        late = []
        for (
            number,
            cells,
        ) in under_way.items():  # a cell that holds the interpreter lock keeps its worker from reporting that it began
            since = self.begun.get(number)
            if now - (since or self.seen[number]) > (self.limit if since else self.limit * cells + STARTING):
                late.append(number)
        return late

    def at_work(self) -> set[Any]:
        """Return the keys of the tasks that workers hold."""
        return {key for keys in self.client.processing().values() for key in keys}

    def wait(self, future: Any, limit: float | None = None) -> str:
        """Wait until a task has ended; return the reason if it was abandoned, else ''."""
        began = None
        while future.status == "pending":
            self.stop.check()
            self.look(True)
            if limit is not None:
                now = time.monotonic()
                began = began or (now if future.key in self.at_work() else None)
                if began is not None and now - began > limit:
                    self.kill_the_worker_of(future)
                    return f"no answer within {limit:g} s: its worker was stopped (--cell-timeout)"
            time.sleep(0.02)
        return ""

    def answer(self, future: Any) -> Any:
        """Return the result of one of our own tasks."""
        self.wait(future)
        if future.status != "finished":
            self.died(future)
            raise MachineError(
                "workers die while they transfer their results; finished results are kept: give workers more "
                "memory, and run again to continue"
            )
        return future.result()

    def died(self, future: Any) -> bool:
        """Return True if workers died while computing a task; raise the exception that the task itself raised."""
        if future.status == "finished":
            return False
        if self.client.status != "running":
            raise SchedulerLost
        if future.status != "error":
            return True
        error = future.exception()
        if type(error).__name__ in DEATHS:
            return True
        if isinstance(error, EtendueError):
            raise error
        raise MachineError(f"a worker of the cluster failed: {said(error)}")

    def kill_the_worker_of(self, future: Any) -> None:
        """Restart the worker of a task: a running task cannot be stopped otherwise. A nanny starts a new worker."""
        guilty = [worker for worker, keys in self.client.processing().items() if future.key in keys]
        future.cancel(force=True)
        if not guilty:
            return
        try:
            self.client.restart_workers(guilty, timeout=30, raise_for_error=False)
        except ValueError:  # they have no nanny
            self.client.run(end_now, 1, workers=guilty, wait=False, on_error="ignore")
