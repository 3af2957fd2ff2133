"""Results of cells in memory, by their keys: the least recently used results are dropped when a bound in bytes is
reached.

In:  arrays of computed cells and their reports.
Out: the same arrays and reports for any later cell with an equal key. Equal keys mean equal bits.
"""

from __future__ import annotations

import threading
from collections import ChainMap, OrderedDict
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from etendue.contract.ports import CellReport

if TYPE_CHECKING:
    from etendue.evaluation.archived import ArchivedResults
    from etendue.types.arrays import Array

BESIDE = 1024  # bytes of a cell beside its arrays: its key, its report, and what holds them


class Entry(NamedTuple):
    """The kept results of a cell."""

    report: CellReport
    arrays: Mapping[str, Array]
    size: int


class Results:
    """A store of results that later evaluations may read, from any thread.

    Attributes
    ----------
    most : largest number of bytes that the store holds
    bytes : bytes of all results that it holds now
    behind : an archive; results that are not in memory are read from it
    """

    def __init__(self, most: int, behind: ArchivedResults | None = None) -> None:
        self.most, self.bytes, self.behind = most, 0, behind
        self._lock = threading.Lock()
        self._entries: OrderedDict[str, Entry] = OrderedDict()

    def __len__(self) -> int:
        return len(self._entries)

    def seen(self, key: str) -> Entry | None:
        """Return the result kept under a key, without counting it as used."""
        held = self._entries.get(key)
        stored = self.behind.of(key) if self.behind is not None else None
        if stored is None:
            return held
        report, arrays = stored
        return Entry(report, arrays, 0) if held is None else held._replace(arrays=ChainMap(held.arrays, arrays))  # type: ignore[arg-type]

    def used(self, key: str, report: CellReport, arrays: Mapping[str, Array]) -> None:
        """Mark arrays of a cell as used now; store them again if they come from the archive or were dropped."""
        with self._lock:
            own = self._entries.get(key)
            if own is not None and arrays.keys() <= own.arrays.keys():
                self._entries.move_to_end(key)
                return
        self.put(key, report, arrays)

    def put(self, key: str, report: CellReport, arrays: Mapping[str, Any]) -> None:
        """Keep arrays of a cell in addition to arrays that are already kept."""
        own = {name: _alone(array) for name, array in arrays.items()}
        with self._lock:
            before = self._entries.pop(key, None)
            self.bytes -= before.size if before else 0
            own = {**(before.arrays if before else {}), **own}
            size = BESIDE + sum(array.nbytes for array in own.values())
            if size > self.most:
                return
            while self.bytes + size > self.most:
                self.bytes -= self._entries.popitem(last=False)[1].size
            self._entries[key] = Entry(report, own, size)
            self.bytes += size

    def clear(self, most: int | None = None) -> None:
        """Drop everything; ``most``: the new bound in bytes."""
        with self._lock:
            self._entries.clear()
            self.bytes = 0
            self.most = self.most if most is None else most


def _alone(array: Array) -> Array:
    """Return the array as read-only; copy it if it is writeable or a view that keeps a larger array in memory."""
    whole = array.base
    alone = whole is None or (isinstance(whole, np.ndarray) and whole.nbytes <= array.nbytes)
    if array.flags.writeable or not alone:
        array = array.copy()
        array.setflags(write=False)
    return array
