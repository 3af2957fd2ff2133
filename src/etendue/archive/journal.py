"""The journal: what is finished, and nothing else is.

One JSON line per event, appended by the owner of the archive only. A cell is finished when its **last** line is
``done`` with the wanted key, and the files it names have the size and digest it names. A torn last line counts as
absent. What a file's existence suggests is never asked. The axis values of each group stand here too: a coordinate
array torn by a kill is written again from them.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from etendue.archive.chunks import digest_of
from etendue.spec.ports import Written


@dataclass(frozen=True)
class Entry:
    """The last word on one cell."""

    event: str  # start | done | failed
    key: str
    files: tuple[Written, ...] = ()
    status: str = "done"
    seconds: float = 0.0
    clipped: float = 0.0
    clipped_flux: float = 0.0
    floored: float = 0.0


class Journal:
    """Append-only lines of one archive."""

    def __init__(self, path: Path, durable: bool = False) -> None:
        self.path, self.durable = path, durable
        self.encoder = msgspec.json.Encoder()
        self.entries, self.axes = _read(path)
        _cut_torn_line(path)
        self.handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)

    def _append(self, lines: Iterable[dict[str, Any]]) -> None:
        data = b"".join(self.encoder.encode(line) + b"\n" for line in lines)
        if data:
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

    def close(self) -> None:
        os.close(self.handle)


def _written(value: Any) -> Any:
    """An axis value as JSON, which has no infinity."""
    return {"float": repr(value)} if isinstance(value, float) and not math.isfinite(value) else value


def _value(written: Any) -> Any:
    return float(written["float"]) if isinstance(written, dict) else written


def read_journal(path: Path) -> dict[str, Entry]:
    """The last line of every cell. A torn or foreign line counts as absent."""
    return _read(path)[0]


def read_axes(path: Path) -> dict[str, dict[str, list[Any]]]:
    """The axis values of every group, in stored order."""
    return _read(path)[1]


def _read(path: Path) -> tuple[dict[str, Entry], dict[str, dict[str, list[Any]]]]:
    """The last line of every cell, and the axis values of every group."""
    entries: dict[str, Entry] = {}
    axes: dict[str, dict[str, list[Any]]] = {}
    if not path.exists():
        return entries, axes
    decoder = msgspec.json.Decoder()
    for line in path.read_bytes().split(b"\n"):
        try:
            value = decoder.decode(line)
            if value["event"] == "axes":
                if value["axes"] is None:
                    axes.pop(value["group"], None)
                else:
                    axes[value["group"]] = {dim: [_value(v) for v in values] for dim, values in value["axes"].items()}
                continue
            files = tuple(Written(*f) for f in value.get("files", ()))
            entries[value["cell"]] = Entry(
                value["event"], value["key"], files, value.get("status", "done"), value.get("seconds", 0.0),
                value.get("clipped", 0.0), value.get("clipped_flux", 0.0), value.get("floored", 0.0),
            )  # fmt: skip
        except (msgspec.DecodeError, KeyError, TypeError, AttributeError):
            continue
    return entries, axes


def _cut_torn_line(path: Path) -> None:
    """Drop what stands behind the last line end, so that the next line starts on its own."""
    if not path.exists():
        return
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole != len(data):
        with path.open("r+b") as handle:
            handle.truncate(whole)


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
