"""Processes of this machine, from /proc: parents, sessions, survivors, listening sockets.

In:  the number of a process, or of a session.
Out: numbers of processes that have not ended; addresses.
"""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

PROC = Path("/proc")


def states() -> dict[int, tuple[int, int]]:
    """Return parent and session of every process that has not ended."""
    found = {}
    for status in PROC.glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            fields = status.read_text().rsplit(")", 1)[1].split()
            if fields[0] != "Z":
                found[int(status.parent.name)] = int(fields[1]), int(fields[3])
    return found


def of_session(session: int) -> list[int]:
    return [pid for pid, (_, own) in states().items() if own == session]


def children(pid: int) -> list[int]:
    """Return the processes that a process has started, and their descendants."""
    known, found, open_ = states(), list[int](), [pid]
    while open_:
        parent = open_.pop()
        below = [child for child, (own, _) in known.items() if own == parent]
        found += below
        open_ += below
    return found


def workers_below(pid: int) -> list[int]:
    """Return the worker processes below a process, without Python's resource tracker."""
    found = []
    for child in children(pid):
        with contextlib.suppress(OSError):
            words = (PROC / str(child) / "cmdline").read_bytes()
            if b"spawn_main" in words and b"resource_tracker" not in words:
                found.append(child)
    return found


def still(pids: list[int], seconds: float = 8.0) -> list[int]:
    """Return which of some processes still exist after a while."""
    until = time.monotonic() + seconds
    while (alive := [pid for pid in pids if pid in states()]) and time.monotonic() < until:
        time.sleep(0.1)
    return alive


def listening(session: int) -> list[str]:
    """Return the addresses on which processes of a session listen, as the kernel writes them."""
    own = set()
    for pid in of_session(session):
        with contextlib.suppress(OSError):
            own |= {os.readlink(link) for link in (PROC / str(pid) / "fd").iterdir()}
    rows = [row.split() for table in ("tcp", "tcp6") for row in (PROC / "net" / table).read_text().splitlines()[1:]]
    return [row[1].rpartition(":")[0] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in own]
