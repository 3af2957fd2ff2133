"""Faults of a Dask cluster: killed workers, misbehaving cells, differing workers, lost schedulers.

    python benchmarks/faults/cluster.py --count 60            # everything, 60 kills of workers and 60 of owners
    python benchmarks/faults/cluster.py --only killed poison

In:  processes on loopback that act as machines; a plugin with slow cells (`toil.py`).
Out: a table: fault | expected | as expected, with counts; exit code 1 if they differ. After every fault the same
     command runs again on a sound cluster: the archive must then hold the arrays of an undisturbed run (`mended`) and
     no half-written file, and no process may be left.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from forked import Seen
from machines import Cluster, brought, cluster, environment, fake, free_port
from processes import children, still, workers_below

PIPELINE = 'name = "file"\nprecision = "float32"\n' + "".join(
    f'[[stages]]\nuse = "{use}"\n' for use in ("lamp", "toil", "witness")
)
PROGRAM = (
    "import etendue.run.cluster.watching as w, etendue.run.cluster.connect as c; w.PATIENCE = c.FIRST = {patience}; "
    "from etendue.__main__ import main; main()"
)
IMPATIENT, PATIENT = (
    6.0,
    60.0,
)  # seconds without a worker until a run gives up: if none will come, and if one is restarted
NUMBERS = tuple(str(n) for n in range(1, 41))


class Place:
    """A folder with the pipeline and the plugin, and the results of an undisturbed run."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "file.toml").write_text(PIPELINE)
        self.site = brought(folder / "site", "1.0")
        self.env = environment(self.site)
        self.patience = PATIENT
        done = self.run(NUMBERS, "whole", "--scheduler", "serial")
        assert done.returncode == 0, done.stderr
        self.whole = arrays(folder / "whole")

    def command(self, hows: tuple[str, ...], archive: str, *words: str) -> list[str]:
        sweep = "toil.how=[" + ",".join(json.dumps(how) for how in hows) + "]"
        program = [sys.executable, "-c", PROGRAM.format(patience=self.patience)]
        return [*program, "run", "file.toml", "--sweep", sweep, "--json", "--quiet", "--archive", archive, *words]

    def start(self, hows: tuple[str, ...], archive: str, *words: str) -> subprocess.Popen[str]:
        heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)  # shells ignore it for background processes
        pipes = {
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
            "text": True,
            "start_new_session": True,
            "preexec_fn": heard,
        }
        return subprocess.Popen(self.command(hows, archive, *words), cwd=self.folder, env=self.env, **pipes)  # type: ignore[call-overload, no-any-return]

    def run(self, hows: tuple[str, ...], archive: str, *words: str) -> subprocess.CompletedProcess[str]:
        command = self.command(hows, archive, *words)
        return subprocess.run(
            command, cwd=self.folder, env=self.env, capture_output=True, text=True, timeout=300, check=False
        )

    def begun(self, archive: str, cells: int = 6) -> bool:
        """Wait until this many cells are finished."""
        journal, until = self.folder / archive / "journal.jsonl", time.monotonic() + 60
        while time.monotonic() < until:
            if journal.exists() and journal.read_text(errors="replace").count('"done"') >= cells:
                return True
            time.sleep(0.02)
        return False

    def same(self, archive: str) -> bool:
        """Return whether an archive holds the arrays of the undisturbed run, and no half-written file."""
        return arrays(self.folder / archive) == self.whole and not list((self.folder / archive).rglob("*.partial"))


def arrays(archive: Path) -> dict[str, str]:
    """Return a digest of every array of the stages; other contents of the archive are ignored."""
    import xarray

    found = {}
    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None) as tree:
        for path in ("toil/irradiance", "witness/seen_light"):
            for how in tree[path].toil_how.values:
                if how in NUMBERS:
                    found[f"{path} {how}"] = hashlib.sha256(tree[path].sel(toil_how=how).values.tobytes()).hexdigest()
    return found


