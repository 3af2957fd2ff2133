"""A 1000-cell sweep against evaluating every point from the scene on.

    python benchmarks/sweep.py [--only one_sample|sweep]

(a) one sample per pixel, three bands, exact Poisson noise: engine against two naive scripts, each on 20 random cells,
scaled to 1000; (b) pipelines/sweep.toml as it stands, archived, against the same chain evaluated point by point.
"""

from __future__ import annotations

import argparse
import random
import shutil
import statistics
import tempfile
from pathlib import Path

from plain import HERE, machine, naive, peak_memory, plan_of, timed
from threadpoolctl import threadpool_limits

from etendue.session import Options, execute

CELLS = 20
WARM = {"sweep.f_number": [2], "sweep.aperture_fraction": [0.5], "sweep.integration_time": [0.001, 0.01]}


def naive_seconds(plan, separate: bool) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Mean wall and CPU seconds of one point over 20 random ones."""
    draw = random.Random(1)
    points = [tuple(draw.randrange(len(axis.values)) for axis in plan.axes) for _ in range(CELLS)]
    with threadpool_limits(1):
        naive(plan, points[0], separate)
        runs = [timed(naive, plan, point, separate) for point in points]
    return statistics.mean(r[0] for r in runs), statistics.mean(r[1] for r in runs)


def describe(name: str, plan) -> None:  # type: ignore[no-untyped-def]
    cell = plan.cells[next(ref for ref in plan.cells if ref[0] == "scene")]
    grid = cell.grids["radiance"]
    out = plan.cells[("pixel", (0, 0))].grids["photon_rate"]
    print(
        f"{name}: light {grid['y'].size} x {grid['x'].size} x {grid['wavelength'].size} bands, pixels {out['y'].size} "
        f"x {out['x'].size}, "
        f"{plan.precision}, {len(plan.cells)} cells for 1000 points, {machine()}"
    )


def engine_runs(plan, archive: bool) -> None:  # type: ignore[no-untyped-def]
    rows = {}
    execute(plan_of(HERE / "one_sample.toml", **WARM), None, Options(scheduler="serial"))
    for label, options in (("1 thread", Options(scheduler="serial")), ("2 threads", Options(workers=2))):
        folder = Path(tempfile.mkdtemp())
        wall, cpu, outcome = timed(execute, plan, folder / "archive" if archive else None, options)
        size = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
        shutil.rmtree(folder)
        assert not outcome.failed
        rows[label] = (wall, cpu)
        kept = (
            f"{size / 1e6:.0f} MB stored"
            if archive
            else "one figure of each picture kept, as the naive scripts keep none"
        )
        print(f"  engine, {label:10s} wall {wall:7.2f} s   CPU {cpu:7.2f} s   {kept}")
    base = rows["1 thread"], rows["2 threads"]
    for separate, text in (
        (True, "naive script: float64, a transform pair for every blur"),
        (False, "naive loop: the same joined float32 kernels, nothing shared"),
    ):
        wall, cpu = naive_seconds(plan, separate)
        print(
            f"  {text}: {1e3 * wall:.1f} ms a point (mean of {CELLS} random cells), scaled to 1000: {1000 * wall:.1f} "
            f"s; "
            f"engine/naive {base[0][1] / (1000 * cpu):.3f} by CPU (1 thread), {base[1][0] / (1000 * wall):.3f} by wall "
            f"(2 threads)"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("one_sample", "sweep"))
    only = parser.parse_args().only
    if only != "sweep":
        plan = plan_of(HERE / "one_sample.toml", keep=["gamut_clipped"])
        describe("one sample per pixel, exact Poisson noise (goal: engine/naive <= 0.167)", plan)
        engine_runs(plan, archive=False)
        print(f"  peak memory {peak_memory() / 1e6:.0f} MB resident")
    if only != "one_sample":
        plan = plan_of(HERE.parent / "pipelines" / "sweep.toml")
        describe("pipelines/sweep.toml (no goal yet)", plan)
        engine_runs(plan, archive=True)
        print(f"  peak memory {peak_memory() / 1e6:.0f} MB resident")


if __name__ == "__main__":
    main()
