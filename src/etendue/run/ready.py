"""The order of batches: a chain of large arrays is read before the next chain starts, so that few large arrays are
held.

In:  batches, and the number of workers.
Out: for a run, the batches that are held back until certain other batches have ended; for the plan, a simulation: the
     next batch that may begin, and the results that batches still wait for.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Set
from typing import Generic, TypeVar

from etendue.run.batches import Batch
from etendue.run.order import depth_first

LARGE = 16 << 20  # bytes of an array, in single precision, that is not made for many chains at once
Kept = TypeVar("Kept")


class Ready(Generic[Kept]):
    """The remaining batches, in order, and the results that they wait for.

    A batch opens a chain if it passes on a large array and is not the last reader of a result. The number of such
    batches that run at once is at most half the number of workers, and at least one: open chains are continued before
    new chains are opened.
    """

    def __init__(self, batches: Iterable[Batch], workers: int) -> None:
        self.batches = {batch.number: batch for batch in batches}
        self.large: dict[str, bool] = {}  # by stage
        self.opening, self.most = set[int](), max(workers // 2, 1)
        order = depth_first(self.batches, lambda n: self.batches[n].inputs)
        self.place = {number: place for place, number in enumerate(order)}
        self.waiting = {number: len(batch.inputs) for number, batch in self.batches.items()}
        self.readers: dict[int, list[int]] = {number: [] for number in self.batches}
        for number, batch in self.batches.items():
            for source in batch.inputs:
                self.readers[source].append(number)
        self.left = {number: len(readers) for number, readers in self.readers.items()}
        self.results: dict[int, Kept] = {}
        self.heap = [(self.place[number], number) for number, count in self.waiting.items() if not count]
        heapq.heapify(self.heap)

    def next(self) -> Batch | None:
        """Return the next batch that may begin; None if no batch may begin yet."""
        later, found = [], None
        while self.heap and found is None:
            one = heapq.heappop(self.heap)
            batch = self.batches[one[1]]
            if not self.opens(batch):
                found = batch
            elif len(self.opening) < self.most:
                self.opening.add(batch.number)
                found = batch
            else:
                later.append(one)
        for one in later:
            heapq.heappush(self.heap, one)
        return found

    def held_back(self) -> dict[int, list[int]]:
        """Return, for each batch that opens a chain, the batches that have to end before it may begin: all batches that
        read large arrays of a preceding chain, unless that chain may be open at the same time.
        """
        opening = self.openings()
        others, found, left = frozenset(opening), dict[int, list[int]](), set[int]()
        for earlier, now in zip(opening, opening[self.most :], strict=False):
            left |= self._chain(earlier, others)
            found[now] = sorted(number for number in left if self.place[number] < self.place[now])
            left.difference_update(found[now])  # others wait for these through this one
        return found

    def openings(self) -> list[int]:
        """Return the batches that open a chain if batches end in order."""
        last = {source: max(readers, key=self.place.__getitem__) for source, readers in self.readers.items() if readers}
        return [
            number
            for number in sorted(self.batches, key=self.place.__getitem__)
            if self._is_large(self.batches[number])
            and all(last[source] != number for source in self.batches[number].inputs)
        ]

    def _chain(self, opening: int, others: Set[int]) -> set[int]:
        """Return the batches that read the large arrays of a chain, without batches that open other chains."""
        found, left = set[int](), [opening]
        while left:
            for number in self.readers[left.pop()]:
                if number not in found and number not in others:
                    found.add(number)
                    if self._is_large(self.batches[number]):
                        left.append(number)
        return found

    def opens(self, batch: Batch) -> bool:
        return not any(self.left[source] == 1 for source in batch.inputs) and self._is_large(batch)

    def _is_large(self, batch: Batch) -> bool:
        for ref in batch.exports:
            if ref[0] not in self.large:
                self.large[ref[0]] = any(4 * grid.count >= LARGE for grid in batch.of[ref].grids.values())
        return any(self.large[ref[0]] for ref in batch.exports)

    def ended(self, batch: Batch, result: Kept) -> None:
        """Drop results of which this batch was the last reader, and keep the result of this batch if other batches read
        it.
        """
        self.opening.discard(batch.number)
        for source in batch.inputs:
            self.left[source] -= 1
            if not self.left[source]:
                del self.results[source]
        if self.readers[batch.number]:
            self.results[batch.number] = result
        for number in self.readers[batch.number]:
            self.waiting[number] -= 1
            if not self.waiting[number]:
                heapq.heappush(self.heap, (self.place[number], number))
