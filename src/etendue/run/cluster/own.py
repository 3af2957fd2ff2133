"""A cluster on this machine for the length of a run: a scheduler in this process, and watched worker processes.

In:  the number of workers.
Out: a Dask client. Scheduler and workers listen only on loopback and use TLS with a certificate that no other program
     has. Without TLS, any program on the machine could run its code in them.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from etendue.errors import MachineError, RequestError
from etendue.run.workers import quiet_tracker

DEATHS = 1  # number of workers that may die while computing a batch before its cells are tried one by one
ENDING = 10.0  # seconds for workers to end in order
SILENT = logging.CRITICAL + 1
# the profiler inspects frames, where CPython 3.11 may hang (its issue 106883)
NO_PROFILE = {"distributed.worker.profile.enabled": False}


@contextmanager
def own_cluster(workers: int) -> Iterator[Any]:
    """Yield a client of ``workers`` worker processes with one thread each; a worker that dies is replaced."""
    try:
        import cryptography  # noqa: F401  # makes the certificate
        import distributed
    except ImportError as error:
        raise RequestError(
            f"--scheduler distributed needs the package {error.name}: pip install 'etendue[distributed]'"
        ) from None
    quiet_tracker()  # otherwise Python unblocks the signal when it starts the tracker itself
    # The thread that starts the workers, and the workers, inherit this signal mask: Ctrl-C is for the owner to handle.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    made: Any = distributed.LocalCluster
    try:
        cluster = made(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            protocol="tls://",
            dashboard_address=None,
            security=distributed.Security.temporary(),  # type: ignore[no-untyped-call]
            scheduler_kwargs={"allowed_failures": DEATHS},
            silence_logs=SILENT,
            config=NO_PROFILE,
        )
    except (OSError, RuntimeError, TimeoutError) as error:
        raise MachineError(f"--scheduler distributed: cannot start the workers: {error}") from None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    connect, patience = distributed.Client, 0.5
    try:
        client = connect(cluster, set_as_default=False)  # type: ignore[no-untyped-call]
        yield client
        patience = ENDING
        with suppress(Exception):  # all results are here already
            client.close(timeout=patience)  # type: ignore[no-untyped-call]
    finally:
        _end(cluster, patience)


def _end(cluster: Any, patience: float) -> None:
    """Shut down a cluster: in order or, if the machine is too busy for that, by killing its workers."""
    try:
        if patience < ENDING:  # the run has failed
            _kill(cluster)
        cluster.close(timeout=patience)
    except Exception:
        _kill(cluster)


def _kill(cluster: Any) -> None:
    for nanny in cluster.workers.values():
        nanny.auto_restart = False
        process = getattr(getattr(nanny, "process", None), "process", None)
        if process is not None and process.pid:
            with suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)
