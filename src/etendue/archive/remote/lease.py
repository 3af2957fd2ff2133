"""The right to write to an archive on an object store: one object, put on the condition that it has not changed.

In:  the store, and ``owner.json`` as it was last read.
Out: the right to write as long as it is renewed; the final mark that an archive is complete.

A killed run cannot release its lease, which expires ``LEASE`` seconds after the last renewal. Every put has different
content, so that the tag of the object shows whether another run has written since.
"""

from __future__ import annotations

import json
import threading
import time
import uuid
from dataclasses import dataclass

from etendue.archive.remote.objects import Conflict, Objects, StoredObject, Unconditional
from etendue.errors import ArchiveInUse, StoreLost

OWNER = "owner.json"
LEASE = 60.0  # seconds
# a run is writing; a run has failed or was interrupted; all is in order
RUNNING, LEFT, CLOSED = "running", "left", "closed"


@dataclass(frozen=True)
class SeenOwner:
    """The content of ``owner.json``. An archive that another program uploaded has no such file."""

    run: str = ""
    state: str = CLOSED
    found: StoredObject | None = None

    def held(self) -> float:
        """Return the seconds until the lease of a running owner expires; 0 if no run holds it."""
        return max(self.found.modified + LEASE - time.time(), 0.0) if self.found and self.state == RUNNING else 0.0


def look(objects: Objects) -> SeenOwner:
    """Return the owner of an archive on a store."""
    try:
        data, found = objects.get(OWNER)
    except FileNotFoundError:
        return SeenOwner()
    try:
        said = json.loads(data)
        return SeenOwner(str(said["run"]), said["state"] if said["state"] in (RUNNING, LEFT) else CLOSED, found)
    except (ValueError, TypeError, KeyError):
        return SeenOwner("", LEFT, found)


def in_use(url: str, seen: SeenOwner) -> ArchiveInUse:
    return ArchiveInUse(
        f"{url} is in use by another run; if that run was killed, its lease ends in {seen.held():.0f} s: run again then"
    )


class Lease:
    """The right of a run to write to an archive in an object store.

    Attributes
    ----------
    guarded : whether the store supports conditional writes, so that no other run can write at the same time
    """

    def __init__(self, objects: Objects, seen: SeenOwner) -> None:
        self.objects, self.run, self.number, self.guarded = objects, uuid.uuid4().hex, 0, True
        self.tag = seen.found.tag if seen.found else ""
        self.renewed = time.time()  # wall-clock time, which goes on while a machine sleeps
        self.lock = threading.Lock()

    def take(self) -> None:
        """Become the owner, unless another run has become the owner since ``seen``.

        Raises
        ------
        ArchiveInUse
            Another run has become the owner.
        """
        try:
            self.say(RUNNING)
        except ArchiveInUse:
            raise in_use(self.objects.url, look(self.objects)) from None

    def renew(self) -> None:
        """Renew the lease. If the store cannot be reached, the next call tries again.

        Raises
        ------
        ArchiveInUse
            Another run is now the owner.
        """
        if time.time() - self.renewed > LEASE / 4:
            try:
                with self.lock:
                    self.say(RUNNING)
            # No error yet: the lease is valid until it expires, and `check` renews it before the next put.
            except StoreLost:
                pass

    def check(self) -> None:
        """Check that this run still owns the lease. Call before a put: the lease may have expired while the machine
        slept or the network was down.

        Raises
        ------
        ArchiveInUse
            Another run is now the owner.
        """
        if time.time() - self.renewed > LEASE / 2:
            with self.lock:
                # again, because another thread may have renewed the lease while this one waited
                if time.time() - self.renewed > LEASE / 2:
                    self.say(RUNNING)

    def say(self, state: str) -> None:
        """Write a state to ``owner.json``, which also renews the lease.

        Raises
        ------
        ArchiveInUse
            Another run is now the owner.
        """
        self.number += 1
        data = json.dumps({"run": self.run, "state": state, "number": self.number}).encode()
        try:
            self.tag = self._put(data)
        except Conflict:
            # Otherwise our own earlier put succeeded and only its response was lost.
            if look(self.objects).run != self.run:
                raise ArchiveInUse(f"{self.objects.url} now belongs to another run; this run stops") from None
            self.tag = self.objects.put(OWNER, data)
        self.renewed = time.time()

    def _put(self, data: bytes) -> str:
        if self.guarded:
            try:
                return self.objects.put(OWNER, data, self.tag)
            except Unconditional:
                self.guarded = False
        try:
            there = self.objects.get(OWNER)[1].tag
        except FileNotFoundError:
            there = ""
        if there != self.tag:
            raise Conflict
        return self.objects.put(OWNER, data)
