"""An order in which everything stands soon behind what it reads, so that little is held and caches stay warm."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import TypeVar

Key = TypeVar("Key", bound=Hashable)


def depth_first(keys: Iterable[Key], needs: Callable[[Key], Iterable[Key]]) -> list[Key]:
    """Keys so ordered that each stands behind all it needs, and a chain is finished before its sibling is begun."""
    waiting: dict[Key, int] = {}
    readers: dict[Key, list[Key]] = {}
    for key in keys:
        others = set(needs(key))
        waiting[key] = len(others)
        for other in others:
            readers.setdefault(other, []).append(key)
    order, ready = [], [key for key in reversed(waiting) if not waiting[key]]
    while ready:
        key = ready.pop()
        order.append(key)
        for reader in reversed(readers.pop(key, [])):
            waiting[reader] -= 1
            if not waiting[reader]:
                ready.append(reader)
    return order
