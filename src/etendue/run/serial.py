"""The reference scheduler: every batch in order, in this thread."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Set

from etendue.plan.model import CellRef
from etendue.run.batches import Batch, BatchResult, run_batch
from etendue.run.order import depth_first
from etendue.run.schedulers import How


def run_serial(
    batches: list[Batch],
    deliver: Set[CellRef],
    before: Callable[[Batch], None],
    after: Callable[[Batch, BatchResult], None],
    how: How,
) -> None:
    """Run batches one after the other; ``before`` and ``after`` are called in the owner's thread."""
    finished: dict[int, BatchResult] = {}
    readers = Counter(number for batch in batches for number in batch.inputs)
    by_number = {batch.number: batch for batch in batches}
    for batch in (by_number[n] for n in depth_first(by_number, lambda n: by_number[n].inputs)):
        how.stop.check()
        before(batch)
        inputs = sorted(batch.imports)
        result = run_batch(
            tuple(batch.jobs),
            dict(batch.exports),
            tuple(tuple(batch.imports[n]) for n in inputs),
            deliver,
            *(finished[n] for n in inputs),
        )
        after(batch, result)
        for number in inputs:
            readers[number] -= 1
            if not readers[number]:
                del finished[number]
        if readers[batch.number]:
            finished[batch.number] = result
