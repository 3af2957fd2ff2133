"""Remembering by identity: what is found for an object once, however many cells have the object.

Stages and grids of a plan are shared by most of its cells, and comparing or hashing one costs as much as what is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Found = TypeVar("Found")


class Once(Generic[Found]):
    """Results by the identity of objects and the value of ``also``.

    It holds the objects: as long as it lives no other object can take the number of one of them.
    """

    def __init__(self) -> None:
        self._found: dict[tuple[Hashable, ...], tuple[Found, tuple[object, ...]]] = {}

    def __call__(self, objects: tuple[object, ...], find: Callable[[], Found], *also: Hashable | type) -> Found:
        place = *map(id, objects), *also
        known = self._found.get(place)
        if known is None:
            known = self._found[place] = find(), objects
        return known[0]

    def values(self) -> list[Found]:
        return [found for found, _ in self._found.values()]
