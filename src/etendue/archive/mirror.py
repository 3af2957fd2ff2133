"""An archive on an object store while it is being written: a run works in a local folder, and each of its files is
uploaded whole, as one object.

In:  a URL.
Out: the working folder; at the end, objects that hold a valid archive, byte for byte the files of the folder.

Order of changes on the store: put ``owner.json``, on the condition that no other run has put it; delete the manifest;
put all files that are known before computing; put each shard as soon as it is complete, and then the journal that names
it. At the end put status and tables, metadata, the journal, the manifest, the table of objects, and ``owner.json``
again, which marks the archive as closed. Objects that no longer belong to the archive are deleted before the manifest
is put. An uploaded shard leaves a stub in the local folder.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import threading
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path

from etendue import cache
from etendue.archive.fetching import PACK, TABLE, Here, at_once, fetch, is_shard, packed
from etendue.archive.journaling.journal import NAME as JOURNAL
from etendue.archive.read.reading import StoredArchive
from etendue.archive.records import disk
from etendue.archive.records.manifest import DATA
from etendue.archive.records.manifest import NAME as MANIFEST
from etendue.archive.records.owner import Behind, stand
from etendue.archive.remote import stubs
from etendue.archive.remote.lease import CLOSED, LEFT, OWNER, RUNNING, Lease, in_use, look
from etendue.archive.remote.objects import Objects, endpoint_of, plain_url
from etendue.archive.sharding.shards import index_size
from etendue.errors import ArchiveError, ArchiveInUse, EtendueError, MachineError, StoreLost

ROOT = f"{DATA}/zarr.json"
UPLOADS = 3  # shards uploaded at a time
MOST_WAITING = 12
STOOD_FOR = 1 << 20  # bytes; larger shards are replaced by a stub once they are uploaded
SHARE = 20  # at most 1 part in 20 of the time goes into publishing the journal
LOOK = 1.0


def work_place() -> Path:
    """Return the folder that holds all working folders: ``ETENDUE_WORK``, else the user's cache folder."""
    own = os.environ.get("ETENDUE_WORK")
    return (Path(own) if own else cache.folder() / "objects").resolve()


def working_folder(url: str) -> Path:
    """Return the working folder of one URL at one endpoint."""
    plain = plain_url(url)
    return (
        work_place()
        / f"{plain.rpartition('/')[2]}-{hashlib.sha256(f'{plain} {endpoint_of(plain)}'.encode()).hexdigest()[:12]}"
    )


