"""The reference: every batch in order, in this thread."""

from __future__ import annotations

from collections.abc import Callable

from etendue.plan.model import CellRef
from etendue.run.batches import Batch, BatchResult, run_batch


def run_serial(
    batches: list[Batch],
    deliver: frozenset[CellRef],
    before: Callable[[Batch], None],
    after: Callable[[Batch, BatchResult], None],
) -> None:
    """Run batches one after the other; ``before`` and ``after`` are told in the owner's thread."""
    finished: dict[int, BatchResult] = {}
    readers: dict[int, int] = {}
    for batch in batches:
        for number in batch.inputs:
            readers[number] = readers.get(number, 0) + 1
    for batch in depth_first(batches):
        before(batch)
        inputs = sorted(batch.imports)
        result = run_batch(
            tuple(batch.jobs), tuple(batch.exports), tuple(tuple(batch.imports[n]) for n in inputs), deliver,
            *(finished[n] for n in inputs),
        )  # fmt: skip
        after(batch, result)
        for number in inputs:
            readers[number] -= 1
            if not readers[number]:
                del finished[number]
        if readers.get(batch.number):
            finished[batch.number] = result


def depth_first(batches: list[Batch]) -> list[Batch]:
    """An order in which a batch stands soon behind what it reads, so that little is held."""
    children: dict[int, list[Batch]] = {}
    waiting = {b.number: len(b.inputs) for b in batches}
    for batch in batches:
        for number in batch.inputs:
            children.setdefault(number, []).append(batch)
    order, stack = [], [b for b in reversed(batches) if not b.inputs]
    while stack:
        batch = stack.pop()
        order.append(batch)
        for child in reversed(children.get(batch.number, [])):
            waiting[child.number] -= 1
            if not waiting[child.number]:
                stack.append(child)
    return order
