"""Run batches with dask: one raw graph with a task per batch, on threads, each of which may wait for a process.

The only module that imports dask. A raw graph costs 84 us per task, ``dask.delayed`` 1037 us.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from types import MappingProxyType
from typing import Any
from uuid import uuid4

from etendue.plan.model import CellRef
from etendue.run.batches import Batch, BatchResult, run_batch
from etendue.run.memory import return_freed_memory
from etendue.run.ready import Ready
from etendue.run.schedulers import How
from etendue.run.workers import Crew
from etendue.types.documents import Document

NOTHING: Mapping[int, Sequence[int]] = MappingProxyType({})
Before = Callable[[Batch], None]
After = Callable[[Batch, BatchResult], None]
Runner = Callable[..., BatchResult]  # (jobs, exports, imports, deliver, *results of earlier batches)


def graph_of(
    batches: list[Batch],
    deliver: Set[CellRef],
    runner: Runner = run_batch,
    run: str = "",
    held_back: Mapping[int, Sequence[int]] = NOTHING,
) -> Document:
    """Return the raw Dask graph, in which a batch depends on the batches from which it reads cells, and on the batches
    that must end before it may begin.
    """
    graph: Document = {}
    for batch in batches:
        inputs = sorted(batch.imports)
        imports = tuple(tuple(batch.imports[n]) for n in inputs)
        # The function is hidden in a partial, so that dask does not search its arguments for keys.
        task = partial(_run, runner, batch, imports, deliver)
        graph[_key(run, batch.number)] = (task, *(_key(run, n) for n in (*inputs, *held_back.get(batch.number, ()))))
    return graph


def _key(run: str, number: int) -> str:
    return f"batch-{number}-{run}"


def _run(
    runner: Runner, batch: Batch, imports: tuple[tuple[CellRef, ...], ...], deliver: Set[CellRef], *before: BatchResult
) -> BatchResult:
    """Run a batch. Its jobs are created where it starts and dropped where it ends."""
    return runner(tuple(batch.jobs), dict(batch.exports), imports, deliver, *before[: len(imports)])


def run_threads(batches: list[Batch], deliver: Set[CellRef], before: Before, after: After, how: How) -> None:
    """Run the graph on threads of this process."""
    _threaded(batches, deliver, before, after, how, run_batch)


def run_processes(batches: list[Batch], deliver: Set[CellRef], before: Before, after: After, how: How) -> None:
    """Run the graph on threads, each of which waits for its own worker process, which may die."""
    with Crew(how.workers, how.stop, how.cell_timeout) as crew:
        _threaded(batches, deliver, before, after, how, crew.run_batch)


def _threaded(
    batches: list[Batch], deliver: Set[CellRef], before: Before, after: After, how: How, runner: Runner
) -> None:
    import dask.threaded

    stop = how.stop

    def unless_stopped(*arguments: Any) -> BatchResult:
        stop.check()
        return runner(*arguments)

    run = uuid4().hex  # keys are unique among all graphs of the process
    held_back = Ready[BatchResult](batches, how.workers).held_back()
    graph = graph_of(batches, deliver, unless_stopped, run, held_back)
    numbers = {_key(run, batch.number): batch for batch in batches}
    ends = [key for key, batch in numbers.items() if not batch.exports]

    def started(key: str, *_: Any) -> None:
        if not stop.asked:
            if numbers[key].number in held_back:
                return_freed_memory()
            before(numbers[key])

    def ended(key: str, value: Any, *_: Any) -> None:
        after(numbers[key], value)

    # Callbacks for this call only: a ``dask.callbacks.Callback`` would hear of every graph of the process. The pool is
    # our own, so that an interrupted run waits for running batches before it releases the archive.
    told = [(None, None, started, ended, None)]
    with ThreadPoolExecutor(how.workers) as pool:
        dask.threaded.get(graph, ends, pool=pool, callbacks=told, chunksize=1, rerun_exceptions_locally=False)
