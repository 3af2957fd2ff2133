"""What a cell costs where its arrays cost nothing: 16 x 16 pixels, 1e3 to 1e6 cells, and the peak of memory.

    python benchmarks/scale.py [--cells 1000 10000 100000] [--only-plan 1000000]

Every figure is of a process of its own, which has planned and run a small sweep before, CPU time of the process by cell
in us: plan; schedule (plan, jobs and batches); run in memory (kernels, jobs and the tree included); run with every
intermediate stored; the same again, with nothing to compute; ``etendue show``. Memory is the peak above what the
process held before. The same graph in other tools: ``scale_peers.py``.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from plain import HERE, peak_memory, plan_of, timed

WAYS = ("plan", "schedule", "run", "store", "again", "show")
BEHIND = 6  # stages that every point of both axes reaches


def sweep_of(cells: int) -> dict[str, Any]:
    """Axes of about so many cells."""
    first = 10 if cells < 500_000 else 100
    times = max(2, round((cells - 3 * first) / (BEHIND * first)))
    return {
        "sweep.f_number": {"from": 1.4, "to": 22, "steps": first, "spacing": "log"},
        "sweep.integration_time": {"from": "1 ms", "to": "20 ms", "steps": times, "spacing": "log"},
    }


def measure(way: str, cells: int) -> dict[str, Any]:
    from etendue.cli import main
    from etendue.session import Options, execute

    folder = Path(tempfile.mkdtemp())

    def show() -> None:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
            main(["show", str(folder / "whole")])

    try:
        small = plan_of(HERE / "scale.toml")
        if way != "plan":
            execute(small, folder / "small" if way in ("store", "again") else None, Options(scheduler="serial"))
        plan = None if way in ("plan", "schedule") else plan_of(HERE / "scale.toml", **sweep_of(cells))
        if way in ("again", "show"):  # the archive is another process's work, so that its memory is not counted here
            code = (
                "import sys; sys.path.insert(0, sys.argv[1]); import scale; scale.store(int(sys.argv[2]), sys.argv[3])"
            )
            subprocess.run([sys.executable, "-c", code, str(HERE), str(cells), str(folder / "whole")], check=True)
        before = peak_memory()
        if way == "plan":
            wall, cpu, plan = timed(lambda: plan_of(HERE / "scale.toml", **sweep_of(cells)))
        elif way == "schedule":
            wall, cpu, plan = timed(schedule, cells)
        elif way == "run":
            wall, cpu, _ = timed(execute, plan, None, Options(scheduler="serial"))
        elif way in ("store", "again"):
            wall, cpu, _ = timed(execute, plan, folder / "whole", Options(scheduler="serial"))
        elif way == "show":
            wall, cpu, _ = timed(show)
        assert plan is not None
        files = sum(p.is_file() for p in folder.glob("whole/**/*"))
        return {
            "cells": len(plan.cells),
            "wall": wall,
            "cpu": cpu,
            "peak": peak_memory() - before,
            "base": before,
            "files": files,
        }
    finally:
        shutil.rmtree(folder)


def schedule(cells: int) -> Any:
    """Plan, and all that stands between a plan and the first cell."""
    from etendue.compute.jobs import make_jobs
    from etendue.run.batches import partition

    plan = plan_of(HERE / "scale.toml", **sweep_of(cells))
    partition(make_jobs(plan, set(plan.cells), lambda cell: None))
    return plan


def store(cells: int, folder: str) -> None:
    from etendue.session import Options, execute

    execute(plan_of(HERE / "scale.toml", **sweep_of(cells)), folder, Options(scheduler="serial"))


def alone(way: str, cells: int) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, __file__, "--way", way, "--cells", str(cells)], check=True, capture_output=True, text=True
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def main_() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--only-plan", type=int, nargs="*", default=[1_000_000])
    parser.add_argument("--ways", nargs="+", default=["plan", "run", "store", "again", "show"], choices=WAYS)
    parser.add_argument("--way", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.way:
        print(json.dumps(measure(args.way, args.cells[0])))
        return
    print(f"{'way':8} {'cells':>9} {'us a cell':>10} {'wall s':>8} {'peak MB above':>14} {'of MB':>6} {'files':>8}")
    todo = [(way, n) for way in args.ways for n in args.cells]
    for way, n in [*todo, *((way, n) for way in ("plan", "schedule") for n in args.only_plan)]:
        one = alone(way, n)
        print(
            f"{way:8} {one['cells']:9d} {1e6 * one['cpu'] / one['cells']:10.1f} {one['wall']:8.2f} "
            f"{one['peak'] / 1e6:14.0f} "
            f"{one['base'] / 1e6:6.0f} {one['files'] or '':>8}",
            flush=True,
        )


if __name__ == "__main__":
    main_()
