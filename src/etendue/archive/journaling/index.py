"""The content of a journal as columns in the user's cache: reading it again requires one digest instead of parsing a
line for each cell.

In:  the path of a journal; the content of its first bytes.
Out: the same content, if these bytes have not changed since.

There is one entry for each path. It holds the length and the digest of the journal bytes that it represents, and begins
with a digest of itself; lines that were appended later are read in addition. A journal is read completely if any of
these bytes differs or its entry is damaged: only a collision of the digest could give a wrong answer. The newest
entries are kept.
"""

from __future__ import annotations

import hashlib
import os
from array import array
from pathlib import Path
from typing import Any, BinaryIO

import msgspec

from etendue import cache
from etendue.archive.journaling.entries import KEY, Entries, WrittenChunks

KIND = "journals"
SMALLEST = 1 << 20  # bytes of lines that are worth an entry
FORM = 1  # of an entry; raised whenever the meaning of a field changes
MOST = 16  # entries, of 21 MB for 137,000 cells; the oldest are removed
SUM = 32  # bytes of a digest
BLOCK = 1 << 20
Digest = hashlib.blake2b
_COLUMNS = ("path", "part", "slot", "offset", "size", "digest")


class Index(msgspec.Struct):
    """An entry of the cache: the state of all cells after the first ``length`` bytes of the journal, and all lines in
    these bytes that are not about cells."""

    form: int
    length: int
    digest: bytes
    names: list[str]
    flags: tuple[bytes, bytes, bytes, bytes]  # event, status, fresh, key
    columns: tuple[bytes, bytes, bytes]  # seconds, first, count
    texts: list[str]
    files: tuple[bytes, bytes, bytes, bytes, bytes, bytes]
    odd_keys: dict[int, str]
    rest: dict[int, tuple[float, float, float, str]]
    ended: list[int] | None  # rows of the cells that have ended in the last run; None: all, in order
    outdated: list[str]
    lines: list[bytes]  # the lines that are not about cells, in order


_encode, _decode = msgspec.msgpack.Encoder().encode, msgspec.msgpack.Decoder(Index).decode


def _key(path: Path) -> str:
    return hashlib.sha256(os.fsencode(os.path.realpath(path))).hexdigest()[:32]


def fresh_digest() -> Digest:
    return hashlib.blake2b(digest_size=SUM)


def known(path: Path, file: BinaryIO, size: int) -> tuple[Index | None, Digest]:
    """Return the cached content of the beginning of an open journal, with the digest of these bytes, and position the
    file after them. If no entry of the cache is valid, return None and position the file at its start.
    """
    data = cache.read(KIND, _key(path)) if size >= SMALLEST else None
    try:
        found = _decode(data[SUM:]) if data and _sum(data[SUM:]) == data[:SUM] else None
    except (msgspec.DecodeError, ValueError):  # of another version
        found = None
    if found and found.form == FORM and found.length <= size:
        digest, left = fresh_digest(), found.length
        while left and (block := file.read(min(left, BLOCK))):
            digest.update(block)
            left -= len(block)
        if digest.digest() == found.digest:
            return found, digest
        file.seek(0)
    return None, fresh_digest()


def keep(path: Path, length: int, digest: bytes, index: Index) -> None:
    """Store an entry for the first bytes of a journal."""
    index.length, index.digest = length, digest
    data = _encode(index)
    cache.write(KIND, _key(path), _sum(data) + data)
    cache.keep_newest(KIND, MOST)


def _sum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=SUM).digest()


def index_of(entries: Entries, ended: set[str], outdated: set[str], lines: list[bytes]) -> Index:
    """Return an entry with the state of all cells."""
    rows, files = entries.rows, entries.files
    everything = len(ended) == len(rows) and ended == rows.keys()
    return Index(
        FORM,
        0,
        b"",
        list(rows),
        (bytes(entries.event), bytes(entries.status), bytes(entries.fresh), bytes(entries.key)),
        (entries.seconds.tobytes(), entries.first.tobytes(), entries.count.tobytes()),
        files.texts,
        tuple(vars(files)[name].tobytes() for name in _COLUMNS),
        entries.odd_keys,
        entries.rest,
        None if everything else [rows[name] for name in ended],
        sorted(outdated),
        lines,
    )


def entries_of(index: Index) -> Entries:
    """Return the state of all cells that an entry holds.

    Raises
    ------
    ValueError
        The columns have different lengths.
    """
    found = Entries()
    found.rows = {name: row for row, name in enumerate(index.names)}
    found.event, found.status, found.fresh, found.key = map(bytearray, index.flags)
    found.seconds, found.first, found.count = map(_array, "dqi", index.columns)
    found.odd_keys, found.rest = index.odd_keys, index.rest
    files = found.files = WrittenChunks()
    files.texts = index.texts
    files.number = {text: number for number, text in enumerate(index.texts)}
    files.path, files.part, files.slot, files.offset, files.size, files.digest = map(_array, "iiqqqq", index.files)
    lengths: set[Any] = {len(found.event), len(found.status), len(found.fresh), len(found.key) / KEY}
    if {*lengths, len(found.seconds), len(found.first), len(found.count)} != {len(found.rows)}:
        raise ValueError("the columns of the entry differ in length")
    return found


def _array(kind: str, data: bytes) -> array[Any]:
    found: array[Any] = array(kind)
    found.frombytes(data)
    return found
