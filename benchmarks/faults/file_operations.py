"""Let every file operation of a run fail, or be its last, and check what the same command makes of the rest.

    python benchmarks/faults/file_operations.py [--every 1] [--kinds KIND ...] [--seed 0]

A small sweep is run once to number the operations below its archive (open, write, rename, remove, fsync, ...). Then,
for each of them, in a process of its own:

killed before, killed after : the process ends there, at once
disk full, quota used up, input/output error, too many open files : the operation is refused
power lost (``--durable``) : the process ends there, and only what had been synced is kept: the content of a file as of
    its last fsync, the names in a folder as of the folder's last fsync. Of other content nothing, a part or all is
    kept, at random.

After each fault the same command runs again. The table has for each kind of fault: how many archives equal that of an
undisturbed run (correct), how many do not (wrong: a byte of the store differs, or `verify` finds something), were
misread in between, or recomputed a finished cell; tracebacks, and files left over. Every fault is named. Exit code 1 if
there is any.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
from collections import Counter
from pathlib import Path

from forked import LIGHT, SWEEP, answer, code_of, differs, finished_in, import_all, left_over, misread, start
from operations import KINDS, Watched

COLUMNS = ("tried", "correct", "wrong", "misread", "recomputed", "tracebacks", "left over")


class Runs:
    """Runs of the pipeline, each with one disturbed operation."""

    def __init__(self, place: Path) -> None:
        self.place, self.said, self.names = place, place / "said", place / "names"
        self.archive, self.whole = place / "archive", place / "whole"
        (place / "faults.toml").write_text(LIGHT + SWEEP)

    def words(self, archive: Path, durable: bool) -> list[str]:
        words = [
            "run",
            str(self.place / "faults.toml"),
            "--archive",
            str(archive),
            "--quiet",
            "--json",
            "--scheduler",
            "serial",
        ]
        return [*words, *(["--durable"] if durable else [])]

    def run(self, archive: Path, durable: bool, watched: Watched | None = None) -> tuple[int, str]:
        """Return the exit code and output of a run."""
        before = watched.install if watched else None
        after = (lambda: self.names.write_text(" ".join(watched.names))) if watched else None
        code = code_of(start(self.words(archive, durable), self.said, before, after))
        return code, self.said.read_text(errors="replace")

    def numbered(self, durable: bool) -> list[str]:
        """Return the operations of an undisturbed run by name."""
        archive = self.place / f"counted{durable}"
        self.run(archive, durable, Watched(archive, 0, "", random.Random(0)))
        return self.names.read_text().split()

    def disturbed(self, at: int, kind: str, seed: int) -> tuple[int, dict[str, str]]:
        """Return the exit code of a run with a fault, and the faults found after it and after the next run."""
        durable, faults = kind == "power lost", dict[str, str]()
        code, first = self.run(self.archive, durable, Watched(self.archive, at, kind, random.Random(f"{seed} {at}")))
        if why := misread(self.archive, self.whole):
            faults["misread"] = why
        done = finished_in(self.archive)
        again, second = self.run(self.archive, durable)
        if again:
            faults["wrong"] = f"exit {again}: {second.strip()[-150:]}"
        elif why := differs(self.archive, self.whole):
            faults["wrong"] = why
        elif left := left_over(self.archive, self.whole):
            faults["left over"] = ", ".join(left[:3])
        if not again and (computed := json.loads(second.splitlines()[-1])["computed"]) > finished_in(self.whole) - done:
            faults["recomputed"] = f"{computed} computed, {done} were finished"
        if "Traceback" in first + second:
            faults["tracebacks"] = (first + second)[-1000:]
        shutil.rmtree(self.archive, ignore_errors=True)
        return code, faults


def measured(place: Path, kinds: list[str], every: int, most: int, seed: int) -> str:
    """Disturb every n-th operation in every way; print a row per kind, and return how many results were wrong."""
    runs, wrong = Runs(place), 0
    import_all(runs.words(runs.whole, False), runs.said)
    totals = {durable: runs.numbered(durable) for durable in (False, True)}
    for durable, names in totals.items():
        print(f"{len(names)} operations{' with --durable' if durable else ''}: {dict(Counter(names).most_common())}")
    print(
        f"{'fault':20} " + " ".join(f"{name:>10}" for name in COLUMNS) + "   exit codes of the disturbed run",
        flush=True,
    )
    for kind in kinds:
        names, seen, codes = totals[kind == "power lost"], Counter[str](), Counter[int]()
        for at in range(1 + seed % every, min(len(names), most) + 1, every):
            code, faults = runs.disturbed(at, kind, seed)
            codes[code] += 1
            seen.update(["tried", *faults, *([] if faults else ["correct"])])
            for what, why in faults.items():
                print(f"  {kind}, {names[at - 1]} {at}: {what}: {why}", flush=True)
        wrong += seen["tried"] - seen["right"]
        print(
            f"{kind:20} " + " ".join(f"{seen[name]:10}" for name in COLUMNS) + f"   {dict(sorted(codes.items()))}",
            flush=True,
        )
    return str(wrong)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=1, help="try every n-th operation")
    parser.add_argument("--most", type=int, default=1_000_000, help="try only the first N operations")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        os.environ["ETENDUE_CACHE"] = f"{place}/cache"
        told = answer(lambda: measured(Path(place), given.kinds, given.every, given.most, given.seed))
    if told != "0":
        print(told if not told.isdigit() else f"{told} wrong")
    return int(told != "0")


if __name__ == "__main__":
    sys.exit(main())
