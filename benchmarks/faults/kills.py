"""Kill runs at random instants with kill -9, on threads, processes and a Dask cluster, and run them again.

    python benchmarks/faults/kills.py 500 [--schedulers threads processes distributed] [--seed 1]

In:  the number of kills, divided evenly. Killed are: the process with all its children; its owner alone, which makes
     orphans of its workers; or a single worker. Half of the kills are spread over the length of a run, half follow a
     random cell after a random delay. An archive is killed one to three times before it is completed; half of the
     archives have a batch per cell.
Out: by scheduler and killed process: kills, archives, and how many of these ended wrong (a byte differs from that of an
     undisturbed run, or `verify` finds something), were misread in between, recomputed a finished cell, printed a
     traceback, or left a file or process behind. Each is named; exit code 1 if there is any.

A run is a process forked from one that has imported all modules. All runs on the cluster share its workers, which run
under nannies.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from forked import PIPELINE, ROOT, answer, differs, finished_in, import_all, left_over, misread, start
from processes import of_session, still, workers_below

SCHEDULERS = ("threads", "processes", "distributed")
VICTIMS = {"threads": ("all",), "processes": ("all", "owner", "worker"), "distributed": ("owner", "worker")}
PATIENCE = 240.0  # seconds until a run that has not ended hangs
COLUMNS = ("kills", "archives", "wrong", "misread", "recomputed", "tracebacks", "left over", "hung")


@dataclass
class Tried:
    """The results for one archive."""

    victim: str
    kills: int = 0
    faults: dict[str, str] = field(default_factory=dict)


class Runs:
    """Runs of the pipeline with one scheduler, each to its end or until it is killed."""

    def __init__(self, place: Path, scheduler: str, address: str, chance: random.Random) -> None:
        self.place, self.scheduler, self.address, self.chance = place, scheduler, address, chance
        self.whole, self.said = place / "whole", place / "said"
        self.length = 1.0  # seconds of an undisturbed run

    def words(self, archive: Path) -> list[str]:
        words = ["run", str(self.place / "faults.toml"), "--archive", str(archive), "--json", "--quiet"]
        return [*words, "--scheduler", self.address, *(["--workers", "2"] if self.scheduler != "distributed" else [])]

    def start(self, archive: Path, finely: bool) -> int:
        return start(self.words(archive), self.said, cell_by_cell if finely else None)

    def ended(self, child: int) -> int | None:
        """Return the exit code of a run; None if it hangs."""
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            pid, status = os.waitpid(child, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.01)
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return None

    def undisturbed(self) -> None:
        import_all(self.words(self.place / "imports"), self.said)
        began = time.monotonic()
        if self.ended(self.start(self.whole, False)):
            raise RuntimeError(self.said.read_text())
        self.length = time.monotonic() - began

    def wait(self, child: int, archive: Path) -> bool:
        """Wait until a random instant of a run; return whether it is still running."""
        if self.chance.random() < 0.5:
            until = time.monotonic() + self.chance.uniform(0.0, 1.1) * self.length
        else:
            done = finished_in(archive)
            more, until = self.chance.randrange(1, 40), time.monotonic() + 30
            while finished_in(archive) < done + more and time.monotonic() < until and under_way(child):
                time.sleep(0.001)
            until = time.monotonic() + self.chance.uniform(0.0, 0.2) * self.length
        while time.monotonic() < until and under_way(child):
            time.sleep(0.001)
        return under_way(child)

    def kill(self, child: int, victim: str, workers: list[int]) -> bool:
        """Kill the chosen process; return whether it was there."""
        if victim == "worker":
            own = workers or workers_below(child)
            if not own:
                return False
            try:
                os.kill(self.chance.choice(own), signal.SIGKILL)
            except ProcessLookupError:
                return False
            return True
        try:
            (os.killpg if victim == "all" else os.kill)(child, signal.SIGKILL)
        except ProcessLookupError:  # it has no session of its own yet
            os.kill(child, signal.SIGKILL)
        return True

    def once(self, number: int, victim: str, standing: list[int]) -> Tried:
        """Kill runs of one archive, check it, complete it, and check it again."""
        archive, tried = self.place / f"{number}", Tried(victim)
        sessions, finely = [], self.chance.random() < 0.5
        for _ in range(self.chance.choice((1, 1, 2, 3))):
            child = self.start(archive, finely)
            sessions.append(child)
            there = self.wait(child, archive)
            if there and self.kill(child, victim, [worker for nanny in standing for worker in workers_below(nanny)]):
                tried.kills += 1
            code = self.ended(child)
            self.look(tried, code, "" if victim == "worker" else "killed")
            if code == 0:
                break
        if why := misread(archive, self.whole):
            tried.faults["misread"] = why
        done = finished_in(archive)
        child = self.start(archive, finely)
        sessions.append(child)
        self.look(tried, self.ended(child), "ended")
        if not tried.faults:
            self.compare(tried, archive, done)
        if left := still([pid for session in sessions for pid in of_session(session)], 10.0):
            tried.faults["left over"] = f"processes {left}"
        shutil.rmtree(archive, ignore_errors=True)
        return tried

    def look(self, tried: Tried, code: int | None, kind: str) -> None:
        said = self.said.read_text(errors="replace")
        if code is None:
            tried.faults["hung"] = said[-300:]
        if "Traceback" in said:
            tried.faults["tracebacks"] = said[-1500:]
        if code not in ((0, -signal.SIGKILL) if kind == "killed" else (0,)):
            tried.faults.setdefault("wrong", f"exit {code}: {said[-300:]}")

    def compare(self, tried: Tried, archive: Path, done: int) -> None:
        computed, total = json.loads(self.said.read_text().splitlines()[-1])["computed"], finished_in(self.whole)
        if computed > total - done:
            tried.faults["recomputed"] = f"{computed} computed, {done} of {total} were finished"
        if why := differs(archive, self.whole):
            tried.faults["wrong"] = why
        elif left := left_over(archive, self.whole):
            tried.faults["left over"] = ", ".join(left[:3])


def cell_by_cell() -> None:
    """Use a batch, and thus a line of the journal, for every cell."""
    from etendue import session

    whole = session.partition
    session.partition = lambda jobs, seconds: whole(jobs, 0.0)


def under_way(child: int) -> bool:
    """Return whether a child is still running, without waiting for it."""
    try:
        return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None
    except ChildProcessError:
        return False


def measure(place: Path, scheduler: str, kills: int, seed: int) -> list[Tried]:
    """Kill runs this many times with one scheduler."""
    chance, found = random.Random(f"{seed} {scheduler}"), list[Tried]()
    with ExitStack() as stack:
        address, standing = scheduler, list[int]()
        if scheduler == "distributed":
            from machines import Cluster

            there = stack.enter_context(Cluster(place, dict(os.environ)))
            for _ in range(2):
                there.add()
            answer(partial(there.wait_for, 2))  # a client starts threads
            address, standing = there.address, [worker.pid for worker in there.workers]
        runs = Runs(place, scheduler, address, chance)
        runs.undisturbed()
        while sum(tried.kills for tried in found) < kills:
            victims = VICTIMS[scheduler]
            tried = runs.once(len(found), victims[len(found) % len(victims)], standing)
            found.append(tried)
            for what, why in tried.faults.items():
                print(
                    f"  {scheduler} {len(found) - 1}, {tried.victim} killed {tried.kills} times: {what}: {why}",
                    flush=True,
                )
    return found


def measured(place: Path, scheduler: str, kills: int, seed: int) -> str:
    """Return the same as JSON, from a process that has imported everything its runs need."""
    place.mkdir()
    (place / "faults.toml").write_text(PIPELINE.replace("[2, 4]", "[2, 4, 8]").replace("[4, 5]", "[4, 5, 6]"))
    return json.dumps([(tried.victim, tried.kills, tried.faults) for tried in measure(place, scheduler, kills, seed)])


def print_row(scheduler: str, victim: str, figures: Iterable[object]) -> None:
    print(f"{scheduler:12s} {victim:10s} " + " ".join(f"{figure!s:>10}" for figure in figures), flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kills", type=int, nargs="?", default=500)
    parser.add_argument("--schedulers", nargs="+", default=list(SCHEDULERS), choices=SCHEDULERS)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH")]))
    rows = defaultdict[tuple[str, str], Counter[str]](Counter)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        os.environ["ETENDUE_CACHE"] = str(place / "cache")
        print_row("scheduler", "killed", COLUMNS)
        for number, scheduler in enumerate(given.schedulers):
            share = given.kills * (number + 1) // len(given.schedulers) - given.kills * number // len(given.schedulers)
            told = answer(partial(measured, place / scheduler, scheduler, share, given.seed))
            if not told.startswith("["):
                print(told)
                return 1
            for victim, kills, faults in json.loads(told):
                rows[scheduler, victim].update({"archives": 1, "kills": kills, **dict.fromkeys(faults, 1)})
            for victim in VICTIMS[scheduler]:
                print_row(scheduler, victim, [rows[scheduler, victim][name] for name in COLUMNS])
    whole = sum(rows.values(), Counter[str]())
    print_row("all", "", [whole[name] for name in COLUMNS])
    return int(any(whole[name] for name in COLUMNS[2:]))


if __name__ == "__main__":
    sys.exit(main())
