"""Send Ctrl-C or SIGTERM at any instant of a run: output, exit code, leftovers, and whether the next run resumes.

    python benchmarks/faults/signals.py 60 --scheduler threads

sends one signal to each of 60 runs of ``pipelines/smallest.toml``, at instants spread from the start of the process to
its end. A signal before the program's first instruction (while Python itself starts) ends the process by the signal, as
with any other program.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from processes import of_session, still

from tests.archive.tiny import store_of

HERE = Path(__file__).parent
PIPELINE = HERE.parent.parent / "pipelines" / "smallest.toml"
SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass
class Ended:
    """How one run ended."""

    sent: signal.Signals
    at: float  # share of an undisturbed run
    code: int
    lines: list[str]
    seconds: float  # from the signal to the end
    left: list[str]  # processes and half-written files
    mended: bool = True  # the next run finished and equals an undisturbed one

    @property
    def kind(self) -> str:
        if self.code == 0:
            return "already over"
        if self.code == 128 + self.sent and len(self.lines) == 1 and "Traceback" not in self.lines[0]:
            return "orderly"
        return "before start-up" if self.code == -self.sent and not self.lines else "raw"


def command(pipeline: Path, archive: Path, scheduler: str) -> list[str]:
    return [
        sys.executable,
        "-m",
        "etendue",
        "run",
        str(pipeline),
        "--archive",
        str(archive),
        "--quiet",
        "--scheduler",
        scheduler,
    ]


def interrupted(
    pipeline: Path, archive: Path, scheduler: str, sent: signal.Signals, wait: float, whole: float, again: int = 0
) -> Ended:
    """Start a run, send it a signal after ``wait`` seconds (and ``again`` more soon after), and return how it ends."""
    process = subprocess.Popen(
        command(pipeline, archive, scheduler),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # shells ignore it for background processes
    )
    time.sleep(wait)
    began = time.monotonic()
    for _ in range(1 + again):
        try:
            os.killpg(process.pid, sent)  # to the workers too, as a terminal does
        except ProcessLookupError:
            break
        time.sleep(0.01 if again else 0)
    _, said = process.communicate(timeout=120)
    seconds = time.monotonic() - began
    left = [str(path.name) for path in archive.rglob("*.partial")]
    left += [f"process {pid}" for pid in still(of_session(process.pid), 5.0)]
    lines = [line for line in said.splitlines() if not line.startswith("note: ")]  # messages of stages may precede it
    return Ended(sent, wait / whole, process.returncode, lines, seconds, left)


def same(first: Path, second: Path) -> bool:
    """Return whether every chunk of every stage of two archives is the same; times and the order of chunks in a shard
    may differ.
    """
    files = [{path: data for path, data in store_of(folder).items() if _of_a_stage(path)} for folder in (first, second)]
    return bool(files[0]) and files[0] == files[1]


def _of_a_stage(path: str) -> bool:
    return path.split("/")[0] not in ("ledger", "summary", "frames", "zarr.json")


def measure(pipeline: Path, kills: int, scheduler: str, seed: int, again: int, place: Path) -> list[Ended]:
    """Interrupt this many runs, each followed by one that finishes it."""
    began = time.monotonic()
    subprocess.run(
        command(pipeline, place / "whole", scheduler), check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    whole = time.monotonic() - began
    chance = random.Random(seed)
    found = []
    for number in range(kills):
        archive = place / f"{number}"
        wait = whole * (number + chance.random()) / kills
        ended = interrupted(pipeline, archive, scheduler, SIGNALS[number % 2], wait, whole, again)
        after = subprocess.run(command(pipeline, archive, scheduler), capture_output=True, text=True, check=False)
        ended.mended = after.returncode == 0 and same(archive, place / "whole") and not list(archive.rglob("*.part*"))
        found.append(ended)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kills", type=int, nargs="?", default=60)
    parser.add_argument("--scheduler", default="threads")
    parser.add_argument("--pipeline", type=Path, default=PIPELINE)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--again", type=int, default=0, help="number of further signals, 10 ms apart")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        found = measure(given.pipeline, given.kills, given.scheduler, given.seed, given.again, Path(place))
    print(f"{'signal':8s} {'ended':20s} {'runs':>5s} {'resumed':>7s} {'left':>5s} {'slowest':>9s}")
    for (sent, kind), count in sorted(Counter((e.sent.name, e.kind) for e in found).items()):
        own = [e for e in found if (e.sent.name, e.kind) == (sent, kind)]
        print(
            f"{sent:8s} {kind:20s} {count:5d} {sum(e.mended for e in own):7d} {sum(bool(e.left) for e in own):5d} "
            f"{max(e.seconds for e in own):7.2f} s"
        )
    for ended in found:
        if ended.kind == "raw" or ended.left or not ended.mended:
            print(f"{ended.sent.name} at {ended.at:.2f}: code {ended.code}, left {ended.left}, resumed {ended.mended}")
            print("\n".join(f"    {line}" for line in ended.lines[-6:]))


if __name__ == "__main__":
    main()