def unless(what: str, right: bool) -> str:
    """Return what happened, or '' if it is as expected."""
    return "" if right else what


def ended(process: subprocess.CompletedProcess[str], code: int, *words: str) -> tuple[str, bool]:
    """Return the exit code with the single line of output, and whether both are as expected."""
    lines = [line for line in process.stderr.splitlines() if not line.startswith("note: ")]
    right = (
        process.returncode == code
        and all(word in process.stderr for word in words)
        and "Traceback" not in process.stderr
    )
    return f"exit {process.returncode}: {' / '.join(lines)[:400]}", right and len(lines) <= 2


def failed(process: subprocess.CompletedProcess[str], how: str, *words: str) -> tuple[str, bool]:
    """Return whether the misbehaving cell, and no other, has failed with this message."""
    try:
        told = {f["cell"][1]["toil_how"]: f["message"] for f in json.loads(process.stdout)["failures"]}
    except (ValueError, KeyError):
        return ended(process, 3, *words)[0], False
    right = process.returncode == 3 and set(told) == {how} and all(word in told[how] for word in words)
    return f"exit {process.returncode}: {told}", right and "Traceback" not in process.stderr


def in_time(process: subprocess.Popen[str]) -> subprocess.CompletedProcess[str]:
    out, said = process.communicate(timeout=240)
    return subprocess.CompletedProcess([], process.returncode, out, said)


def killed_workers(place: Place, chance: random.Random, count: int) -> Iterator[Seen]:
    """Kill workers at random instants of runs, until the count is reached."""
    seen = Seen("worker killed at a random instant", "exit 0, identical arrays")
    kills = 0
    with cluster(place.folder, place.env) as there:
        while kills < count:
            process = place.start(NUMBERS, "k", "--scheduler", there.address)
            place.begun("k", 0)
            while process.poll() is None and kills < count:
                time.sleep(chance.uniform(0.1, 2.5))
                pids = [pid for worker in there.workers for pid in workers_below(worker.pid)]
                if pids and process.poll() is None:
                    os.kill(chance.choice(pids), signal.SIGKILL)
                    kills += 1
            done = in_time(process)
            seen.count(unless(ended(done, 0)[0], ended(done, 0)[1] and place.same("k")))
            shutil.rmtree(place.folder / "k")
    seen.fault += f" ({kills} kills)"
    yield seen


def killed_owners(place: Place, chance: random.Random, count: int) -> Iterator[Seen]:
    """Kill the owner of a run with two workers of its own at random instants, then run the same command again."""
    seen = Seen(
        "owner of --scheduler distributed killed -9, then rerun", "exit 0, identical arrays, nothing left behind"
    )
    words = ("--scheduler", "distributed", "--workers", "2")
    began = time.monotonic()
    place.run(NUMBERS, "o", *words)
    whole = time.monotonic() - began
    shutil.rmtree(place.folder / "o")
    for number in range(count):
        process = place.start(NUMBERS, "o", *words)
        if number % 2:  # starting a cluster takes most of a short run
            place.begun("o", chance.randrange(1, 2 * len(NUMBERS)))
        else:
            time.sleep(whole * (number + chance.random()) / count)
        below = children(process.pid)
        process.kill()
        process.communicate()
        left = still(below)
        done = place.run(NUMBERS, "o", *words)
        what, right = ended(done, 0)
        seen.count(unless(f"{what}, left {left}", right and place.same("o") and not left))
        shutil.rmtree(place.folder / "o")
    yield seen


