"""A design killed at random instants, extended, resumed, on one thread, threads and two worker processes: one digest.

python benchmarks/design_kills.py [KILLS]
"""

from __future__ import annotations

import hashlib
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from identity import digests

from etendue.archive.checks.verify import verify
from etendue.session import Options, execute
from tests.designs.given import plan_of

METHODS = ("sobol", "saltelli")
POINTS = (8, 16, 32)
WAYS = (
    Options("serial", pictures=False),
    Options("threads", 2, pictures=False),
    Options("processes", 2, pictures=False),
)


def run(archive: Path, method: str, points: int, options: Options, after: float | None = None) -> bool:
    """Run a design in a process of its own, killed after some seconds; return whether it was killed."""
    child = os.fork()
    if not child:
        outcome = execute(plan_of({"design.method": method, "design.points": points}), archive, options)
        os._exit(bool(outcome.failed))
    if after is not None:
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    killed = os.WIFSIGNALED(status)
    if not killed and os.WEXITSTATUS(status):
        raise RuntimeError(f"{method}, {points} points: the run failed")
    return killed


def digest_of(archive: Path) -> str:
    assert verify(archive).whole
    return hashlib.sha256(repr(sorted(digests(archive))).encode()).hexdigest()[:16]


def main(kills: int = 20) -> int:
    """Print the digests; return 1 if any differs."""
    draw, wrong = random.Random(1), 0
    for method in METHODS:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            execute(plan_of({"design.method": method}), None, WAYS[0])  # imports and caches
            began = time.perf_counter()
            run(folder / "once", method, POINTS[-1], WAYS[0])
            seconds, known = time.perf_counter() - began, digest_of(folder / "once")
            print(f"{method}: at once, in {seconds:.2f} s: {known}", flush=True)
            for number, options in enumerate(WAYS):
                archive, done = folder / options.scheduler, 0
                wanted = kills // (2 * len(WAYS)) + (number == 0) * (kills // 2 % len(WAYS))
                while done < wanted:
                    points = POINTS[min(done * len(POINTS) // wanted, len(POINTS) - 1)]
                    done += run(archive, method, points, options, draw.uniform(0.02, seconds))
                for points in (POINTS[0], POINTS[-1]):  # of an archive that has more, fewer points: nothing to do
                    run(archive, method, points, options)
                found = digest_of(archive)
                wrong += found != known
                print(f"{method}: {options.scheduler}, {done} kills: {found}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:2])))
