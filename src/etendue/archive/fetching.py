"""Make a local folder of an archive on an object store: small documents are fetched, shards become stubs.

In:  the listing of the store, and the present content of the folder.
Out: the folder as a run or reader expects an archive; by path, the object that each file equals.

A shard needs no request if its object is unchanged since it was put, because its index follows from the journal. If
neither tag nor journal confirms a shard, its index is fetched. An object that has changed is fetched as a whole and
checked like any damaged file.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec

from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.journaling.journal import UNFIT
from etendue.archive.read.reading import StoredArchive
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.remote.lease import CLOSED, SeenOwner
from etendue.archive.remote.objects import Objects, StoredObject
from etendue.archive.remote.stubs import STORE
from etendue.archive.sharding.shards import Shard, index_bytes, index_size
from etendue.archive.write.clearing import CHUNK
from etendue.contract.ports import WrittenChunk
from etendue.types.documents import Document, DocumentView

TABLE = "objects.json"  # the objects of an archive, with the tag that each had when it was put
PACK = "documents.zip"  # one object that holds all small objects, so that a reader needs one request for them
SMALL, SMALL_SHARD = 64 << 10, 4 << 10  # bytes; the largest document and the largest shard in the pack
AT_ONCE = 16  # concurrent requests
T = TypeVar("T")
State = tuple[int, int, int]  # size, mtime (ns) and inode of a file: a file that replaces it has another inode
Known = tuple[str, int, int, int]  # the tag of an object, and the state of the file with the same content


@dataclass
class Here:
    """A working folder: ``place`` contains the folder of the archive and a record of the content of the store.

    Attributes
    ----------
    run : the last run that has written to the folder; '' if nothing in the folder is newer than the store
    there : by path of a file, the tag of the object with the same content, and the state of the file when this was
        checked; threads that upload files add to this mapping, so a reader must copy it first
    """

    place: Path
    url: str
    run: str = ""
    there: dict[str, Known] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        return self.place / self.url.rpartition("/")[2]

    def load(self) -> None:
        known = disk.read_document(self.place / STORE) or {}
        if known.get("url") == self.url:
            self.run = str(known.get("run", ""))
            self.there = {
                path: (str(one[0]), int(one[1]), int(one[2]), int(one[3]))
                for path, one in dict(known.get("there", {})).items()
            }

    def save(self) -> None:
        known = {"url": self.url, "run": self.run, "there": dict(self.there)}
        disk.write(self.place, STORE, json.dumps(known).encode())

    def state(self, path: str) -> State | None:
        """Return the state of a file; None if the file does not exist."""
        try:
            found = os.lstat(self.folder / path)
        except OSError:
            return None
        return found.st_size, found.st_mtime_ns, found.st_ino

    def equal(self, path: str, tag: str) -> None:
        """Record that a file equals the object with this tag."""
        if state := self.state(path):
            self.there[path] = (tag, *state)

    def files(self, every: bool = False) -> dict[str, State]:
        """Return the state of every file of the archive; without unfinished shards unless ``every``."""
        found = {}
        for top, _, names in os.walk(self.folder):
            for name in names:
                path = os.path.relpath(os.path.join(top, name), self.folder)
                if (every or not name.endswith((disk.PART, disk.PARTIAL))) and (state := self.state(path)):
                    found[path] = state
        return found

    def changed(self) -> list[str]:
        """Return the files whose content differs from that in the store."""
        return [path for path, state in self.files().items() if self.there.get(path, ("", 0, 0, 0))[1:] != state]

    def gone(self) -> list[str]:
        """Return the objects whose files have been removed."""
        return [path for path in list(self.there) if self.state(path) is None]


def is_shard(path: str) -> bool:
    return path.startswith(f"{DATA}/") and CHUNK.fullmatch(path.rpartition("/")[2]) is not None


def is_ours(path: str) -> bool:
    """Return True if an object has the name of a file of an archive."""
    return path in disk.FILES or path.partition("/")[0] in disk.FOLDERS


def fetch(
    objects: Objects, here: Here, seen: SeenOwner, found: Mapping[str, StoredObject], exact: bool, inputs: bool = True
) -> None:
    """Make a folder match the store; results of a run in this folder that have not been uploaded yet are kept.

    ``exact``: fetch the index of every shard from the store, for callers that verify; ``inputs``: fetch the input
    files of pipelines too.
    """
    ours = bool(here.run) and here.run == seen.run
    wanted = {path: one for path, one in found.items() if is_ours(path) and (inputs or not path.startswith("inputs/"))}
    if not ours:
        here.run = ""
    _clear(here, wanted, ours)
    todo = [path for path, one in wanted.items() if _lacks(here, path, one, ours)]
    vouched = _vouched(objects) if TABLE in found and todo else {}
    if JOURNAL in todo:  # first: the indexes of shards follow from it
        todo.remove(JOURNAL)
        data, one = objects.get(JOURNAL)
        disk.write(here.folder, JOURNAL, data if seen.state == CLOSED else _backed(data, wanted))
        here.equal(JOURNAL, one.tag if seen.state == CLOSED else "")
    archive = StoredArchive(here.folder)
    indexes, pack = _Indexes(archive), _pack(objects, found, vouched, todo) if not exact else {}
    trusted = seen.state == CLOSED and not exact

    def bring(path: str) -> tuple[str, str]:
        one, tag = wanted[path], vouched.get(path)
        if path in pack and tag == one.tag:
            disk.write(here.folder, path, pack[path])
            return path, tag
        slots = indexes.slots(path) if is_shard(path) and tag in (None, one.tag) else 0
        if not slots or one.size <= index_size(slots):
            disk.write(here.folder, path, objects.pieces(path))
        elif trusted and tag is not None:
            disk.write_stand_in(here.folder, path, one.size, indexes.bytes(path, slots))
        else:
            length = index_size(slots)
            disk.write_stand_in(here.folder, path, one.size, objects.part(path, one.size - length, length))
        return path, one.tag

    for path, tag in at_once(bring, todo):
        here.equal(path, tag)


def _clear(here: Here, wanted: Collection[str], ours: bool) -> None:
    """Remove files that are not on the store, except those that a run of this folder has yet to upload."""
    for path, state in here.files(every=not ours).items():
        if path not in wanted and (not ours or state[1] == disk.ELSEWHERE):
            disk.remove(here.folder, path)
            here.there.pop(path, None)
    for top, _, _ in os.walk(here.folder, topdown=False):
        with suppress(OSError):  # removes empty folders only
            os.rmdir(top)
    (here.folder / DATA).mkdir(parents=True, exist_ok=True)


def _lacks(here: Here, path: str, one: StoredObject, ours: bool) -> bool:
    """Return True if an object must be fetched."""
    known, state = here.there.get(path), here.state(path)
    same = known is not None and known[0] == one.tag
    if ours and state is None:
        return not same  # otherwise a run of this folder has removed the file
    if ours and state is not None and state[1] != disk.ELSEWHERE:
        if not same:
            here.there.pop(path, None)
        return False
    return not same or known is None or known[1:] != state


def at_once(do: Callable[[str], T], paths: Iterable[str], threads: int = AT_ONCE) -> list[T]:
    """Call ``do`` for many paths in threads; the first exception stops the remaining calls."""
    own = list(paths)
    if len(own) < 2:
        return [do(path) for path in own]
    with ThreadPoolExecutor(min(threads, len(own))) as pool:
        waiting = [pool.submit(do, path) for path in own]
        try:
            return [one.result() for one in waiting]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _vouched(objects: Objects) -> dict[str, str]:
    """Return, by path, the tag that each object had when it was put; empty if the table of objects cannot be read."""
    try:
        known = json.loads(objects.get(TABLE)[0])["objects"]
        return {str(path): str(tag) for path, tag in known.items()}
    except (FileNotFoundError, ValueError, TypeError, KeyError, AttributeError):
        return {}


def packed(here: Here) -> bytes:
    """Return the small documents of an archive as one zip file; the same documents give the same bytes."""
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as file:
        for path, state in sorted(here.files().items()):
            most = SMALL_SHARD if is_shard(path) else 0 if path.startswith("inputs/") else SMALL
            if state[1] != disk.ELSEWHERE and state[0] <= most:
                file.writestr(zipfile.ZipInfo(path), (here.folder / path).read_bytes(), zipfile.ZIP_DEFLATED)
    return data.getvalue()


def _pack(
    objects: Objects, found: Mapping[str, StoredObject], vouched: Mapping[str, str], todo: Collection[str]
) -> dict[str, bytes]:
    """Return the packed documents among ``todo``. The pack is valid only while the object table contains its tag; a run
    that starts removes this tag.
    """
    if PACK not in found or vouched.get(PACK) != found[PACK].tag or len(todo) < AT_ONCE:
        return {}
    try:
        with zipfile.ZipFile(io.BytesIO(objects.get(PACK)[0])) as file:
            return {path: file.read(path) for path in set(file.namelist()).intersection(todo)}
    except (FileNotFoundError, zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError):
        return {}


class _Indexes:
    """The indexes that shards must have according to the journal."""

    def __init__(self, archive: StoredArchive) -> None:
        self.archive, self.journal = archive, archive.journal
        self.written = {} if self.journal.files_a_cell else self.journal.said.by_shard()  # numbers of chunks

    def slots(self, path: str) -> int:
        """Return the number of chunks for which a shard has room; 0 if the shard is unknown."""
        return self.archive.slots_of([path]).get(path, 0) if path in self.journal.shards else 0

    def bytes(self, path: str, slots: int) -> bytes:
        shard = self.journal.shards[path]
        written = map(self.journal.said.files.__getitem__, self.written[path])
        places = {one.slot: (at, one.size) for one in written if (at := shard.at(one)) is not None}
        return index_bytes(slots, places)


def _backed(data: bytes, found: Mapping[str, StoredObject]) -> bytes:
    """Return the journal lines whose chunks are also on the store. Cells of an interrupted run may exist only in the
    folder of that run.
    """
    lines = data.split(b"\n")[:-1]
    decoded = [_document(line) for line in lines]
    last: dict[str, Shard] = {}
    for one in decoded:
        if one.get("event") == "shard" and one.get("path") in found:
            last[one["path"]] = Shard(one["size"], tuple(tuple(run) for run in one["kept"]))

    def there(one: DocumentView) -> bool:
        if one.get("event") == "shard":
            return one.get("path") in found
        if one.get("event") != "done":
            return True
        files = [WrittenChunk(*file) for file in one.get("files", ()) if len(file) == 6]
        return all(file.path in last and last[file.path].at(file) is not None for file in files)

    return b"".join(line + b"\n" for line, one in zip(lines, decoded, strict=True) if there(one))


def _document(line: bytes) -> Document:
    try:
        found = msgspec.json.decode(line)
    except UNFIT:
        return {}
    return found if isinstance(found, dict) else {}
