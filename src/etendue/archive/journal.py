"""The journal: what is finished, and nothing else is.

One JSON line per event, appended by the owner of the archive only. A cell is finished when its **last** line is
``done`` with the wanted key, and the files it names have the size and digest it names. A line ends in a checksum of
itself; one that does not fit it, and a torn last one, count as absent. What a file's existence suggests is never asked.
Beside the cells stand the axis values of each group (a coordinate array torn by a kill is written again from them), the
arrays that were made in each group, and how many cells each run has to compute.
"""

from __future__ import annotations

import math
import os
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from etendue.archive import disk
from etendue.archive.chunks import digest_of
from etendue.archive.layout import STATUS
from etendue.spec.ports import Written

EVENTS = ("start", "done", "failed", "removed")
UNFIT = (msgspec.DecodeError, KeyError, TypeError, ValueError, AttributeError, RecursionError)  # what reading a damaged line may raise
SUM = 18  # characters of ',"sum":"01234567"}'


@dataclass(frozen=True)
class Entry:
    """The last word on one cell."""

    event: str  # start | done | failed | removed
    key: str
    files: tuple[Written, ...] = ()
    status: str = "done"
    seconds: float = 0.0
    clipped: float = 0.0
    clipped_flux: float = 0.0
    floored: float = 0.0


@dataclass
class Going:
    """The last run: by stage how many cells it was asked for, and which it had to compute; those that have ended since."""

    planned: Mapping[str, int]
    todo: Mapping[str, int]
    ended: set[str] = field(default_factory=set)


@dataclass
class Read:
    """What a journal says."""

    entries: dict[str, Entry] = field(default_factory=dict)
    axes: dict[str, dict[str, list[Any]]] = field(default_factory=dict)
    arrays: dict[str, set[str]] = field(default_factory=dict)  # by group: the names of all arrays ever made in it
    run: Going | None = None
    damaged: int = 0  # lines that say nothing


class Journal:
    """Append-only lines of one archive. Nothing is written before ``open``."""

    def __init__(self, root: Path, durable: bool = False) -> None:
        self.root, self.durable = root, durable
        self.encoder = msgspec.json.Encoder()
        found = read(root / NAME)
        self.entries, self.axes, self.arrays, self.run, self.damaged = found.entries, found.axes, found.arrays, found.run, found.damaged
        self.handle: int | None = None

    def open(self) -> None:
        """Begin to write: behind the last whole line, damaged ones left out."""
        if self.damaged:
            lines = (self.root / NAME).read_bytes().split(b"\n")[:-1]
            disk.write(self.root, NAME, b"".join(line + b"\n" for line in lines if _says_something(line)), self.durable)
        self.handle = disk.append_to(self.root, NAME)
        data = (self.root / NAME).read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole != len(data):
            os.ftruncate(self.handle, whole)

    def _append(self, lines: Iterable[dict[str, Any]]) -> None:
        data = b"".join(summed(self.encoder.encode(line)) + b"\n" for line in lines)
        if data:
            assert self.handle is not None
            view = memoryview(data)
            while view:
                view = view[os.write(self.handle, view) :]
            if self.durable:
                os.fsync(self.handle)

    def start(self, cells: Iterable[tuple[str, str]]) -> None:
        """Say that the chunks of these (cell, key) may be overwritten from now on."""
        pairs = list(cells)
        self._append({"event": "start", "cell": cell, "key": key} for cell, key in pairs)
        for cell, key in pairs:
            self.entries[cell] = Entry("start", key)

    def end(self, cells: Iterable[tuple[str, Entry]]) -> None:
        """Say that these cells are done (or failed): their chunks stand in their places."""
        pairs = list(cells)
        self._append(
            {
                "event": entry.event, "cell": cell, "key": entry.key, "status": entry.status, "seconds": round(entry.seconds, 7),
                "clipped": entry.clipped, "clipped_flux": entry.clipped_flux, "floored": entry.floored,
                "files": [[f.path, f.size, f.digest] for f in entry.files],
            }
            for cell, entry in pairs
        )  # fmt: skip
        for cell, entry in pairs:
            self.entries[cell] = entry

    def set_axes(self, axes: Mapping[str, Mapping[str, list[Any]]]) -> None:
        """Say which axis values the arrays of each group have, in stored order, before any array changes."""
        changed = {group: dict(values) for group, values in axes.items() if self.axes.get(group) != values}
        self._append(
            {"event": "axes", "group": group, "axes": {dim: [_written(v) for v in values] for dim, values in own.items()}}
            for group, own in changed.items()
        )
        self.axes.update(changed)

    def forget_axes(self, groups: Iterable[str]) -> None:
        """Say that these groups are gone."""
        gone = [group for group in groups if group in self.axes]
        self._append({"event": "axes", "group": group, "axes": None} for group in gone)
        for group in gone:
            del self.axes[group]

    def set_arrays(self, arrays: Mapping[str, Iterable[str]]) -> None:
        """Say which arrays will be made in each group, before any is: what is named here was not put there by somebody else."""
        fresh = {group: set(names) | self.arrays.get(group, set()) for group, names in arrays.items()}
        fresh = {group: names for group, names in fresh.items() if names != self.arrays.get(group)}
        self._append({"event": "arrays", "group": group, "names": sorted(names)} for group, names in fresh.items())
        self.arrays.update(fresh)

    def begin_run(self, planned: Mapping[str, int], todo: Mapping[str, int]) -> None:
        """Say how many cells of each stage a run is asked for, and how many of them it has to compute."""
        if todo or self.run is None or self.run.planned != planned:
            self._append([{"event": "run", "planned": dict(planned), "todo": dict(todo)}])
            self.run = Going(dict(planned), dict(todo))

    def close(self) -> None:
        if self.handle is not None:
            os.close(self.handle)
            self.handle = None


