"""The latest state of every cell of an archive, in columns: about 100 bytes per cell plus its name, instead of a
thousand bytes as objects.

In:  the lines of a journal, one after the other.
Out: an ``Entry`` by name of a cell, created on demand.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, MutableMapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from etendue.archive.records.names import STATUS
from etendue.contract.ports import CellReport, WrittenChunk
from etendue.types.arrays import Array

if TYPE_CHECKING:
    from etendue.plan.model import CellRef

EVENTS = ("start", "done", "failed", "removed")
KEY = 16  # bytes of a key
_EVENT = {event: number for number, event in enumerate(EVENTS)}
_STATUS = {status: number for number, status in enumerate(STATUS)}


@dataclass(frozen=True, slots=True)
class Entry:
    """The latest state of one cell."""

    event: str  # start | done | failed | removed
    key: str
    files: tuple[WrittenChunk, ...] = ()
    status: str = "done"
    seconds: float = 0.0
    clipped: float = 0.0
    clipped_flux: float = 0.0
    floored: float = 0.0
    platform: str = ""  # the earlier platform on which it was computed, if that result was accepted
    fresh: bool = False  # written since the last run that ended in order


class WrittenChunks:
    """The written chunks of an archive as columns; the number of a chunk is its row."""

    def __init__(self) -> None:
        self.texts: list[str] = []  # paths and names of parts: there are few
        self.number: dict[str, int] = {}
        self.path, self.part, self.slot = array("i"), array("i"), array("q")
        self.offset, self.size, self.digest = array("q"), array("q"), array("q")

    def __len__(self) -> int:
        return len(self.path)

    def add(self, path: str, slot: int, part: str, offset: int, size: int, digest: int) -> None:
        self.path.append(self._of(path))
        self.part.append(self._of(part))
        self.slot.append(slot)
        self.offset.append(offset)
        self.size.append(size)
        self.digest.append(digest)

    def add_of(self, other: WrittenChunks, numbers: Array) -> None:
        """Add the chunks of another collection that have these numbers."""
        for name in ("path", "part"):
            texts, which = np.unique(np.asarray(vars(other)[name])[numbers], return_inverse=True)
            own = np.array([self._of(other.texts[text]) for text in texts.tolist()], np.int32)
            vars(self)[name].frombytes(own[which].tobytes())
        for name in ("slot", "offset", "size", "digest"):
            vars(self)[name].frombytes(np.asarray(vars(other)[name])[numbers].tobytes())

    def _of(self, text: str) -> int:
        known = self.number.get(text)
        if known is None:
            known = self.number[text] = len(self.texts)
            self.texts.append(text)
        return known

    def __getitem__(self, number: int) -> WrittenChunk:
        texts = self.texts
        return WrittenChunk(
            texts[self.path[number]],
            self.slot[number],
            texts[self.part[number]],
            self.offset[number],
            self.size[number],
            self.digest[number],
        )


class Entries(MutableMapping[str, Entry]):
    """The latest entry of each name. ``close`` clears the ``fresh`` mark of all entries."""

    def __init__(self) -> None:
        self.rows: dict[str, int] = {}
        self.event, self.status, self.fresh, self.key = bytearray(), bytearray(), bytearray(), bytearray()
        self.seconds, self.first, self.count = array("d"), array("q"), array("i")
        self.files = WrittenChunks()
        self.odd_keys: dict[int, str] = {}  # keys that are not digests
        self.rest: dict[
            int, tuple[float, float, float, str]
        ] = {}  # clipped, clipped_flux, floored, platform: few cells have any of them

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self.rows

    def __getitem__(self, name: str) -> Entry:
        row = self.rows[name]
        clipped, flux, floored, platform = self.rest.get(row, (0.0, 0.0, 0.0, ""))
        return Entry(
            EVENTS[self.event[row]],
            self.key_at(row),
            tuple(self.written(row)),
            STATUS[self.status[row]],
            self.seconds[row],
            clipped,
            flux,
            floored,
            platform,
            bool(self.fresh[row]),
        )

    def __setitem__(self, name: str, entry: Entry) -> None:
        row = self.say(name, entry.event, entry.key, entry.status, entry.seconds, entry.fresh)
        self.add_rest(row, entry.clipped, entry.clipped_flux, entry.floored, entry.platform)
        for one in entry.files:
            self.files.add(one.path, one.slot, one.part, one.offset, one.size, one.digest)
        self.count[row] = len(entry.files)

    def __delitem__(self, name: str) -> None:
        del self.rows[name]

    def say(self, name: str, event: str, key: str, status: str, seconds: float, fresh: bool) -> int:
        """Set the latest state of a cell, and return its row. The caller must add the chunks of the cell immediately
        afterwards.
        """
        digest = _digest(key)
        row = self.rows.get(name)
        if row is None:
            row = self.rows[name] = len(self.event)
            self.event.append(0)
            self.status.append(0)
            self.fresh.append(0)
            self.key += bytes(KEY)
            self.seconds.append(0.0)
            self.first.append(0)
            self.count.append(0)
        self.event[row], self.status[row], self.fresh[row] = _EVENT[event], _STATUS[status], fresh
        self.seconds[row], self.first[row], self.count[row] = seconds, len(self.files), 0
        self.rest.pop(row, None)
        self.odd_keys.pop(row, None)
        if digest is None:
            self.odd_keys[row] = key
        else:
            self.key[KEY * row : KEY * (row + 1)] = digest
        return row

    def add_rest(self, row: int, clipped: float, clipped_flux: float, floored: float, platform: str) -> None:
        if clipped or clipped_flux or floored or platform:
            self.rest[row] = clipped, clipped_flux, floored, platform

    def close(self) -> None:
        """Mark all entries as confirmed: the run ended normally, so no data has to be read back."""
        self.fresh = bytearray(len(self.fresh))

    def key_at(self, row: int) -> str:
        return self.odd_keys[row] if row in self.odd_keys else self.key[KEY * row : KEY * (row + 1)].hex()

    def written(self, row: int) -> Iterator[WrittenChunk]:
        return map(self.files.__getitem__, self._numbers(row))

    def standing(self, name: str, key: str) -> str:
        """Return the status of a cell if it has this key; '' if the cell is being recomputed, has another key or is
        unknown.
        """
        row = self.rows.get(name)
        if row is None or self.event[row] == _EVENT["start"] or self.key_at(row) != key:
            return ""
        return STATUS[self.status[row]]

    def first_file(self, name: str) -> str:
        """Return the shard that contains the first chunk of a cell; '' if no chunk is stored."""
        row = self.rows.get(name)
        return "" if row is None or not self.count[row] else self.files.texts[self.files.path[self.first[row]]]

    def took(self, name: str) -> float:
        """Return the run time of a cell (s); 0 if unknown."""
        row = self.rows.get(name)
        return 0.0 if row is None else self.seconds[row]

    def report(self, ref: CellRef, row: int, size: int) -> CellReport:
        """Return the report of a finished cell; ``size``: its stored bytes."""
        clipped, flux, floored, platform = self.rest.get(row, (0.0, 0.0, 0.0, ""))
        status, seconds = STATUS[self.status[row]], self.seconds[row]
        return CellReport(*ref, status, seconds, (), "", clipped, flux, floored, platform, size)

    # -- all cells at once --------------------------------------------------------------------------------------------

    def any_done(self) -> bool:
        """Return True if any cell is done."""
        return next(self.done(), None) is not None

    def done(self) -> Iterator[str]:
        """Return the names of the cells that are done."""
        return self.having("done")

    def having(self, event: str) -> Iterator[str]:
        """Return the names of the cells whose latest event is ``event``."""
        number = _EVENT[event]
        return (name for name, row in self.rows.items() if self.event[row] == number)

    def told(self) -> Iterator[tuple[str, str, str, float, float]]:
        """Yield name, event, status, run time (s) and clipped fraction of every cell, without objects for chunks."""
        for name, row in self.rows.items():
            clipped = self.rest[row][0] if row in self.rest else 0.0
            yield name, EVENTS[self.event[row]], STATUS[self.status[row]], self.seconds[row], clipped

    def done_among(self, names: Iterable[str]) -> list[str]:
        """Return the named cells that are done."""
        return (
            [name for name in names if name in self.rows and self.event[self.rows[name]] == _EVENT["done"]]
            if self.rows
            else []
        )

    def done_otherwise(self, keys: Iterable[tuple[str, str]]) -> list[str]:
        """Return the named cells that are done, but with another key than the key given with the name."""
        return self.done_among(name for name, key in keys if name in self.rows and self.key_at(self.rows[name]) != key)

    def done_beside(self, names: Iterable[str]) -> list[str]:
        """Return the names of done cells that are not among ``names``."""
        known = set(names) if self.rows else set()
        return [name for name in self.done() if name not in known]

    def counts(self, outdated: Collection[str] = ()) -> Counter[tuple[str, str]]:
        """Return the number of cells by stage and status, where ``unfinished`` and ``outdated`` are statuses too."""
        words = [
            (event == _EVENT["start"], STATUS[status]) for event, status in zip(self.event, self.status, strict=True)
        ]
        found: Counter[tuple[str, str]] = Counter()
        for name, row in self.rows.items():
            started, status = words[row]
            found[name.partition(" ")[0], "unfinished" if started else "outdated" if name in outdated else status] += 1
        return found

    def shards(self, beside: Collection[str] = ()) -> dict[str, int]:
        """Return, for each shard that holds chunks of done cells, the number of one of these chunks; cells in
        ``beside`` are ignored.
        """
        numbers = self._of_done(beside)
        path = np.asarray(self.files.path)[numbers]
        first = sorted(np.unique(path, return_index=True)[1].tolist())
        return {self.files.texts[path[place]]: int(numbers[place]) for place in first}

    def by_shard(self, beside: Collection[str] = ()) -> dict[str, Array]:
        """Map each shard to the numbers of the chunks of done cells in it; cells in ``beside`` are ignored."""
        numbers = self._of_done(beside)
        path = np.asarray(self.files.path)[numbers]
        order = np.argsort(path, kind="stable")
        texts, first = np.unique(path[order], return_index=True)
        parts = np.split(numbers[order], first[1:])[: len(first)]
        found = sorted(zip(order[first].tolist(), texts.tolist(), parts, strict=True), key=lambda one: one[0])
        return {self.files.texts[text]: own for _, text, own in found}

    def _of_done(self, beside: Collection[str]) -> Array:
        """Return the numbers of the chunks of done cells, cell by cell."""
        rows = np.fromiter(self.rows.values(), np.int64, len(self.rows))
        done = np.frombuffer(bytes(self.event), np.uint8) == _EVENT["done"]
        done[[self.rows[name] for name in beside if name in self.rows]] = False
        rows = rows[done[rows]]
        first, count = np.array(self.first)[rows], np.array(self.count)[rows]
        return np.repeat(first - np.cumsum(count) + count, count) + np.arange(int(count.sum()))

    def rows_of_chunks(self) -> Array:
        """Return, by number of the chunk, the row of its cell; -1 if another chunk has replaced it."""
        found = np.full(len(self.files), -1)
        first, count = np.asarray(self.first), np.asarray(self.count)
        ends = np.cumsum(count)
        within = np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - count, count)
        found[np.repeat(first, count) + within] = np.repeat(np.arange(len(count)), count)
        return found

    def cell_of(self, number: int) -> str:
        """Return the cell that a chunk belongs to, by the number of the chunk; '' if another chunk has replaced it."""
        return next((name for name, row in self.rows.items() if number in self._numbers(row)), "")

    def _numbers(self, row: int) -> range:
        """Return the numbers of the chunks of a cell."""
        return range(self.first[row], self.first[row] + self.count[row])


def _digest(key: str) -> bytes | None:
    """Return a key as bytes; None if it is not a digest, as in damaged lines."""

    try:
        digest = bytes.fromhex(key)
    except ValueError:
        return None
    return digest if len(digest) == KEY and digest.hex() == key else None
