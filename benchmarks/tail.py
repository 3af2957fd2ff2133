"""The paper's camera behind its optics, from the photocurrent to XYZ, 256 x 256: milliseconds by stage, against a
compiled floor.

    python benchmarks/tail.py [--repeats 60]

Each stage is the one that ``pipelines/paper.toml`` runs, in float32 as the floor is, one thread, best of the repeats.
(The plan takes float64 for this photograph, whose darkest light is beyond float32's transforms at the tolerance: that
sum stands below.) The floor is ``tail_floor.c``, compiled beside it if there is a C compiler: one normal per pixel,
nothing stored between, nothing checked. Then the whole run of ``pipelines/paper.toml`` as a user sees it, start of
Python included, with and without an archive; the paper says 5 s for its chain in Matlab.
"""

from __future__ import annotations

import argparse
import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from etendue.compute.cell import check
from etendue.compute.given import arguments
from etendue.compute.jobs import make_jobs
from etendue.compute.joined.segments import Result
from etendue.compute.random import philox
from etendue.contract.registry import installed_stages
from etendue.plan.planner import make_plan
from etendue.run.memory import keep_freed_memory
from etendue.session import Options, execute, load

HERE = Path(__file__).parent
PAPER = HERE.parent / "pipelines" / "paper.toml"
CHAIN = (
    "exposure",
    "shot_noise",
    "full_well",
    "read_noise",
    "adc",
    "linearise",
    "balance_mosaic",
    "demosaic",
    "sharpen",
    "camera_to_xyz",
    "balance",
    "display",
    "encode",
    "to_xyz",
)


def best(function: Callable[[], Any], repeats: int) -> float:
    """Smallest milliseconds of a thread's time."""
    shortest = float("inf")
    for _ in range(repeats):
        began = time.thread_time()
        function()
        shortest = min(shortest, time.thread_time() - began)
    return 1e3 * shortest


def stages(repeats: int, precision: str) -> dict[str, tuple[float, float]]:
    """By stage: milliseconds of its ``run``, and of all that the engine does for its cell."""
    plan = make_plan(
        load(PAPER, {"wanted": ["rgb_display", "xyz_display"], "precision": precision}), installed_stages()
    )
    outcome = execute(plan, None, Options(scheduler="serial"))
    jobs = make_jobs(plan, set(plan.cells), lambda cell: None, deliver_all=True)
    results = {ref: Result(arrays=dict(arrays)) for ref, arrays in outcome.arrays.items()}
    found = {}
    for job in jobs.values():
        if job.ref[0] in CHAIN:
            given = arguments(job, results, [])

            def run(job: Any = job, given: Any = given) -> Any:
                return job.stage.run(**{**given, **({"rng": philox(job.seed)} if "rng" in given else {})})

            def whole(job: Any = job) -> Any:
                return check(job, job.stage.run(**arguments(job, results, [])))

            found[job.ref[0]] = (best(run, repeats), best(whole, repeats))
    return found


def generator(repeats: int) -> float:
    """Two normals a pixel from the generator, in place: what noise costs before any arithmetic."""
    rng, out = philox(b"tail"), np.empty((256, 256), np.float32)
    return best(
        lambda: (rng.standard_normal(out=out, dtype=np.float32), rng.standard_normal(out=out, dtype=np.float32)),
        repeats,
    )


def floor(repeats: int) -> float | None:
    """Milliseconds of the compiled chain; None without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "tail_floor.so"
        flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
        subprocess.run([compiler, *flags, str(HERE / "tail_floor.c"), "-o", str(library)], check=True)
        tail = ctypes.CDLL(str(library)).tail
    mean = np.random.default_rng(1).uniform(100, 20000, (256, 256)).astype(np.float32)
    matrix = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.0, -0.3, 1.3]], np.float32)
    rgb, xyz = np.empty((3, 256, 256), np.float32), np.empty((3, 256, 256), np.float32)

    def pointer(array: Any) -> Any:
        return array.ctypes.data_as(ctypes.POINTER(ctypes.c_float))

    plain = [ctypes.c_float(v) for v in (109.0, 23600.0, 0.17, 64.0, 4095.0, 0.1)]
    return best(
        lambda: tail(pointer(mean), 256, 256, 7, *plain, pointer(matrix), pointer(matrix), pointer(rgb), pointer(xyz)),
        repeats,
    )


def command(*options: str) -> float:
    """Wall seconds of a command of a user."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "etendue", "run", str(PAPER), *options], check=True, capture_output=True, cwd=folder
        )
        return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=60)
    repeats = parser.parse_args().repeats
    keep_freed_memory()
    lowest = floor(repeats)
    found, double = stages(repeats, "float32"), stages(max(repeats // 3, 5), "float64")
    print(f"{'stage':16s} {'run, ms':>8s} {'in the engine, ms':>18s}")
    for name, (run, whole) in found.items():
        print(f"{name:16s} {run:8.3f} {whole:18.3f}")
    total, engine = (sum(values[i] for values in found.values()) for i in (0, 1))
    print(f"{'sum':16s} {total:8.3f} {engine:18.3f}")
    print(f"the same in float64, as the plan chooses for this scene: {sum(run for run, _ in double.values()):.3f} ms")
    print(f"of it numpy's generator alone, two normals a pixel: {generator(repeats):.3f} ms")
    if lowest is None:
        print("no C compiler: no floor")
    else:
        again = min(lowest, floor(repeats) or lowest)
        print(f"floor compiled here {again:.3f} ms: sum / floor {total / again:.1f} (goal <= 5)")
    print(
        f"the whole paper run, as a command: {min(command() for _ in range(2)):.2f} s with archive and contact sheet "
        f"(the paper: 5 s)"
    )


if __name__ == "__main__":
    main()
