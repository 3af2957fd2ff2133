"""Dask runs the batches: one raw graph, a task per batch, on threads, processes or a cluster.

The only importer of dask. A raw graph costs 84 us a task where ``dask.delayed`` costs 1037.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from etendue.errors import RequestError
from etendue.plan.model import CellRef
from etendue.run.batches import Batch, BatchResult, run_batch


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
    from threadpoolctl import threadpool_limits

    _limits = threadpool_limits(1)


_limits: Any = None


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
        _on_cluster(graph, numbers, before, after, scheduler)
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

            with dask.config.set({"multiprocessing.context": "spawn", "multiprocessing.initializer": one_thread_inside}):
                dask.multiprocessing.get(graph, ends, num_workers=workers, chunksize=1, optimize_graph=False)
        else:
            import dask.threaded

            dask.threaded.get(graph, ends, num_workers=workers)


def _on_cluster(graph: dict[str, Any], numbers: dict[str, Batch], before: Any, after: Any, address: str) -> None:
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise RequestError(f"--scheduler {address} needs the package distributed: pip install 'etendue[distributed]'") from None
    with Client(address, timeout="10s") as client:
        futures: dict[str, Any] = {}
        for key, batch in numbers.items():
            before(batch)
            inputs = sorted(batch.imports)
            futures[key] = client.submit(
                run_batch, tuple(batch.jobs), tuple(batch.exports), tuple(tuple(batch.imports[n]) for n in inputs),
                frozenset(), *(futures[f"batch-{n}"] for n in inputs), pure=False, key=None,
            )  # fmt: skip
        by_key = {future.key: key for key, future in futures.items()}
        for future in as_completed(list(futures.values())):
            key = by_key[future.key]
            reports, kept = client.submit(_report, future, pure=False).result()
            after(numbers[key], BatchResult({}, reports, kept))
