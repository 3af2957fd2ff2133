"""Run the work in a separate thread, so that the main thread can handle signals without interrupting a write.

In:  the work, as a function that checks a ``Stop`` before every batch.
Out: returns when the work has ended; raises ``Interrupted`` if it was stopped.
"""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager
from typing import TYPE_CHECKING

from etendue import interrupts
from etendue.compute.ownership import abandoned
from etendue.compute.tables import TABLES
from etendue.plan.model import CellRef
from etendue.run.memory import AT_ONCE, keep_freed_memory
from etendue.run.one_thread import ONE_THREAD
from etendue.run.schedulers import How, scheduler

if TYPE_CHECKING:
    from etendue.run.batches import Batch, BatchResult

GRACE = 3.0  # seconds for running batches to end; a stage that hangs in a thread cannot be stopped
LOOK = 0.05  # seconds between two checks for a signal


class Stopped(Exception):
    """The run has been stopped; no further batch starts."""


class Stop:
    """The request to stop a run."""

    def __init__(self) -> None:
        self._asked = threading.Event()
        self.abandoned = False  # a batch was still running when the run was given up

    def ask(self) -> None:
        self._asked.set()

    @property
    def asked(self) -> bool:
        return self._asked.is_set()

    def check(self) -> None:
        if self._asked.is_set():
            raise Stopped


def watched(work: Callable[[], None], stop: Stop) -> None:
    """Run ``work`` to its end, or until a signal comes and the running batches have ended."""
    broke: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except Stopped:
            pass
        except BaseException as error:
            broke.append(error)

    worker = threading.Thread(target=run, name="run", daemon=True)
    worker.start()
    try:
        while worker.is_alive():
            worker.join(LOOK)
            interrupts.check()
    except KeyboardInterrupt:
        stop.ask()
        until = time.monotonic() + GRACE
        while worker.is_alive() and time.monotonic() < until:
            worker.join(LOOK)
        if worker.is_alive():
            stop.abandoned = True
            abandoned()
        raise
    if broke:
        raise broke[0]


def run_batches(
    batches: list[Batch],
    deliver: Set[CellRef],
    before: Callable[[Batch], None],
    after: Callable[[Batch, BatchResult], None],
    how: How,
) -> None:
    """Run batches with single-threaded linear algebra; afterwards drop cached tables that recent runs did not use."""
    if not batches:
        return
    with _as_a_run():
        if interrupts.owns():  # until here a command hardly collects; what cells leave may hold arrays
            gc.set_threshold(AT_ONCE, *gc.get_threshold()[1:])
        run = scheduler(how.address).run()
        watched(lambda: run(batches, deliver, before, after, how), how.stop)


def run_briefly(batches: list[Batch], deliver: Set[CellRef], after: Callable[[Batch, BatchResult], None]) -> None:
    """Run batches that take less time than a signal may wait, one after the other in this thread: starting another
    thread takes as long as many cells.
    """
    with _as_a_run():
        scheduler("serial").run()(batches, deliver, lambda batch: None, after, How("serial", 1, Stop()))


@contextmanager
def _as_a_run() -> Iterator[None]:
    keep_freed_memory()
    with ONE_THREAD, TABLES.run():
        yield
