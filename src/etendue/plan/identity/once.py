"""Cache results by object identity: each result is computed once per object, even if many cells share the object.

Most cells of a plan share stages and grids; comparing or hashing one would cost as much as computing the result.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Generic, TypeVar

Found = TypeVar("Found")


class Once(Generic[Found]):
    """Results by the identity of objects and the value of ``also``.

    The cache keeps references to the objects, so that their ids cannot be reused while it exists.
    """

    def __init__(self) -> None:
        self._found: dict[tuple[Hashable, ...], tuple[Found, Sequence[object]]] = {}

    def __call__(self, objects: tuple[object, ...], find: Callable[[], Found], *also: Hashable | type) -> Found:
        place = *map(id, objects), *also
        known = self._found.get(place)
        if known is None:
            known = self._found[place] = find(), objects
        return known[0]

    def get(self, objects: Sequence[object], *also: Hashable | type) -> Found | None:
        """Return the cached result for these objects; None if there is none."""
        known = self._found.get((*map(id, objects), *also))
        return None if known is None else known[0]

    def put(self, found: Found, objects: Sequence[object], *also: Hashable | type) -> None:
        self._found[*map(id, objects), *also] = found, objects

    def values(self) -> list[Found]:
        return [found for found, _ in self._found.values()]