NAME = "journal.jsonl"


def summed(line: bytes) -> bytes:
    """A line with its checksum at the end."""
    return line[:-1] + b',"sum":"%08x"}' % zlib.crc32(line)


def _written(value: Any) -> Any:
    """An axis value as JSON, which has no infinity."""
    return {"float": repr(value)} if isinstance(value, float) and not math.isfinite(value) else value


def _value(written: Any) -> Any:
    return float(written["float"]) if isinstance(written, dict) else written


def read_journal(path: Path) -> dict[str, Entry]:
    """The last line of every cell. A torn or foreign line counts as absent."""
    return read(path).entries


def read(path: Path) -> Read:
    """The last word on every cell, group and run."""
    found = Read()
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return found
    *lines, _ = data.split(b"\n")  # behind the last line end stands nothing, or a torn line
    for line in lines:
        try:
            _take(found, _checked(line))
        except UNFIT:
            found.damaged += 1
    return found


def _says_something(line: bytes) -> bool:
    try:
        _take(Read(), _checked(line))
    except UNFIT:
        return False
    return True


def _checked(line: bytes) -> dict[str, Any]:
    """A line as a document.

    Raises
    ------
    ValueError, msgspec.DecodeError
        It is no document, or not the one its checksum was made of.
    """
    value = msgspec.json.decode(line)
    if not isinstance(value, dict):
        raise ValueError("no document")
    checksum = value.pop("sum", None)
    if checksum is not None:
        fresh = (line[:-SUM] + b"}", msgspec.json.encode(value))  # as it was written; or as somebody wrote it again, with blanks
        if all(checksum != f"{zlib.crc32(one):08x}" for one in fresh):
            raise ValueError("the line does not fit its checksum")
    return value


_OF_A_CELL = frozenset({"event", "cell", "key", "status", "seconds", "clipped", "clipped_flux", "floored", "files"})
_FIELDS = {
    "axes": frozenset({"event", "group", "axes"}),
    "arrays": frozenset({"event", "group", "names"}),
    "run": frozenset({"event", "planned", "todo"}),
    **dict.fromkeys(EVENTS, _OF_A_CELL),
}


def _take(found: Read, value: Mapping[str, Any]) -> None:
    """One line; ``ValueError`` or ``TypeError`` where it has not the form of its event."""
    event = value["event"]
    if not set(value) <= _FIELDS[event]:
        raise ValueError("unknown words")
    if event == "axes":
        group, axes = _of(str, value["group"]), value["axes"]
        if axes is None:
            found.axes.pop(group, None)
        else:
            found.axes[group] = {_of(str, dim): _axis(_of(list, values)) for dim, values in axes.items()}
    elif event == "arrays":
        found.arrays.setdefault(_of(str, value["group"]), set()).update(_of(str, name) for name in _of(list, value["names"]))
    elif event == "run":
        planned, todo = ({_of(str, k): _of(int, n) for k, n in value[name].items()} for name in ("planned", "todo"))
        found.run = Going(planned, todo)
    else:
        files = tuple(Written(_of(str, path), _of(int, size), _of(str, digest)) for path, size, digest in value.get("files", ()))
        status = value.get("status", "done")
        if status not in STATUS:
            raise ValueError(f"unknown status {status!r}")
        numbers = [float(_of((int, float), value.get(name, 0.0))) for name in ("seconds", "clipped", "clipped_flux", "floored")]
        cell = _of(str, value["cell"])
        found.entries[cell] = Entry(event, _of(str, value["key"]), files, status, *numbers)
        if found.run is not None and event in ("done", "failed"):
            found.run.ended.add(cell)


def _of(kind: Any, value: Any) -> Any:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise TypeError(f"expected {kind}, got {type(value)}")
    return value


def _axis(written: list[Any]) -> list[Any]:
    values = [_value(one) for one in written]
    if len({isinstance(one, str) for one in values}) > 1 or not all(isinstance(one, str | int | float) for one in values):
        raise ValueError("an axis of no values")
    return values


def is_done(entry: Entry | None, key: str) -> bool:
    """Whether the last word on a cell is that it is done, with this key."""
    return entry is not None and entry.event == "done" and entry.key == key


def fit(entry: Entry, paths: Iterable[str], root: Path) -> bool:
    """Whether these files are named by an entry, and have the size and digest it names."""
    known = {file.path: file for file in entry.files}
    for path in paths:
        file = known.get(path)
        if file is None:
            return False
        try:
            data = (root / path).read_bytes()
        except OSError:
            return False
        if len(data) != file.size or digest_of(data) != file.digest:
            return False
    return True
