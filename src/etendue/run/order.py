"""An order in which everything stands soon behind what it reads, so that little is held and caches stay warm."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

import numpy as np

Key = TypeVar("Key", bound=Hashable)


def depth_first(keys: Iterable[Key], needs: Callable[[Key], Iterable[Key]]) -> list[Key]:
    """Keys so ordered that each stands behind all it needs, and a chain is finished before its sibling is begun."""
    every = list(keys)
    number = {key: n for n, key in enumerate(every)}
    return [every[n] for n in numbers_depth_first(len(every), lambda n: [number[key] for key in needs(every[n])])]


def numbers_depth_first(count: int, needs: Callable[[int], Iterable[int]]) -> array[int]:
    """The same of numbers below ``count``: 20 bytes for each of them and each of its needs."""
    waiting, needed, readers = array("i", bytes(4 * count)), array("i"), array("i")
    for n in range(count):
        others = set(needs(n))
        waiting[n] = len(others)
        for other in others:
            needed.append(other)
            readers.append(n)
    behind, first = _by_needed(needed, readers, count)
    order, ready = array("i"), array("i", [n for n in reversed(range(count)) if not waiting[n]])
    while ready:
        n = ready.pop()
        order.append(n)
        for reader in reversed(behind[first[n] : first[n + 1]]):
            waiting[reader] -= 1
            if not waiting[reader]:
                ready.append(reader)
    return order


def _by_needed(needed: array[int], readers: array[int], count: int) -> tuple[array[int], array[int]]:
    """Who needs each number, one behind the other, and where those of each begin."""
    by = np.frombuffer(needed, np.int32) if needed else np.zeros(0, np.int32)
    behind, first = array("i"), array("i", bytes(4 * (count + 1)))
    if needed:
        behind.frombytes(np.frombuffer(readers, np.int32)[np.argsort(by, kind="stable")].tobytes())
        np.cumsum(np.bincount(by, minlength=count), out=np.frombuffer(first, np.int32)[1:])
    return behind, first
