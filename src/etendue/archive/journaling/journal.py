"""The journal: the only record of the finished cells.

One JSON line per event, appended only by the owner of the archive. A cell is finished if its **last** line is ``done``
with the wanted key, and its chunks are where the lines say, with the recorded size. Each line ends with its checksum;
lines with a wrong checksum, and an incomplete last line, are ignored. The existence of a file proves nothing. A
``done`` line names the part file to which each chunk was appended; a ``shard`` line lists the byte ranges of the parts
that a shard holds. The journal also holds, for each group, the axis values (a coordinate array damaged by a kill is
rewritten from them), the arrays created and how each is split into shards, and the variables without an array with the
arrays they equal; for each run, its record and the number of cells to compute. ``closed`` says that a run ended
normally: the data of earlier lines need not be read back. ``outdated`` names the cells that a run is about to replace:
their chunks remain until they are replaced, but readers do not see them.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Mapping, MutableMapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import msgspec

from etendue import plain_files
from etendue.archive.journaling import index
from etendue.archive.journaling.entries import Entries, Entry
from etendue.archive.journaling.line_forms import (
    FIELDS,
    Going,
    axis_of,
    block_of,
    decode_of_a_cell,
    files_of,
    inside,
    kept_of,
    leads_out,
    of_kind,
    same_of,
    summed,
    written,
)
from etendue.archive.records import disk
from etendue.archive.records.names import STATUS
from etendue.archive.sharding.shards import Shard
from etendue.types.documents import Document, DocumentView

if TYPE_CHECKING:
    from etendue.types.documents import AxisValue

LONGEST_LINE = 32 << 20  # bytes; the longest, a run record with axes of 100,000 values, has a few megabytes
# Errors of a damaged line; in older versions of msgspec, decoding errors are not ``ValueError``.
UNFIT = (msgspec.DecodeError, KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError)
SUM = 18  # characters of ',"sum":"01234567"}'


@dataclass
class Read:
    """The content of a journal."""

    entries: MutableMapping[str, Entry] = field(default_factory=Entries)
    axes: dict[str, dict[str, list[AxisValue]]] = field(default_factory=dict)
    arrays: dict[str, set[str]] = field(default_factory=dict)  # by group: the names of all arrays ever made in it
    # by group and variable: how it is split and encoded
    blocks: dict[str, dict[str, Document]] = field(default_factory=dict)
    # by group and variable without an array, because it is left out in all cells: the path of the array it equals
    same: dict[str, dict[str, str]] = field(default_factory=dict)
    # by path below the archive, as they were put in their places
    shards: dict[str, Shard] = field(default_factory=dict)
    records: dict[str, str] = field(default_factory=dict)  # by path below the archive: the text of each run's record
    run: Going | None = None
    damaged: int = 0  # invalid lines
    torn: bool = False  # an incomplete line follows the last complete one
    files_a_cell: int = 0  # chunks in the previous format, with one file each
    outdated: set[str] = field(default_factory=set)  # done cells that the last run was about to replace

    @property
    def said(self) -> Entries:
        assert isinstance(self.entries, Entries)
        return self.entries

    def close(self) -> None:
        """Mark all entries as confirmed: a run ended normally, so no data has to be read back."""
        self.said.close()
        self.shards = {path: replace(one, fresh=False) if one.fresh else one for path, one in self.shards.items()}


class Journal:
    """Append-only lines of one archive. Nothing is written before ``open``."""

    def __init__(self, root: Path, durable: bool = False) -> None:
        self.root, self.durable = root, durable
        self.encoder = msgspec.json.Encoder()
        found = read(root / NAME)
        self.entries, self.axes, self.arrays, self.run = found.said, found.axes, found.arrays, found.run
        self.blocks, self.same, self.shards = found.blocks, found.same, found.shards
        self.records, self.outdated = found.records, found.outdated
        self.damaged, self.torn, self.files_a_cell = found.damaged, found.torn, found.files_a_cell
        self.handle: int | None = None

    def open(self) -> None:
        """Start writing after the last complete line; damaged lines are dropped."""
        if self.damaged:
            lines = (self.root / NAME).read_bytes().split(b"\n")[:-1]
            disk.write(self.root, NAME, b"".join(line + b"\n" for line in lines if _says_something(line)), self.durable)
        self.handle = disk.append_to(self.root, NAME)
        data = (self.root / NAME).read_bytes()
        whole = data.rfind(b"\n") + 1
        # Otherwise the next line would be appended to the incomplete one, and both would fail their checksum.
        if whole != len(data):
            os.ftruncate(self.handle, whole)

    def _append(self, lines: Iterable[Document]) -> None:
        data = b"".join(summed(self.encoder.encode(line)) + b"\n" for line in lines)
        if data:
            assert self.handle is not None
            before = os.fstat(self.handle).st_size
            try:
                disk.write_all(self.handle, data)
            except OSError:
                # A full disk may leave half a line, to which the next line would be appended.
                os.ftruncate(self.handle, before)
                raise
            if self.durable:
                os.fsync(self.handle)

    def start(self, cells: Iterable[tuple[str, str]]) -> None:
        """Record that the chunks of these cells, given as (name, key), may be overwritten from now on."""
        pairs = list(cells)
        self._append({"event": "start", "cell": cell, "key": key} for cell, key in pairs)
        for cell, key in pairs:
            if cell in self.entries:  # other cells have no earlier result to invalidate
                self.entries[cell] = Entry("start", key)
            self.outdated.discard(cell)

    def end(self, cells: Iterable[tuple[str, Entry]], remember: bool = True) -> None:
        """Record that these cells are done (or failed) and their chunks written. ``remember``: also update
        ``entries``.
        """
        pairs = list(cells)
        self._append(
            {
                "event": entry.event,
                "cell": cell,
                "key": entry.key,
                "status": entry.status,
                "seconds": entry.seconds,
                "clipped": entry.clipped,
                "clipped_flux": entry.clipped_flux,
                "floored": entry.floored,
                **({"platform": entry.platform} if entry.platform else {}),
                "files": [[f.path, f.slot, f.part, f.offset, f.size, f.digest] for f in entry.files],
            }
            for cell, entry in pairs
        )
        for cell, entry in pairs:
            if remember:
                self.entries[cell] = entry
            self.outdated.discard(cell)

    def give_up(self, cells: Iterable[str]) -> None:
        """Record that cells are no longer stored."""
        self.end((name, Entry("removed", self.entries[name].key, (), "not_computed")) for name in cells)

    def set_outdated(self, cells: Iterable[str]) -> None:
        """Record the done cells that this run is about to replace; the list replaces the previous list."""
        names = set(cells)
        if names != self.outdated:
            self._append([{"event": "outdated", "cells": sorted(names)}])
            self.outdated = names

    def set_axes(self, axes: Mapping[str, Mapping[str, list[AxisValue]]]) -> None:
        """Record the axis values of the arrays of each group, in stored order, before any array changes."""
        changed = {group: dict(values) for group, values in axes.items() if self.axes.get(group) != values}
        self._append(
            {
                "event": "axes",
                "group": group,
                "axes": {dim: [written(v) for v in values] for dim, values in own.items()},
            }
            for group, own in changed.items()
        )
        self.axes.update(changed)

    def forget_axes(self, groups: Iterable[str]) -> None:
        """Record that these groups have been removed."""
        gone = [group for group in groups if group in self.axes]
        self._append({"event": "axes", "group": group, "axes": None} for group in gone)
        for group in gone:
            del self.axes[group]

    def set_arrays(self, arrays: Mapping[str, Iterable[str]]) -> None:
        """Record the arrays of each group before they are created; arrays that are recorded are not foreign."""
        fresh = {group: set(names) | self.arrays.get(group, set()) for group, names in arrays.items()}
        fresh = {group: names for group, names in fresh.items() if names != self.arrays.get(group)}
        self._append({"event": "arrays", "group": group, "names": sorted(names)} for group, names in fresh.items())
        self.arrays.update(fresh)

    def set_blocks(self, blocks: Mapping[str, Mapping[str, Document]]) -> None:
        """Record how each variable is split into shards, before any shard is created; growing axes keep the split."""
        changed = {
            group: {name: dict(one) for name, one in own.items()}
            for group, own in blocks.items()
            if self.blocks.get(group) != own
        }
        self._append({"event": "blocks", "group": group, "blocks": own} for group, own in changed.items())
        self.blocks.update(changed)

    def set_same(self, same: Mapping[str, Mapping[str, str]]) -> None:
        """Record the variables of each group without an array, and the arrays that they equal."""
        every = {group: dict(same.get(group, {})) for group in sorted({*self.same, *same})}
        changed = {group: own for group, own in every.items() if self.same.get(group, {}) != own}
        self._append({"event": "same", "group": group, "same": own} for group, own in changed.items())
        self.same = every

    def put(self, shards: Mapping[str, Shard]) -> None:
        """Record that these shards are in their places."""
        self._append(
            {"event": "shard", "path": path, "size": one.size, "kept": one.kept} for path, one in shards.items()
        )
        self.shards.update(shards)

    def record(self, path: str, text: str) -> None:
        """Store a second copy of a run record, because no other data can replace a lost record."""
        self._append([{"event": "record", "path": path, "text": text}])

    def closed(self) -> None:
        """Record that a run ended normally."""
        self._append([{"event": "closed"}])

    def begins(self, planned: Mapping[str, int], todo: Mapping[str, int]) -> bool:
        """Return True if a run has to be recorded; False if it repeats the last run and computes nothing."""
        return bool(todo) or self.run is None or self.run.planned != planned

    def begin_run(self, planned: Mapping[str, int], todo: Mapping[str, int]) -> None:
        """Record, by stage, the number of cells that a run requests and the number that it has to compute."""
        if self.begins(planned, todo):
            self._append([{"event": "run", "planned": dict(planned), "todo": dict(todo)}])
            self.run = Going(dict(planned), dict(todo))

    def close(self) -> None:
        if self.handle is not None:
            os.close(self.handle)
            self.handle = None


NAME = "journal.jsonl"


def read(path: Path) -> Read:
    """Return the latest state of every cell, group and run. Incomplete and foreign lines count as absent."""
    try:
        file = plain_files.open_plain(path, links=False)
    except FileNotFoundError:
        return Read()
    with file:
        found, others, digest = _begun(path, file)
        length = before = file.tell()
        for line in iter(partial(file.readline, LONGEST_LINE), b""):
            if len(line) == LONGEST_LINE:  # no run writes such a line; nothing after it is read
                found.damaged += 1
                break
            if not line.endswith(b"\n"):  # an incomplete last line
                found.torn = True
                break
            length += len(line)
            digest.update(line)
            if not _take_own(found, line[:-1]):
                try:
                    _take(found, _checked(line[:-1]))
                    others.append(line[:-1])
                except UNFIT:
                    found.damaged += 1
        if length - before > index.SMALLEST and not (found.damaged or found.files_a_cell):
            ended = found.run.ended if found.run is not None else set()
            one = index.index_of(found.said, ended, found.outdated, others)
            index.keep(path, length, digest.digest(), one)
    return found


def _begun(path: Path, file: BinaryIO) -> tuple[Read, list[bytes], index.Digest]:
    """Return the cached content of the first lines of a journal, the lines among them that are not about cells, and the
    digest of their bytes. All three are empty if the cache has no entry for exactly these bytes.
    """
    known, digest = index.known(path, file, os.fstat(file.fileno()).st_size)
    if known is not None:
        try:
            entries, found = index.entries_of(known), Read()
            for line in known.lines:
                _take(found, _checked(line))
            names = list(entries.rows)
            if found.run is not None:
                found.run.ended = set(names if known.ended is None else [names[row] for row in known.ended])
            found.entries, found.outdated = entries, set(known.outdated)
            return found, known.lines, digest
        except (*UNFIT, IndexError):
            file.seek(0)
    return Read(), [], index.fresh_digest()


def _take_own(found: Read, line: bytes) -> bool:
    """Process a line about a cell if its checksum is correct, decoding it in one step; return False for any
    other line.
    """
    if line[-SUM:-10] != b',"sum":"' or b"%08x" % zlib.crc32(b"}", zlib.crc32(memoryview(line)[:-SUM])) != line[-10:-2]:
        return False
    try:
        one = decode_of_a_cell(line)
    except msgspec.DecodeError:
        return False
    said = found.said
    # A path that leads out of the archive makes the line invalid. Paths seen before were checked already: there are few
    # paths, but as many lines as cells.
    if any(text not in said.files.number and leads_out(text) for file in one.files for text in (file[0], file[2])):
        return False
    found.outdated.discard(one.cell)
    row = said.say(one.cell, one.event, one.key, one.status, one.seconds, True)
    said.add_rest(row, one.clipped, one.clipped_flux, one.floored, one.platform)
    for file in one.files:
        said.files.add(*file)
    said.count[row] = len(one.files)
    if found.run is not None and one.event in ("done", "failed"):
        found.run.ended.add(one.cell)
    return True


def _says_something(line: bytes) -> bool:
    try:
        _take(Read(), _checked(line))
    except UNFIT:
        return False
    return True


def _checked(line: bytes) -> Document:
    """Return a line as a document.

    Raises
    ------
    ValueError, msgspec.DecodeError
        The line is not a JSON object, or its checksum does not match.
    """
    value = msgspec.json.decode(line)
    if not isinstance(value, dict):
        raise ValueError("not a JSON object")
    checksum = value.pop("sum", None)
    if checksum is not None:
        fresh = line[:-SUM] + b"}", msgspec.json.encode(value)  # as written, or reformatted by somebody
        if all(checksum != f"{zlib.crc32(one):08x}" for one in fresh):
            raise ValueError("the line does not match its checksum")
    return value


def _take(found: Read, value: DocumentView) -> None:
    """Process one line; raise ``ValueError`` or ``TypeError`` if it does not have the form of its event."""
    event = value["event"]
    if not set(value) <= FIELDS[event]:
        raise ValueError("unknown keys")
    if event == "axes":
        group, axes = inside(value["group"]), value["axes"]
        if axes is None:
            found.axes.pop(group, None)
        else:
            found.axes[group] = {of_kind(str, dim): axis_of(of_kind(list, values)) for dim, values in axes.items()}
    elif event == "arrays":
        found.arrays.setdefault(inside(value["group"]), set()).update(
            inside(name) for name in of_kind(list, value["names"])
        )
    elif event == "run":
        planned, todo = (
            {of_kind(str, k): of_kind(int, n) for k, n in value[name].items()} for name in ("planned", "todo")
        )
        found.run = Going(planned, todo)
    elif event == "blocks":
        found.blocks[inside(value["group"])] = {inside(name): block_of(one) for name, one in value["blocks"].items()}
    elif event == "same":
        found.same[inside(value["group"])] = same_of(value["same"])
    elif event == "shard":
        found.shards[inside(value["path"])] = Shard(of_kind(int, value["size"]), kept_of(value["kept"]), True)
    elif event == "record":
        found.records[inside(value["path"])] = of_kind(str, value["text"])
    elif event == "closed":
        found.close()
    elif event == "outdated":
        found.outdated = {of_kind(str, name) for name in of_kind(list, value["cells"])}
    else:
        _take_of_a_cell(found, value)


def _take_of_a_cell(found: Read, value: DocumentView) -> None:
    """Process a line about a cell, in the form of this or any earlier version."""
    files, a_cell = files_of(value.get("files", ()))
    event, status = value["event"], value.get("status", "done")
    if status not in STATUS:
        raise ValueError(f"unknown status {status!r}")
    words = ("seconds", "clipped", "clipped_flux", "floored")
    numbers = {name: float(of_kind((int, float), value.get(name, 0.0))) for name in words}
    cell, key = of_kind(str, value["cell"]), of_kind(str, value["key"])
    platform = of_kind(str, value.get("platform", ""))
    found.entries[cell] = Entry(event, key, files, status, **numbers, platform=platform, fresh=True)
    found.files_a_cell += a_cell
    found.outdated.discard(cell)
    if found.run is not None and event in ("done", "failed"):
        found.run.ended.add(cell)


def is_done(entry: Entry | None, key: str) -> bool:
    """Return True if the latest state of a cell is done, with this key."""
    return entry is not None and entry.event == "done" and entry.key == key
