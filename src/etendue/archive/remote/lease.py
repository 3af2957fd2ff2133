"""Who writes to an archive on an object store: one object, put on the condition that it is still the one that was seen.

In:  the store, what was seen of ``owner.json``.
Out: the right to write, for as long as it is renewed; the last word on an archive when it is in order.

A run that was killed cannot give it up: it ends by itself ``LEASE`` seconds after it was last renewed. Every put of it
has another content, so that its tag says whether anybody has written since.
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
RUNNING, LEFT, CLOSED = "running", "left", "closed"  # somebody writes; a run has ended before its end; all is in order


@dataclass(frozen=True)
class SeenOwner:
    """What ``owner.json`` says. An archive that another program has put there has none."""

    run: str = ""
    state: str = CLOSED
    found: StoredObject | None = None

    def held(self) -> float:
        """Seconds for which it is still somebody's."""
        return max(self.found.modified + LEASE - time.time(), 0.0) if self.found and self.state == RUNNING else 0.0


def look(objects: Objects) -> SeenOwner:
    """Who owns what is on a store."""
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
        f"{url} is in use by another run; if that was killed it is free in {seen.held():.0f} s: run again then"
    )


class Lease:
    """The right of a run to write.

    Attributes
    ----------
    guarded : whether the store keeps others from writing meanwhile
    """

    def __init__(self, objects: Objects, seen: SeenOwner) -> None:
        self.objects, self.run, self.number, self.guarded = objects, uuid.uuid4().hex, 0, True
        self.tag = seen.found.tag if seen.found else ""
        self.renewed = time.time()  # of the clock that goes on while a machine sleeps
        self.lock = threading.Lock()

    def take(self) -> None:
        """Become the owner, if nobody has since ``seen``.

        Raises
        ------
        ArchiveInUse
            Somebody has.
        """
        try:
            self.say(RUNNING)
        except ArchiveInUse:
            raise in_use(self.objects.url, look(self.objects)) from None

    def renew(self) -> None:
        """Stay the owner. A store that cannot be reached is asked again next time.

        Raises
        ------
        ArchiveInUse
            Another run is the owner now.
        """
        if time.time() - self.renewed > LEASE / 4:
            try:
                with self.lock:
                    self.say(RUNNING)
            except StoreLost:
                pass

    def check(self) -> None:
        """In front of a put: the right to it may have ended while the machine slept, or the network was gone.

        Raises
        ------
        ArchiveInUse
            Another run is the owner now.
        """
        if time.time() - self.renewed > LEASE / 2:
            with self.lock:
                if time.time() - self.renewed > LEASE / 2:
                    self.say(RUNNING)

    def say(self, state: str) -> None:
        """Put what is the case.

        Raises
        ------
        ArchiveInUse
            Another run is the owner now.
        """
        self.number += 1
        data = json.dumps({"run": self.run, "state": state, "number": self.number}).encode()
        try:
            self.tag = self._put(data)
        except Conflict:
            if look(self.objects).run != self.run:  # else the answer to an earlier put of our own was lost on its way
                raise ArchiveInUse(f"{self.objects.url} belongs to another run now; this one stops") from None
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
