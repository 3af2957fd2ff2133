"""Dask runs the batches: one raw graph, a task per batch, on threads, processes or a cluster.

The only importer of dask. A raw graph costs 84 us a task where ``dask.delayed`` costs 1037.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

from etendue.errors import RequestError
from etendue.plan.model import CellRef
from etendue.run.batches import Batch, BatchResult, run_batch
from etendue.run.memory import keep_freed_memory


def graph_of(batches: list[Batch], deliver: frozenset[CellRef]) -> dict[str, Any]:
    """The raw Dask graph: ``batch-7`` depends on the batches it imports from."""
    graph: dict[str, Any] = {}
    for batch in batches:
        inputs = sorted(batch.imports)
        imports = tuple(tuple(batch.imports[n]) for n in inputs)
        # The jobs hide in a partial, so that dask does not walk through them in search of keys.
        task = partial(run_batch, tuple(batch.jobs), tuple(batch.exports), imports, deliver)
        graph[f"batch-{batch.number}"] = (task, *(f"batch-{n}" for n in inputs))
    return graph


def one_thread_inside() -> None:
    """BLAS with one thread: results must not depend on how many there are."""
    global _limits
    keep_freed_memory()
    from threadpoolctl import threadpool_limits

    _limits = threadpool_limits(1)


_limits: Any = None


def begin_worker() -> None:
    """In a new worker process: Ctrl-C is the owner's to answer, and a worker whose owner was killed ends by itself."""
    one_thread_inside()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    owner = multiprocessing.parent_process()
    if owner is not None:
        threading.Thread(target=_end_with, args=(owner,), daemon=True).start()


def _end_with(owner: Any) -> None:
    owner.join()
    os._exit(1)


def _report(result: BatchResult) -> tuple[Any, Any]:
    return result.reports, result.kept


def run_parallel(
    batches: list[Batch],
    deliver: frozenset[CellRef],
    before: Callable[[Batch], None],
    after: Callable[[Batch, BatchResult], None],
    scheduler: str,
    workers: int,
) -> None:
    """Run the graph; ``before`` and ``after`` are told in the owner's process as batches start and end."""
    if not batches:
        return
    graph = graph_of(batches, deliver)
    numbers = {f"batch-{batch.number}": batch for batch in batches}
    ends = [key for key, batch in numbers.items() if not batch.exports]
    if scheduler.startswith("tcp://") or scheduler.startswith("tls://"):
        _on_cluster(numbers, deliver, before, after, scheduler)
        return
    import dask
    from dask.callbacks import Callback

    def started(key: Any, *_: Any) -> None:
        if key in numbers:
            before(numbers[key])

    def ended(key: Any, value: Any, *_: Any) -> None:
        if key in numbers:
            after(numbers[key], value)

    with Callback(pretask=started, posttask=ended):
        if scheduler == "processes":
            import dask.multiprocessing

            with dask.config.set({"multiprocessing.context": "spawn", "multiprocessing.initializer": begin_worker}):
                dask.multiprocessing.get(graph, ends, num_workers=workers, chunksize=1, optimize_graph=False)
        else:
            import dask.threaded

            # A pool of our own: an interrupted run waits for the batches under way before the archive is let go.
            with ThreadPoolExecutor(workers) as pool:
                dask.threaded.get(graph, ends, pool=pool)


def _on_cluster(numbers: dict[str, Batch], deliver: frozenset[CellRef], before: Any, after: Any, address: str) -> None:
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise RequestError(f"--scheduler {address} needs the package distributed: pip install 'etendue[distributed]'") from None
    with Client(address, timeout="10s") as client:
        client.run(one_thread_inside)
        readers: dict[int, int] = {}
        for batch in numbers.values():
            for n in batch.imports:
                readers[n] = readers.get(n, 0) + 1
        futures: dict[int, Any] = {}
        for batch in numbers.values():
            before(batch)
            inputs = sorted(batch.imports)
            futures[batch.number] = client.submit(
                run_batch, tuple(batch.jobs), tuple(batch.exports), tuple(tuple(batch.imports[n]) for n in inputs),
                deliver, *(futures[n] for n in inputs), pure=False, key=None,
            )  # fmt: skip
        by_key = {future.key: number for number, future in futures.items()}
        for future in as_completed(list(futures.values())):
            batch = numbers[f"batch-{by_key[future.key]}"]
            reports, kept = client.submit(_report, future, pure=False).result()
            after(batch, BatchResult({}, reports, kept))
            for n in batch.imports:  # let go of what nobody reads any more
                readers[n] -= 1
                if not readers[n]:
                    del futures[n]
            if not readers.get(batch.number):
                del futures[batch.number]
