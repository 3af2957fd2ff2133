"""Connect the batches of a run to a cluster: a Dask scheduler at tcp:// or tls:// with its workers, or a cluster made
for the run.

In:  batches; the address of the cluster.
Out: ``after`` is called for every batch. Errors say if the cluster cannot be reached, is lost, or has a worker that
     would give other bits.
"""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Callable, Iterator, Set
from contextlib import contextmanager, suppress
from typing import Any

from etendue.errors import EtendueError, MachineError, RequestError, shortened
from etendue.interrupts import is_ours
from etendue.plan.model import CellRef
from etendue.process import unwarned
from etendue.run.batches import Batch, BatchResult
from etendue.run.cluster.alike import Common, common_of, refused
from etendue.run.cluster.own import own_cluster
from etendue.run.cluster.sending import Sending
from etendue.run.cluster.watching import SchedulerLost
from etendue.run.schedulers import How
from etendue.run.watch import Stop, Stopped
from etendue.telling import plain, said

OWN = "distributed"  # the name of a cluster that is made for the run
ANSWER = "10s"  # how long the scheduler may take to answer at the start
FIRST = 20.0  # seconds to wait for the first worker
ASKED = 4  # times that a worker without an answer is asked again


def run_on_cluster(
    batches: list[Batch],
    deliver: Set[CellRef],
    before: Callable[[Batch], None],
    after: Callable[[Batch, BatchResult], None],
    how: How,
) -> None:
    """Run batches on the cluster at an address, or on processes of this machine for ``distributed``.

    Raises
    ------
    RequestError
        A package is missing.
    MachineError
        There is no cluster, or it cannot continue.
    """
    address = how.address
    with _lost(address), _client(address, how.workers) as client:
        stages = {type(job.stage) for batch in batches for job in batch.jobs}
        common = common_of(
            uuid.uuid4().hex,
            sorted(stages, key=lambda kind: (kind.__module__, kind.__qualname__)),
            how.platform,
            how.mark,
        )
        _first_worker(client, address, how.stop)
        _ask(client, address, common)
        Sending(client, batches, deliver, before, after, common, how.stop, how.cell_timeout).run()


@contextmanager
def _client(address: str, workers: int) -> Iterator[Any]:
    try:
        import distributed
    except ImportError:
        raise RequestError(
            f"--scheduler {address} needs the package distributed: pip install 'etendue[distributed]'"
        ) from None
    connect: Any = distributed.Client
    for name in ("distributed", *logging.root.manager.loggerDict):  # losses are reported once, by this module
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    if address == OWN:
        with own_cluster(workers) as client:
            yield client
        return
    try:
        with unwarned():  # about differing versions: those that matter are compared below
            client = connect(address, timeout=ANSWER, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        secure = "; a tls:// address needs certificates: see docs/cluster.md" if address.startswith("tls") else ""
        raise MachineError(
            f"--scheduler {address}: no Dask scheduler answers there "
            f"({shortened(' '.join(plain(str(error)).split()), 200)}){secure}; "
            "start one with 'dask scheduler' and workers with 'dask worker', or use --scheduler threads"
        ) from None
    try:
        yield client
    finally:
        with suppress(Exception):  # closing fails if the scheduler is lost
            client.close(timeout=2)


@contextmanager
def _lost(address: str) -> Iterator[None]:
    """Report errors that result from a lost scheduler as the loss of the scheduler."""
    try:
        yield
    except (EtendueError, Stopped):
        raise
    except (SchedulerLost, OSError, TimeoutError) as error:
        raise _gone(address) from error
    except BaseException as error:
        if is_ours(error) or type(error).__name__ not in (
            "CancelledError",
            "FutureCancelledError",
            "ClosedClientError",
        ):
            raise
        raise _gone(address) from error


def _gone(address: str) -> MachineError:
    return MachineError(
        f"--scheduler {address}: the scheduler is lost; finished results are kept: start it again and run again to "
        f"continue, or continue with "
        "--scheduler threads"
    )


def _first_worker(client: Any, address: str, stop: Stop) -> None:
    until = time.monotonic() + FIRST
    while not client.scheduler_info(n_workers=-1)["workers"]:
        stop.check()
        if time.monotonic() > until:
            raise MachineError(
                f"--scheduler {address}: the scheduler has had no workers for {FIRST:.0f} s; start some with: dask "
                f"worker {address}"
            )
        time.sleep(0.1)


def _ask(client: Any, address: str, common: Common) -> None:
    """Refuse workers that would give other bits or see another archive, before anything is sent."""
    need = f"scheduler and workers need the etendue of this process ({common.has['etendue']}) and its plugins"
    try:
        client.run_on_scheduler(_there)
    except Exception as error:
        raise MachineError(
            f"--scheduler {address}: the scheduler does not answer ({shortened(said(error), 200)}); {need}"
        ) from None
    answers = client.run(common.differences, on_error="return")
    for _ in range(ASKED):
        silent = [worker for worker, answer in answers.items() if isinstance(answer, BaseException)]
        if silent:
            time.sleep(0.5)  # by then the scheduler has dropped workers that just died
            there = client.scheduler_info(n_workers=-1)["workers"]
            answers = {worker: answer for worker, answer in answers.items() if worker in there}
            if again := [worker for worker in silent if worker in there]:
                answers |= client.run(common.differences, workers=again, on_error="return")
    found = {}
    for worker, answer in answers.items():
        if isinstance(answer, BaseException):
            answer = [f"no answer ({shortened(said(answer), 200)}): {need}"]
        if answer:
            found[worker] = answer
    if found:
        raise MachineError(f"--scheduler {address}: {refused(found)}")


def _there() -> bool:
    return True
