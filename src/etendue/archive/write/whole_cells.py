"""Finished cells of a plan, found for all cells of a group at once.

In:  an archive opened for a run, with the layout of a plan.
Out: by number, the cells that are done with the wanted key according to the journal, and whose chunks are where the
     journal says; the bytes of each cell.

Chunks are compared with the journal and with the index of their shard, as for single cells, but in columns; they are
entered in the shards of the run. ``ArchiveWriter.finished`` examines all other cells.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from etendue.archive.journaling.entries import EVENTS
from etendue.archive.write.store import ArchiveWriter
from etendue.types.arrays import Array


class WholeCells:
    """The cells that need no separate check.

    Attributes
    ----------
    there, bytes : by number of a cell, whether it is stored, and its size in bytes
    """

    def __init__(self, store: ArchiveWriter, asked: bool = True) -> None:
        self.store, self.laid, self.entries = store, store.laid, store.journal.entries
        count = store.plan.numbers.count
        self.there, self.bytes = np.zeros(count, bool), np.zeros(count, np.int64)
        if not asked or not self.entries.rows or store.former.keys or store.finder.linked:
            return
        self.rows = self.laid.rows(self.entries)
        event, fresh = (
            np.frombuffer(bytes(one), np.uint8)[self.rows] for one in (self.entries.event, self.entries.fresh)
        )
        self.done = self.laid.keyed(self.entries) & (event == EVENTS.index("done"))
        stored = {group.node for group in self.laid.layout.groups.values()}
        for node in store.plan.nodes:
            if node.name not in stored:
                own = store.plan.numbers.range(node.name)
                self.there[own.start : own.stop] = self.done[own.start : own.stop]
        self.done &= fresh == 0
        for path in self.laid.layout.groups:
            self._look(path)

    def _look(self, path: str) -> None:
        numbers, places = self.laid.numbered(path)
        where = [(one, piece) for one in self.laid.whereabouts[path] for piece in range(one.count)]
        rows = self.rows[numbers]
        likely = self.done[numbers] & (np.array(self.entries.count)[rows] == len(where))
        numbers, places, rows = numbers[likely], places[likely], rows[likely]
        first = np.array(self.entries.first)[rows]
        chunks = []
        for column, (place, piece) in enumerate(where):
            shards, which, slots = place.all_at(places)
            chunks.append(_Chunks(first + column, shards, which, slots + piece, place.slots))
        lies = [self._lies(one) for one in chunks]
        sure = np.logical_and.reduce([at >= 0 for at in lies]) if lies else np.ones(len(numbers), bool)
        self.there[numbers[sure]] = True
        size = np.asarray(self.entries.files.size)
        for one, at in zip(chunks, lies, strict=True):
            self.bytes[numbers[sure]] += size[one.numbers[sure]]
            for number, shard in enumerate(one.shards):
                own = sure & (one.which == number)
                if own.any():
                    contents = self.store.blocks.contents(shard, one.slots)
                    contents.add_all(self.entries.files, one.numbers[own], at[own])

    def _lies(self, one: _Chunks) -> Array:
        """Return the offset of each chunk in its shard; -1 if the chunk is not where it is expected."""
        files = self.entries.files
        slot, part, offset, size = (
            np.asarray(own)[one.numbers] for own in (files.slot, files.part, files.offset, files.size)
        )
        named = np.array([files.number.get(shard, -1) for shard in one.shards], np.int64)[one.which]
        expected = (np.asarray(files.path)[one.numbers] == named) & (slot == one.slot)
        found = np.full(len(slot), -1)
        for number, path in enumerate(one.shards):
            own = np.flatnonzero(expected & (one.which == number))
            shard = self.store.journal.shards.get(path)
            if shard is not None and not shard.fresh:
                parts = [files.texts[text] for text in part[own].tolist()]
                found[own] = self.store.finder.all_at(path, one.slots, slot[own], parts, offset[own], size[own])
        return found


class _Chunks(NamedTuple):
    """One chunk per cell, in columns: its number in the journal, and the shard and slot where it must be."""

    numbers: Array
    shards: list[str]
    which: Array  # of ``shards``, by cell
    slot: Array
    slots: int  # of a shard
