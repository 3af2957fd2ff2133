"""Every operation on the files of an archive fails once: the run ends in words, and the next one ends with the archive of a fresh run.

    python benchmarks/faults/disk.py [--error ENOSPC|EIO|EDQUOT|EMFILE] [--every 1]

Counts the operations of a small run (open, write, rename, truncate, new folder, fsync with --durable), then fails them one after the
other, each in an archive of its own, and runs again without a fault. Prints how many were tried, what the failed run said, and how
many archives were wrong, had something left over, or computed a finished cell again. Exit code 1 if any did.
"""

from __future__ import annotations

import argparse
import errno
import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from etendue.archive import disk, journal, parts, shards
from etendue.errors import EtendueError
from etendue.session import Options, execute
from tests.archive.tiny import store_of, tiny_plan

OPERATIONS = ("open", "write", "pwritev", "pread", "replace", "ftruncate", "mkdir", "unlink", "fsync", "copy_file_range")


class Failing:
    """The module ``os``, one of whose operations fails once."""

    def __init__(self, at: int, code: int) -> None:
        self.left, self.code = at, code

    def __getattr__(self, name: str):  # type: ignore[no-untyped-def]
        own = getattr(os, name)
        if name not in OPERATIONS:
            return own

        def attempt(*arguments, **more):  # type: ignore[no-untyped-def]
            self.left -= 1
            if self.left == 0:
                raise OSError(self.code, os.strerror(self.code))
            return own(*arguments, **more)

        return attempt


def with_faults(plan, archive: Path, at: int, code: int, durable: bool):  # type: ignore[no-untyped-def]
    """A run with one fault: what it raised, and how many operations were not yet done."""
    failing, rooms = Failing(at, code), (disk, journal, parts, shards)
    for room in rooms:
        room.os = failing  # type: ignore[attr-defined]
    try:
        execute(plan, archive, Options("serial", durable=durable, batch_seconds=0.0))
    except (EtendueError, OSError) as error:
        return error, failing.left
    finally:
        for room in rooms:
            room.os = os  # type: ignore[attr-defined]
    return None, failing.left


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--error", default="ENOSPC", choices=("ENOSPC", "EIO", "EDQUOT", "EMFILE"))
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--durable", action="store_true")
    arguments = parser.parse_args()
    code, place = getattr(errno, arguments.error), Path(tempfile.mkdtemp())
    plan = tiny_plan(place)
    _, left = with_faults(plan, place / "whole", 0, code, arguments.durable)
    sound, total, ends = store_of(place / "whole"), -left, Counter()
    for number in range(1, total + 1, arguments.every):
        archive = place / f"{number}"
        try:
            error, _ = with_faults(plan, archive, number, code, arguments.durable)
        except BaseException as other:
            ends[f"broke off: {type(other).__name__}"] += 1
            print(f"operation {number}: {type(other).__name__}: {other}", file=sys.stderr)
            continue
        ends["ended in words" if error is not None else "went on"] += 1
        done = {} if error is None else journal.read_journal(archive / "journal.jsonl")
        finished = sum(entry.event == "done" for entry in done.values())
        outcome = execute(plan, archive, Options("serial"))
        wrong = store_of(archive) != sound
        over = [p for p in archive.rglob(".*") if p.is_file()]
        again = error is not None and outcome.computed > len(plan.cells) - finished
        for what, seen in (("wrong archives", wrong), ("leftovers", bool(over)), ("finished cells computed again", again)):
            ends[what] += seen
            if seen:
                print(f"operation {number} of {total}: {what} ({error})", file=sys.stderr)
    tried = len(range(1, total + 1, arguments.every))
    print(f"{arguments.error}: {tried} of {total} operations failed once" + (", durable" if arguments.durable else ""))
    for what, count in sorted(ends.items()):
        print(f"{count:6d}  {what}")
    sys.exit(any(ends[what] for what in ends if what not in ("ended in words", "went on")))


if __name__ == "__main__":
    main()