def bad_cells(place: Place, *_: object) -> Iterator[Seen]:
    """Run cells that kill their worker, exceed its memory, or hang: each fails alone, with a message."""
    cases: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
        ("cell that calls os._exit", "leaves", "os._exit(7)", ()),
        ("cell that kills its worker", "is killed", "every worker that computed it died", ()),
        ("cell that exceeds its worker's memory", "grows", "more memory than a worker may use (0.40 GB)", ()),
        ("cell that hangs", "hangs", "no answer within 2 s", ("--cell-timeout", "2")),
    )
    for where in ("tcp", "own"):
        with contextlib.ExitStack() as stack:
            address = "distributed"
            if where == "tcp":
                address = stack.enter_context(cluster(place.folder, place.env, 2, "--memory-limit", "400MB")).address
            for fault, how, words, more in cases:
                if where == "own" and how in ("grows", "leaves"):
                    # its workers may use a share of the memory that others use too; the limit works alike everywhere
                    continue
                seen = Seen(
                    f"{fault}, {address if where == 'own' else 'tcp://'}",
                    "exit 3, only that cell fails, other arrays identical",
                )
                done = place.run(
                    (*NUMBERS[:20], how, *NUMBERS[20:]), "b", "--scheduler", address, "--workers", "2", *more
                )
                what, right = failed(done, how, words)
                seen.count(unless(what, right and place.same("b")))
                shutil.rmtree(place.folder / "b", ignore_errors=True)
                yield seen


def lost_schedulers(place: Place, *_: object) -> Iterator[Seen]:
    """Use a scheduler that is missing, has no workers, loses them all, or dies."""
    address = f"tcp://127.0.0.1:{free_port()}"
    seen = Seen("no scheduler", "exit 5, one line")
    seen.count(unless(*ended(place.run(NUMBERS, "s", "--scheduler", address), 5, "no Dask scheduler answers there")))
    yield seen
    with Cluster(place.folder, place.env) as there:
        seen = Seen("scheduler without workers", "exit 5, one line; then exit 0")
        place.patience = IMPATIENT
        seen.count(unless(*ended(place.run(NUMBERS, "s", "--scheduler", there.address), 5, "no workers for")))
        place.patience = PATIENT
        for words in ((), ("--no-nanny",)):
            there.add(*words)
        there.wait_for(2)
        yield mended(place, seen, there.address)
        seen = Seen("all workers end", "exit 5, one line; then exit 0")
        place.patience = IMPATIENT
        process = place.start(NUMBERS, "s", "--scheduler", there.address)
        place.begun("s")
        for worker in there.workers:
            for pid in (worker.pid, *children(worker.pid)):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        seen.count(unless(*ended(in_time(process), 5, "there has been no worker")))
        place.patience = PATIENT
        there.add()
        there.add()
        there.wait_for(2)
        yield mended(place, seen, there.address)
        seen = Seen("scheduler killed -9, restarted", "exit 5, one line; then exit 0")
        process = place.start(NUMBERS, "s", "--scheduler", there.address)
        place.begun("s")
        there.scheduler.kill()
        there.scheduler.wait()
        seen.count(unless(*ended(in_time(process), 5, "the scheduler is lost")))
        there.start_scheduler()  # its workers have ended with it
        there.add()
        there.add()
        there.wait_for(2)
        yield mended(place, seen, there.address)
    seen = Seen("scheduler killed -9, continued with threads", "exit 5, one line; then exit 0")
    with cluster(place.folder, place.env) as there:
        process = place.start(NUMBERS, "s", "--scheduler", there.address)
        place.begun("s")
        there.scheduler.kill()
        there.scheduler.wait()
        seen.count(unless(*ended(in_time(process), 5, "the scheduler is lost")))
    yield mended(place, seen, "threads")


def mended(place: Place, seen: Seen, scheduler: str) -> Seen:
    """Run the same command again; it must complete the archive of an undisturbed run."""
    done = place.run(NUMBERS, "s", "--scheduler", scheduler)
    what, right = ended(done, 0)
    if not (right and place.same("s")):
        seen.count(f"then {what}")
    shutil.rmtree(place.folder / "s", ignore_errors=True)
    return seen


