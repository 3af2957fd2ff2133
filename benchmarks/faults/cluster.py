"""What can go wrong on a Dask cluster: workers killed, cells that kill, hang or take too much, workers that differ, lost schedulers.

    python benchmarks/faults/cluster.py --count 60            # all of it, 60 kills of workers and 60 of owners
    python benchmarks/faults/cluster.py --only killed poison

In:  processes on loopback that stand for machines; a plugin whose cells take a while (`toil.py`).
Out: a table fault | expected | seen, with counts; exit code 1 where they differ. Every fault is followed by the same command on a sound
cluster: the archive must hold the arrays of an undisturbed run (`mended`), no half-written file, and no process may be left.
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
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent
PIPELINE = 'name = "file"\nprecision = "float32"\n' + "".join(f'[[stages]]\nuse = "{use}"\n' for use in ("lamp", "toil", "witness"))
IMPATIENT = (
    "import etendue.run.cluster.watching as w, etendue.run.cluster.connect as c; w.PATIENCE = c.FIRST = 6.0; "
    "from etendue.__main__ import main; main()"
)
NUMBERS = tuple(str(n) for n in range(1, 41))


def free_port() -> int:
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        return int(door.getsockname()[1])


def children(pid: int) -> list[int]:
    """The processes that a process has started, and theirs."""
    parents: dict[int, list[int]] = {}
    for status in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            fields = status.read_text().rsplit(")", 1)[1].split()
            if fields[0] != "Z":
                parents.setdefault(int(fields[1]), []).append(int(status.parent.name))
    found, open_ = [], [pid]
    while open_:
        below = parents.get(open_.pop(), [])
        found += below
        open_ += below
    return found


def workers_below(pid: int) -> list[int]:
    """The processes of Dask workers that a process watches over; Python's tracker of shared things is none."""
    found = []
    for child in children(pid):
        with contextlib.suppress(OSError):
            words = (Path("/proc") / str(child) / "cmdline").read_bytes()
            if b"spawn_main" in words and b"resource_tracker" not in words:
                found.append(child)
    return found