class Mirror(Behind):
    """A context manager that gives the working folder. After a normal exit, all changes are on the store.

    Attributes
    ----------
    notes : messages for the user
    """

    def __init__(self, url: str, exact: bool = False) -> None:
        super().__init__()  # not running: the lock of the folder already excludes other local runs
        self.objects, self.exact = Objects(url), exact
        self.here = Here(working_folder(url), self.objects.url)
        self.folder = self.here.folder
        self.lease: Lease | None = None
        self.notes: list[str] = []
        self.lock = threading.Lock()
        self.going: dict[str, Future[None]] = {}
        self.sealed_since = False
        self.said: list[str] = []  # uploaded shards that the uploaded journal names
        self.error: BaseException | None = None
        self.over = threading.Event()
        self.pool: ThreadPoolExecutor | None = None
        self.thread: threading.Thread | None = None

    # -- beginning and end --------------------------------------------------------------------------------------------

    def __enter__(self) -> Path:
        try:
            self.here.place.mkdir(parents=True, exist_ok=True)
            self.held = os.open(self.here.place / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        except OSError as error:
            where = f"cannot write the working folder {self.here.place}: {error.strerror}"
            raise MachineError(f"{where}; choose another with ETENDUE_WORK=DIR") from None
        try:
            try:
                fcntl.flock(self.held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise ArchiveInUse(f"{self.objects.url} is in use by another run on this machine") from None
            self._fetch()
        except BaseException:
            os.close(self.held)
            raise
        stand(self.folder, self)
        return self.folder

    def _fetch(self) -> None:
        self.here.load()
        found, self.seen = self.objects.list(), look(self.objects)
        if self.seen.held() and self.seen.run != self.here.run:
            raise in_use(self.objects.url, self.seen)
        if found and not {ROOT, JOURNAL, OWNER, MANIFEST} & found.keys():
            raise ArchiveError(f"{self.objects.url} holds objects but no archive; choose another with --archive URL")
        self.new = ROOT not in found
        self.unfinished = self.seen.state != CLOSED
        if self.here.run not in ("", self.seen.run) and (self.here.changed() or self.here.gone()):
            self.notes.append(
                "results that an earlier run left here were discarded: another run has written to the archive since"
            )
        self.manifest_there = MANIFEST in found
        fetch(self.objects, self.here, self.seen, found, self.exact)
        self.here.save()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        try:
            if error is None:
                self._finish()
            else:
                self._leave()
            if error is not None and isinstance(error, StoreLost) and error.args:
                error.args = (f"{error.args[0]}. Finished results are in {self.here.place}; run again to continue",)
        except StoreLost as lost:
            raise StoreLost(f"{lost}. Finished results are in {self.here.place}; run again to continue") from None
        finally:
            self._stop()
            stand(self.folder, None)
            stubs.forget(self.folder)
            os.close(self.held)

    def _stop(self) -> None:
        self.over.set()
        if self.thread:
            self.thread.join()
        if self.pool:
            self.pool.shutdown(cancel_futures=True)
        self.thread = self.pool = None

    def _leave(self) -> None:
        """End a failed run: the store keeps its objects, other results stay in the folder, and any run may continue."""
        self._stop()
        if self.lease:
            try:
                self.lease.say(LEFT)
            except EtendueError:  # the lease expires anyway
                pass

    # -- called by the run --------------------------------------------------------------------------------------------

    def own(self) -> None:
        if self.lease:
            return
        lease = Lease(self.objects, self.seen)
        lease.take()
        self.lease, self.here.run = lease, lease.run
        if not lease.guarded:
            self.notes.append(
                f"{self.objects.url}: this store does not support conditional writes, so nothing prevents two runs "
                f"from writing at once"
            )
        self.here.save()
        if self.manifest_there:
            self.objects.delete([MANIFEST])
            self.here.there.pop(MANIFEST, None)
        self.pool = ThreadPoolExecutor(UPLOADS, "put")
        self.thread = threading.Thread(target=self._tend, name="objects", daemon=True)
        self.thread.start()

    def begun(self) -> None:
        if not self.lease:
            return
        changed = [path for path in self.here.changed() if not is_shard(path) and path not in (JOURNAL, MANIFEST)]
        self._put(path for path in changed if not path.startswith(f"{DATA}/"))
        # the old consolidated metadata would go on describing the archive as it was
        self._put(path for path in changed if path == ROOT and not self.new)
        with self.lock:
            moved = list(self.going.values())
        # renamed shards: the journal may name them only once they are there; their old objects are deleted after it
        for one in moved:
            one.result()
        # before the new arrays: the journal marks them as ours
        self._say_journal((self.folder / JOURNAL).stat().st_size)
        if not self.new:
            for level in (2, 3):
                self._put(path for path in changed if _order(path) == level)
            self._remove_gone()
            self._say_objects()
        self.here.save()

    def sealed(self, paths: Iterable[str]) -> None:
        if self.error:
            raise self.error
        self._stand_in()
        for path in paths:
            if self.pool and self.here.state(path):
                with self.lock:
                    self.going[path] = self.pool.submit(self._put_one, path)
                    waiting = [one for one in self.going.values() if not one.done()]
                    self.sealed_since = True
                if len(waiting) > MOST_WAITING:
                    wait(waiting, return_when="FIRST_COMPLETED")

    # -- while the run computes ---------------------------------------------------------------------------------------

    def _tend(self) -> None:
        """Renew the lease, and publish the journal from time to time."""
        not_before, snapshot = 0.0, None
        assert self.lease is not None
        try:
            while not self.over.wait(LOOK):
                self.lease.renew()
                with self.lock:
                    # A snapshot is the journal's size with the uploads under way at that moment: once these are
                    # done, every shard that this much of the journal names is on the store.
                    for path in [path for path, one in self.going.items() if one.done()]:
                        self.going.pop(path).result()
                    if snapshot is None and self.sealed_since and time.monotonic() > not_before:
                        snapshot = ((self.folder / JOURNAL).stat().st_size, list(self.going.values()))
                        self.sealed_since = False
                if snapshot is not None and all(one.done() for one in snapshot[1]):
                    began = time.monotonic()
                    self._say_journal(snapshot[0])
                    with self.lock:
                        self.here.save()
                        self.said = [path for path in self.here.there if is_shard(path)]
                    snapshot, not_before = None, time.monotonic() + SHARE * (time.monotonic() - began)
        except BaseException as error:
            self.error = error

    def _say_journal(self, size: int) -> None:
        """Upload the first ``size`` bytes of the journal (all shards named there are uploaded) and the object table."""
        if self.lease:
            self.lease.check()
        with (self.folder / JOURNAL).open("rb") as file:
            self.objects.put(JOURNAL, file.read(size))
        self._say_objects()

    def _say_objects(self, more: Mapping[str, str] | None = None) -> None:
        with self.lock:
            known = {path: tag for path, (tag, *_) in sorted(self.here.there.items()) if tag} | dict(more or {})
        self.objects.put(TABLE, json.dumps({"objects": known}).encode())

    def _stand_in(self) -> None:
        """Free local disk space: replace each shard that is uploaded, and named in the uploaded journal, by a small
        placeholder file. Runs in the thread that makes shards.
        """
        with self.lock:
            known, self.said = self.said, []
            large = [path for path in known if path in self.here.there and self.here.there[path][1] > STOOD_FOR]
        forms = StoredArchive(self.folder).slots_of(large) if large else {}
        for path in large:
            tag, *state = self.here.there[path]  # of the file when it was uploaded
            if forms.get(path) and self.here.state(path) == tuple(state) and state[1] != disk.ELSEWHERE:
                stubs.stand_for(self.folder, path, index_size(forms[path]))
                with self.lock:
                    self.here.equal(path, tag)

    # -- uploading ----------------------------------------------------------------------------------------------------

    def _put_one(self, path: str) -> None:
        state = self.here.state(path)
        if state is None or state[1] == disk.ELSEWHERE:
            return
        if self.lease:
            self.lease.check()
        tag = self.objects.put(path, self.folder / path)
        with self.lock:
            self.here.there[path] = (tag, *state)

    def _put(self, paths: Iterable[str], threads: int = 16) -> None:
        at_once(self._put_one, paths, threads)

    def _remove_gone(self) -> None:
        gone = [path for path in self.here.gone() if path != MANIFEST]
        self.objects.delete(gone)
        with self.lock:
            for path in gone:
                del self.here.there[path]

    def _finish(self) -> None:
        """Upload everything in order: readers see either this finished run or the previous run."""
        changed, gone = self.here.changed(), self.here.gone()
        if not (changed or gone or self.unfinished or self.lease):
            return
        self.own()
        assert self.lease is not None
        wait(list(self.going.values()))
        self._stop()
        if isinstance(self.error, ArchiveInUse):
            raise self.error
        self.lease.say(RUNNING)
        changed = self.here.changed()
        for level in range(7):
            own = [path for path in changed if _order(path) == level]
            if level == 5:
                self._remove_gone()
            self._put(own, UPLOADS if level == 0 else 16)
        self._say_objects({PACK: self.objects.put(PACK, packed(self.here))})
        self.lease.say(CLOSED)
        self.here.save()
        self.said = [path for path in self.here.there if is_shard(path)]
        self._stand_in()
        self.here.save()


def _order(path: str) -> int:
    """Return the upload level of a file: a file that contains digests of other files is uploaded after them."""
    if not path.startswith(f"{DATA}/"):
        return {JOURNAL: 5, MANIFEST: 6}.get(path, 1)
    if path == ROOT:
        return 4
    return 0 if is_shard(path) else 3 if path.endswith("/zarr.json") else 2
