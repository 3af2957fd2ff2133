"""What the engine costs: (engine - the same kernels in a plain loop) / loop, at 256 x 256, without and with storing.

    python benchmarks/overhead.py [--repeats 3]

One thread each (serial scheduler), the same bits checked, smallest CPU time of the repeats, alternating.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from pathlib import Path

import numpy as np
from plain import HERE, machine, peak_memory, plan_of, shared, timed
from threadpoolctl import threadpool_limits

from etendue.session import Options, execute


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    sizes = {"sweep.f_number": [2, 4, 8], "sweep.aperture_fraction": [0.5, 0.75, 1], "sweep.integration_time": [0.001, 0.002, 0.003, 0.005, 0.01, 0.012, 0.015, 0.02]}
    in_memory = plan_of(HERE / "one_sample.toml", **sizes, keep=["rgb_display"])
    stored = plan_of(HERE / "one_sample.toml", **sizes)
    options = Options(scheduler="serial")
    best = {"loop": [9e9, 9e9], "engine": [9e9, 9e9], "engine, storing all": [9e9, 9e9]}

    def note(name: str, wall: float, cpu: float) -> None:
        best[name] = [min(best[name][0], wall), min(best[name][1], cpu)]

    size = 0
    with threadpool_limits(1):
        shared(in_memory)  # tables of colour-science, code, caches of the machine: warm for all
        execute(in_memory, None, options)
        for _ in range(repeats):
            wall, cpu, loop = timed(shared, in_memory)
            note("loop", wall, cpu)
            wall, cpu, outcome = timed(execute, in_memory, None, options)
            note("engine", wall, cpu)
            for point, picture in loop.items():
                assert np.array_equal(outcome.arrays[("encode", point)]["rgb_display"], picture), f"engine and loop differ at {point}"
            folder = Path(tempfile.mkdtemp()) / "archive"
            wall, cpu, _ = timed(execute, stored, folder, options)
            note("engine, storing all", wall, cpu)
            size = sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())
            shutil.rmtree(folder.parent)
    points = len(loop)
    print(f"256 x 256 pixels, 3 bands, {points} points ({len(in_memory.cells)} cells), float32, one thread, {machine()}, best of {repeats}")
    for name, (wall, cpu) in best.items():
        print(f"{name:22s} wall {wall:7.3f} s   CPU {cpu:7.3f} s   {1e3 * cpu / points:6.2f} ms a point")
    loop_cpu = best["loop"][1]
    print(f"overhead without storing   {100 * (best['engine'][1] - loop_cpu) / loop_cpu:6.1f} %   (goal <= 10 %)")
    print(f"overhead, storing all      {100 * (best['engine, storing all'][1] - loop_cpu) / loop_cpu:6.1f} %   ({size / 1e6:.0f} MB, all variables of all cells)")
    share = (best["engine, storing all"][1] - best["engine"][1]) / best["engine, storing all"][1]
    print(f"share of storing           {100 * share:6.1f} %   of the engine's CPU time")
    print(f"peak memory                {peak_memory() / 1e6:6.0f} MB resident (all results of the loop and the engine held)")


if __name__ == "__main__":
    main()
