"""Order jobs so that each runs soon after its inputs: few results are held in memory and caches stay warm."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Key = TypeVar("Key", bound=Hashable)


def depth_first(keys: Iterable[Key], needs: Callable[[Key], Iterable[Key]]) -> list[Key]:
    """Return keys in an order in which each key follows all keys that it needs, and a chain is finished before its
    sibling starts."""
    every = list(keys)
    number = {key: n for n, key in enumerate(every)}
    return [every[n] for n in Needs(len(every), lambda n: [number[key] for key in needs(every[n])]).depth_first()]


class Needs:
    """The numbers that each number below ``count`` needs, computed once; they take 12 bytes per number and need."""

    def __init__(self, count: int, needs: Callable[[int], Iterable[int]]) -> None:
        self.count, self.first, self.needed = count, array("i", bytes(4 * (count + 1))), array("i")
        for n in range(count):
            self.needed.extend(needs(n))
            self.first[n + 1] = len(self.needed)

    def of(self, number: int) -> array[int]:
        """Return the numbers that a number needs, in the order in which they were given."""
        return self.needed[self.first[number] : self.first[number + 1]]

    def depth_first(self) -> array[int]:
        """Return all numbers in an order in which each follows all numbers that it needs, and a chain is finished
        before its sibling starts."""
        waiting = array("i", self._counts().tobytes())
        behind, first = self._readers()
        order, ready = array("i"), array("i", [n for n in reversed(range(self.count)) if not waiting[n]])
        while ready:
            n = ready.pop()
            order.append(n)
            for reader in reversed(behind[first[n] : first[n + 1]]):
                waiting[reader] -= 1
                if not waiting[reader]:
                    ready.append(reader)
        return order

    def _counts(self) -> NDArray[np.int32]:
        first = np.frombuffer(self.first, np.int32)
        return first[1:] - first[:-1]

    def _readers(self) -> tuple[array[int], array[int]]:
        """Return the readers of all numbers, concatenated, and the offset at which the readers of each number begin."""
        behind, first = array("i"), array("i", bytes(4 * (self.count + 1)))
        if self.needed:
            by = np.frombuffer(self.needed, np.int32)
            readers = np.repeat(np.arange(self.count, dtype=np.int32), self._counts())
            behind.frombytes(readers[np.argsort(by, kind="stable")].tobytes())
            np.cumsum(np.bincount(by, minlength=self.count), out=np.frombuffer(first, np.int32)[1:])
        return behind, first
