"""The journal: what is finished, and nothing else is.

One JSON line per event, appended by the owner of the archive only. A cell is finished when its **last** line is
``done`` with the wanted key, and the files it names have the size and digest it names. A torn last line counts as
absent. What a file's existence suggests is never asked.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
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


class Journal:
    """Append-only lines of one archive."""

    def __init__(self, path: Path, durable: bool = False) -> None:
        self.path, self.durable = path, durable
        self.encoder = msgspec.json.Encoder()
        self.entries = read_journal(path)
        _cut_torn_line(path)
        self.handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)

    def _append(self, lines: Iterable[dict[str, Any]]) -> None:
        data = b"".join(self.encoder.encode(line) + b"\n" for line in lines)
        if data:
            os.write(self.handle, data)
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
                "clipped": entry.clipped, "clipped_flux": entry.clipped_flux,
                "files": [[f.path, f.size, f.digest] for f in entry.files],
            }
            for cell, entry in pairs
        )  # fmt: skip
        for cell, entry in pairs:
            self.entries[cell] = entry

    def close(self) -> None:
        os.close(self.handle)


def read_journal(path: Path) -> dict[str, Entry]:
    """The last line of every cell. A torn or foreign line counts as absent."""
    entries: dict[str, Entry] = {}
    if not path.exists():
        return entries
    decoder = msgspec.json.Decoder()
    for line in path.read_bytes().split(b"\n"):
        try:
            value = decoder.decode(line)
            files = tuple(Written(*f) for f in value.get("files", ()))
            entries[value["cell"]] = Entry(
                value["event"], value["key"], files, value.get("status", "done"), value.get("seconds", 0.0),
                value.get("clipped", 0.0), value.get("clipped_flux", 0.0),
            )  # fmt: skip
        except (msgspec.DecodeError, KeyError, TypeError, AttributeError):
            continue
    return entries


def _cut_torn_line(path: Path) -> None:
    """Drop what stands behind the last line end, so that the next line starts on its own."""
    if not path.exists():
        return
    data = path.read_bytes()
    whole = data.rfind(b"\n") + 1
    if whole != len(data):
        with path.open("r+b") as handle:
            handle.truncate(whole)


def finished(entry: Entry | None, key: str, root: Path, checked: dict[str, bool] | None = None) -> bool:
    """Whether a cell needs no computing: its last line is ``done``, with this key, and its files are as said."""
    if entry is None or entry.event != "done" or entry.key != key:
        return False
    for file in entry.files:
        path = root / file.path
        try:
            if path.stat().st_size != file.size or digest_of(path.read_bytes()) != file.digest:
                return False
        except OSError:
            return False
    return True