def strangers(place: Place, *_: object) -> Iterator[Seen]:
    """Use workers that would give other bits, or do not see the archive: they are refused by name, early and late."""
    without = place.folder / "without"
    without.mkdir()
    (without / "sitecustomize.py").write_text("import sys\nsys.modules['etendue'] = None\n")
    other = brought(place.folder / "other", "1.1")
    hidden = ("unshare", "-m", "sh", "-c", f'mount -t tmpfs none "{place.folder / "x"}" && exec "$@"', "sh")
    (place.folder / "x").mkdir()
    cases = [
        (
            "worker with a different numpy",
            environment(fake(place.folder / "n", "numpy", "1.0"), place.site),
            (),
            "numpy 1.0 (here",
        ),
        (
            "worker with a different etendue",
            environment(fake(place.folder / "e", "etendue", "9.0"), place.site),
            (),
            "etendue 9.0 (here",
        ),
        (
            "worker with a different plugin",
            environment(other),
            (),
            "different code of the stage Toil in toil 1.1 (here toil 1.0)",
        ),
        ("worker without the plugin", environment(), (), "no stage Lamp of toil 1.0"),
        ("worker without etendue", environment(without), (), "no answer"),
        ("worker that does not see the archive", place.env, hidden, "no archive at"),
    ]
    for fault, env, before, words in cases:
        seen = Seen(fault, "exit 5, worker named; without it exit 0")
        with cluster(place.folder, place.env, 1) as there:
            there.add(env=env, before=before)
            there.wait_for(2)
            seen.count(
                unless(
                    *ended(
                        place.run(NUMBERS, "x/s", "--scheduler", there.address), 5, words, "the worker tcp://127.0.0.1:"
                    )
                )
            )
        with cluster(place.folder, place.env, 1) as there:
            done = place.run(NUMBERS, "x/s", "--scheduler", there.address)
            seen.count(unless(f"then {ended(done, 0)[0]}", ended(done, 0)[1] and place.same("x/s")))
        shutil.rmtree(place.folder / "x" / "s", ignore_errors=True)
        yield seen
    seen = Seen("such a worker joins during a run", "exit 5, worker named; without it exit 0")
    with cluster(place.folder, place.env, 1) as there:
        process = place.start(
            NUMBERS, "s", "--scheduler", there.address, "--set", "toil.pause=0.8"
        )  # longer than a worker takes to start
        place.begun("s", 2)
        late = there.add(env=environment(other))
        seen.count(unless(*ended(in_time(process), 5, "different code of the stage", "the worker tcp://127.0.0.1:")))
        for pid in (*children(late.pid), late.pid):
            os.kill(pid, signal.SIGKILL)
        yield mended(place, seen, there.address)


def signalled(place: Place, chance: random.Random, count: int) -> Iterator[Seen]:
    """Send Ctrl-C and SIGTERM to the whole session of a run with workers of its own."""
    for sent, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
        seen = Seen(
            f"{sent.name} with --scheduler distributed", f"exit {code}, one line, nothing left behind; then exit 0"
        )
        for _ in range(max(1, count // 20)):
            process = place.start(NUMBERS, "s", "--scheduler", "distributed", "--workers", "2")
            place.begun("s", chance.randint(0, 30))
            below = children(process.pid)
            os.killpg(process.pid, sent)
            what, right = ended(in_time(process), code, "intact")
            left = still(below)
            seen.count(unless(f"{what}, left {left}", right and not left))
            mended(place, seen, "distributed")
        yield seen


FAULTS: dict[str, Callable[[Place, random.Random, int], Iterator[Seen]]] = {
    "cells": bad_cells,
    "schedulers": lost_schedulers,
    "strangers": strangers,
    "signals": signalled,
    "workers": killed_workers,
    "owners": killed_owners,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="number of kills, of workers and of owners each")
    parser.add_argument("--only", nargs="*", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    wrong = 0
    print(Seen.HEAD)
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder))
        for name in given.only:
            for seen in FAULTS[name](place, random.Random(given.seed), given.count):
                wrong += seen.print()
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