class Place:
    """A folder with the pipeline and the plugin, and what an undisturbed run gives."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "file.toml").write_text(PIPELINE)
        self.site = brought(folder / "site", "1.0")
        self.env = environment(self.site)
        done = self.run(NUMBERS, "whole", "--scheduler", "serial")
        assert done.returncode == 0, done.stderr
        self.whole = arrays(folder / "whole")

    def command(self, hows: tuple[str, ...], archive: str, *words: str) -> list[str]:
        sweep = "toil.how=[" + ",".join(json.dumps(how) for how in hows) + "]"
        return [sys.executable, "-c", IMPATIENT, "run", "file.toml", "--sweep", sweep, "--json", "--quiet", "--archive", archive, *words]

    def start(self, hows: tuple[str, ...], archive: str, *words: str) -> subprocess.Popen[str]:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
        return subprocess.Popen(self.command(hows, archive, *words), cwd=self.folder, env=self.env, **pipes)  # type: ignore[call-overload, no-any-return]

    def run(self, hows: tuple[str, ...], archive: str, *words: str) -> subprocess.CompletedProcess[str]:
        command = self.command(hows, archive, *words)
        return subprocess.run(command, cwd=self.folder, env=self.env, capture_output=True, text=True, timeout=300, check=False)

    def begun(self, archive: str, cells: int = 6) -> bool:
        """Wait until so many cells are finished."""
        journal, until = self.folder / archive / "journal.jsonl", time.monotonic() + 60
        while time.monotonic() < until:
            if journal.exists() and journal.read_text(errors="replace").count('"done"') >= cells:
                return True
            time.sleep(0.02)
        return False

    def same(self, archive: str) -> bool:
        """Whether an archive holds the arrays of the undisturbed run, and nothing half-written."""
        return arrays(self.folder / archive) == self.whole and not list((self.folder / archive).rglob("*.partial"))


def brought(site: Path, version: str) -> Path:
    """The plugin as pip would leave it."""
    info = site / f"toil-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: toil\nVersion: {version}\n")
    (info / "entry_points.txt").write_text("[etendue]\ntoil = toil\n")
    (info / "RECORD").write_text("toil.py,,\n")
    (site / "toil.py").write_text((HERE / "toil.py").read_text() + ("" if version == "1.0" else f"\n# {version}\n"))
    return site


def environment(*folders: Path) -> dict[str, str]:
    path = os.pathsep.join([*map(str, folders), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1"}


def arrays(archive: Path) -> dict[str, str]:
    """A digest of every array of the stages, by number: what the sweep holds beside them does not count."""
    import xarray

    found = {}
    with xarray.open_datatree(archive / "data.zarr", engine="zarr", chunks=None) as tree:
        for path in ("toil/irradiance", "witness/seen_light"):
            for how in tree[path].toil_how.values:
                if how in NUMBERS:
                    found[f"{path} {how}"] = hashlib.sha256(tree[path].sel(toil_how=how).values.tobytes()).hexdigest()
    return found


@dataclass
class Cluster:
    """A scheduler and workers as processes of this machine, each worker under a nanny of its own."""

    place: Place
    words: tuple[str, ...] = ()
    port: int = field(default_factory=free_port)
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def spawn(self, module: str, *words: str, env: dict[str, str] | None = None, before: tuple[str, ...] = ()) -> subprocess.Popen[bytes]:
        command = [*before, sys.executable, "-m", f"distributed.cli.{module}", *words, "--host", "127.0.0.1", "--no-dashboard"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
        return subprocess.Popen(command, cwd=self.place.folder, env=env or self.place.env, **quiet)  # type: ignore[call-overload, no-any-return]

    def start_scheduler(self) -> None:
        self.scheduler = self.spawn("dask_scheduler", "--port", str(self.port))

    def add(self, *words: str, env: dict[str, str] | None = None, before: tuple[str, ...] = ()) -> subprocess.Popen[bytes]:
        process = self.spawn("dask_worker", self.address, "--nthreads", "1", *self.words, *words, env=env, before=before)
        self.workers.append(process)
        return process

    def wait_for(self, workers: int) -> None:
        import distributed

        until = time.monotonic() + 60
        while True:
            try:
                with distributed.Client(self.address, timeout="5s", set_as_default=False) as client:
                    client.wait_for_workers(workers, timeout=60)
                    return
            except (OSError, TimeoutError):
                if time.monotonic() > until:
                    raise

    def __enter__(self) -> Cluster:
        self.start_scheduler()
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            for pid in (*children(process.pid), process.pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            process.wait()


@contextlib.contextmanager
def cluster(place: Place, workers: int = 2, *words: str) -> Iterator[Cluster]:
    with Cluster(place, words) as made:
        for _ in range(workers):
            made.add()
        made.wait_for(workers)
        yield made


@dataclass
class Seen:
    """What was seen of a fault: how often it was as expected, and what was not."""

    fault: str
    expected: str
    tried: int = 0
    right: int = 0
    seen: list[str] = field(default_factory=list)

    def count(self, what: str, right: bool) -> None:
        self.tried += 1
        self.right += right
        if not right or not self.seen:
            self.seen = [*self.seen, what][-3:] if not right else [what]


def ended(process: subprocess.CompletedProcess[str], code: int, *words: str) -> tuple[str, bool]:
    """The exit code and the one line that was said; whether both are as expected."""
    lines = [line for line in process.stderr.splitlines() if not line.startswith("note: ")]
    right = process.returncode == code and all(word in process.stderr for word in words) and "Traceback" not in process.stderr
    return f"exit {process.returncode}: {' / '.join(lines)[:400]}", right and len(lines) <= 2


def failed(process: subprocess.CompletedProcess[str], how: str, *words: str) -> tuple[str, bool]:
    """Whether the cell that misbehaves has failed, in these words, and no other."""
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
    """Workers killed at random instants of runs, until the count is reached."""
    seen = Seen("worker killed at a random instant", "exit 0, the same arrays")
    kills = 0
    with cluster(place) as there:
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
            seen.count(ended(done, 0)[0], ended(done, 0)[1] and place.same("k"))
            shutil.rmtree(place.folder / "k")
    seen.fault += f" ({kills} kills)"
    yield seen


def killed_owners(place: Place, chance: random.Random, count: int) -> Iterator[Seen]:
    """The owner of a run killed at random instants, with two workers of its own; the same command again."""
    seen = Seen("owner of --scheduler distributed killed -9, run again", "exit 0, the same arrays, nothing left")
    words = ("--scheduler", "distributed", "--workers", "2")
    began = time.monotonic()
    place.run(NUMBERS, "o", *words)
    whole = time.monotonic() - began
    shutil.rmtree(place.folder / "o")
    for number in range(count):
        process = place.start(NUMBERS, "o", *words)
        time.sleep(whole * (number + chance.random()) / count)
        below = children(process.pid)
        process.kill()
        process.communicate()
        left = still(below)
        done = place.run(NUMBERS, "o", *words)
        what, right = ended(done, 0)
        seen.count(f"{what}{f', left {left}' if left else ''}", right and place.same("o") and not left)
        shutil.rmtree(place.folder / "o")
    yield seen


def still(pids: list[int], seconds: float = 8.0) -> list[int]:
    """Which of some processes are there after a while."""
    until = time.monotonic() + seconds
    while True:
        alive = []
        for pid in pids:
            with contextlib.suppress(OSError, IndexError):
                if (Path("/proc") / str(pid) / "stat").read_text().rsplit(")", 1)[1].split()[0] != "Z":
                    alive.append(pid)
        if not alive or time.monotonic() > until:
            return alive
        time.sleep(0.1)


def bad_cells(place: Place, *_: object) -> Iterator[Seen]:
    """Cells that kill their worker, take more memory than it may hold, or hang: each fails alone, in words."""
    cases = (("leaves", ("every worker died",), ()), ("grows", ("more memory than a worker may hold (0.40 GB)",), ()))
    cases += (("hangs", ("no answer within 2 s",), ("--cell-timeout", "2")),)  # type: ignore[assignment]
    for where in ("tcp", "own"):
        with contextlib.ExitStack() as stack:
            address = "distributed"
            if where == "tcp":
                address = stack.enter_context(cluster(place, 2, "--memory-limit", "400MB")).address
            for how, words, more in cases:
                if where == "own" and how == "grows":
                    continue  # its workers may hold a share of the machine's memory, which others use
                fault = {"leaves": "poison cell (ends its worker)", "grows": "cell beyond the worker's memory", "hangs": "cell that hangs"}[
                    how
                ]
                seen = Seen(f"{fault}, {address if where == 'own' else 'tcp://'}", "exit 3, that cell alone, the same other arrays")
                done = place.run((*NUMBERS[:20], how, *NUMBERS[20:]), "b", "--scheduler", address, "--workers", "2", *more)
                what, right = failed(done, how, *words)
                seen.count(what, right and place.same("b"))
                shutil.rmtree(place.folder / "b", ignore_errors=True)
                yield seen


def lost_schedulers(place: Place, *_: object) -> Iterator[Seen]:
    """A scheduler that is not there, has no workers, loses them all, or dies."""
    address = f"tcp://127.0.0.1:{free_port()}"
    seen = Seen("no scheduler", "exit 5, one line")
    seen.count(*ended(place.run(NUMBERS, "s", "--scheduler", address), 5, "no Dask scheduler answers there"))
    yield seen
    with Cluster(place) as there:
        seen = Seen("scheduler without workers", "exit 5, one line; then exit 0")
        seen.count(*ended(place.run(NUMBERS, "s", "--scheduler", there.address), 5, "no workers for"))
        for words in ((), ("--no-nanny",)):
            there.add(*words)
        there.wait_for(2)
        yield mended(place, seen, there.address)
        seen = Seen("all workers end", "exit 5, one line; then exit 0")
        process = place.start(NUMBERS, "s", "--scheduler", there.address)
        place.begun("s")
        for worker in there.workers:
            for pid in (worker.pid, *children(worker.pid)):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        seen.count(*ended(in_time(process), 5, "no worker has been there"))
        there.add()
        there.add()
        there.wait_for(2)
        yield mended(place, seen, there.address)
        seen = Seen("scheduler killed -9, started again", "exit 5, one line; then exit 0")
        process = place.start(NUMBERS, "s", "--scheduler", there.address)
        place.begun("s")
        there.scheduler.kill()
        there.scheduler.wait()
        seen.count(*ended(in_time(process), 5, "the scheduler is gone"))
        there.start_scheduler()  # its workers have ended with it
        there.add()
        there.add()
        there.wait_for(2)
        yield mended(place, seen, there.address)
    seen = Seen("scheduler killed -9, on with threads", "exit 5, one line; then exit 0")
    with cluster(place) as there:
        process = place.start(NUMBERS, "s", "--scheduler", there.address)
        place.begun("s")
        there.scheduler.kill()
        there.scheduler.wait()
        seen.count(*ended(in_time(process), 5, "the scheduler is gone"))
    yield mended(place, seen, "threads")


def mended(place: Place, seen: Seen, scheduler: str) -> Seen:
    """The same command again ends with the archive of an undisturbed run."""
    done = place.run(NUMBERS, "s", "--scheduler", scheduler)
    what, right = ended(done, 0)
    if not (right and place.same("s")):
        seen.count(f"then {what}", False)
    shutil.rmtree(place.folder / "s", ignore_errors=True)
    return seen


def fake(folder: Path, distribution: str, version: str) -> Path:
    """Metadata that say that another version of a distribution is installed."""
    info = folder / f"{distribution}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n")
    return folder


def strangers(place: Place, *_: object) -> Iterator[Seen]:
    """Workers that would give other bits, or do not see the archive: refused by name, early and late."""
    without = place.folder / "without"
    without.mkdir()
    (without / "sitecustomize.py").write_text("import sys\nsys.modules['etendue'] = None\n")
    other = brought(place.folder / "other", "1.1")
    hidden = ("unshare", "-m", "sh", "-c", f'mount -t tmpfs none "{place.folder / "x"}" && exec "$@"', "sh")
    (place.folder / "x").mkdir()
    cases = [
        ("worker with another numpy", environment(fake(place.folder / "n", "numpy", "1.0"), place.site), (), "numpy 1.0 (here"),
        ("worker with another etendue", environment(fake(place.folder / "e", "etendue", "9.0"), place.site), (), "etendue 9.0 (here"),
        ("worker with another plugin", environment(other), (), "another code of the stage Toil of toil 1.1 (here of toil 1.0)"),
        ("worker without the plugin", environment(), (), "no stage Lamp of toil 1.0"),
        ("worker without etendue", environment(without), (), "no answer"),
        ("worker that does not see the archive", place.env, hidden, "no archive at"),
    ]
    for fault, env, before, words in cases:
        seen = Seen(fault, "exit 5, named; without it exit 0")
        with cluster(place, 1) as there:
            there.add(env=env, before=before)
            there.wait_for(2)
            seen.count(*ended(place.run(NUMBERS, "x/s", "--scheduler", there.address), 5, words, "the worker tcp://127.0.0.1:"))
        with cluster(place, 1) as there:
            done = place.run(NUMBERS, "x/s", "--scheduler", there.address)
            seen.count(ended(done, 0)[0], ended(done, 0)[1] and place.same("x/s")) if not ended(done, 0)[1] else None
        shutil.rmtree(place.folder / "x" / "s", ignore_errors=True)
        yield seen
    seen = Seen("such a worker joins a run under way", "exit 5, named; without it exit 0")
    with cluster(place, 1) as there:
        process = place.start(NUMBERS, "s", "--scheduler", there.address)
        place.begun("s", 2)
        late = there.add(env=environment(other))
        seen.count(*ended(in_time(process), 5, "another code of the stage", "the worker tcp://127.0.0.1:"))
        for pid in (*children(late.pid), late.pid):
            os.kill(pid, signal.SIGKILL)
        yield mended(place, seen, there.address)


def signalled(place: Place, chance: random.Random, count: int) -> Iterator[Seen]:
    """Ctrl-C and SIGTERM to the whole session of a run with workers of its own."""
    for sent, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
        seen = Seen(f"{sent.name} with --scheduler distributed", f"exit {code}, one line, nothing left; then exit 0")
        for _ in range(max(1, count // 20)):
            process = place.start(NUMBERS, "s", "--scheduler", "distributed", "--workers", "2")
            place.begun("s", chance.randint(0, 30))
            below = children(process.pid)
            os.killpg(process.pid, sent)
            what, right = ended(in_time(process), code, "intact")
            left = still(below)
            seen.count(f"{what}{f', left {left}' if left else ''}", right and not left)
            mended(place, seen, "distributed")
        yield seen


FAULTS: dict[str, Callable[[Place, random.Random, int], Iterator[Seen]]] = {
    "cells": bad_cells, "schedulers": lost_schedulers, "strangers": strangers, "signals": signalled, "workers": killed_workers,
    "owners": killed_owners,
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="kills of workers, and of owners")
    parser.add_argument("--only", nargs="*", choices=FAULTS, default=list(FAULTS))
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    wrong = 0
    print(f"{'fault':62s} | {'expected':54s} | seen as expected")
    with tempfile.TemporaryDirectory() as folder:
        place = Place(Path(folder))
        for name in given.only:
            for seen in FAULTS[name](place, random.Random(given.seed), given.count):
                print(f"{seen.fault:62s} | {seen.expected:54s} | {seen.right} of {seen.tried}", flush=True)
                wrong += seen.right != seen.tried
                if seen.right != seen.tried:
                    print("\n".join(f"    {text}" for text in seen.seen), flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
