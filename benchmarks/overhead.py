"""What the engine costs: (engine - the same kernels in a plain loop) / loop, without and with storing.

    python benchmarks/overhead.py [--pixels 256] [--repeats 5]

Each way runs in a process of its own, after a small sweep that warms tables and code; one thread (serial scheduler);
the pictures of both are compared bit for bit; the smallest CPU time of the repeats counts. ``append``: the arrays of
the same cells, raw, each with its crc32c, to one open file: what storing them costs at least. In memory the engine
draws no pictures, as the loop does not; an archive has its contact sheet.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from plain import HERE, machine, peak_memory, plan_of, shared, timed
from threadpoolctl import threadpool_limits

SIZES = {"sweep.f_number": [2, 2.8, 4, 5.6, 8], "sweep.aperture_fraction": [0.4, 0.6, 0.8, 1]}
SMALL = {"sweep.f_number": [2, 4], "sweep.aperture_fraction": [0.5, 1], "sweep.integration_time": [0.001, 0.01]}
WAYS = ("loop", "engine", "engine, storing all", "append")


def append(plan, file: Path) -> int:  # type: ignore[no-untyped-def]
    """The arrays of all cells, by size, behind each other; gives their bytes."""
    import google_crc32c

    size = np.dtype(plan.precision).itemsize
    counts = [
        math.prod(cell.grids[v].shape(d.dims))
        for cell in plan.cells.values()
        for v, d in plan.node(cell.node).writes.items()
    ]
    arrays = {count: np.random.default_rng(1).random(count).astype(plan.precision) for count in set(counts)}
    for array in arrays.values():
        array.flags.writeable = False
    handle = os.open(file, os.O_WRONLY | os.O_CREAT)
    for count in counts:
        array = arrays[count].view(np.uint8)
        os.writev(handle, [array, int(google_crc32c.value(array)).to_bytes(4, "little")])
    os.close(handle)
    return size * sum(counts)


def sized(pixels: int) -> dict[str, str]:
    """What to set for a frame of this many pixels in each direction."""
    return {"scene.width": f"{5.4 * pixels:g} um", "scene.height": f"{5.4 * pixels:g} um"}


def measure(way: str, pixels: int) -> dict:  # type: ignore[type-arg]
    """One way, once, in this process."""
    from etendue.run.memory import keep_freed_memory
    from etendue.session import Options, execute

    keep_freed_memory()  # both ways profit from it
    np.ones(
        800 << 20, np.uint8
    )  # memory the machine has never touched costs more than filling it: the same for all ways
    keep = "all" if way.endswith("all") else ["rgb_display"]
    plan, small = (plan_of(HERE / "one_sample.toml", **own, **sized(pixels), keep=keep) for own in (SIZES, SMALL))
    folder = Path(tempfile.mkdtemp())
    digest, size = hashlib.sha256(), 0
    with threadpool_limits(1):
        if way == "loop":
            shared(small)
            wall, cpu, results = timed(shared, plan)
            for point in sorted(results):
                digest.update(results[point].tobytes())
        elif way == "append":
            wall, cpu, size = timed(append, plan, folder / "file")
        else:
            options = Options(scheduler="serial", pictures=False)
            archive = [folder / "small", folder / "whole"] if way.endswith("all") else [None, None]
            execute(small, archive[0], options)
            wall, cpu, outcome = timed(execute, plan, archive[1], options)
            if archive[1] is None:
                for cell in plan.of("encode"):
                    digest.update(outcome.arrays[cell.ref]["rgb_display"].tobytes())
            else:
                size = sum(p.stat().st_size for p in archive[1].rglob("*") if p.is_file())
    shutil.rmtree(folder)
    points = len(plan.of("encode"))
    return {
        "wall": wall,
        "cpu": cpu,
        "digest": digest.hexdigest(),
        "bytes": size,
        "memory": peak_memory(),
        "cells": len(plan.cells),
        "points": points,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--pixels", type=int, default=256, help="of a row and of a column")
    parser.add_argument("--one", choices=WAYS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(arguments.one, arguments.pixels)))
        return
    runs: dict[str, list[dict]] = {way: [] for way in WAYS}  # type: ignore[type-arg]
    for _ in range(arguments.repeats):
        for way in WAYS:
            text = subprocess.run(
                [sys.executable, __file__, "--one", way, "--pixels", str(arguments.pixels)],
                check=True,
                capture_output=True,
                text=True,
            ).stdout
            runs[way].append(json.loads(text))
    assert {r["digest"] for r in runs["loop"]} == {r["digest"] for r in runs["engine"]}, (
        "engine and loop give different bits"
    )
    first = runs["engine"][0]
    print(
        f"{arguments.pixels} x {arguments.pixels} pixels, "
        f"3 bands, {first['points']} points ({first['cells']} cells), float32, one thread, "
        f"{machine()}, "
        f"best of {arguments.repeats} processes, same bits"
    )
    cpu = {way: min(r["cpu"] for r in found) for way, found in runs.items()}
    for way, found in runs.items():
        wall, memory = min(r["wall"] for r in found), max(r["memory"] for r in found)
        print(
            f"{way:22s} wall {wall:7.3f} s   CPU {cpu[way]:7.3f} s   {1e3 * cpu[way] / first['points']:6.2f} ms a "
            f"point   "
            f"peak memory {memory / 1e6:5.0f} MB"
        )
    print(
        f"engine minus loop {1e3 * (cpu['engine'] - cpu['loop']) / first['points']:.2f} ms a point, storing all minus "
        f"loop {1e3 * (cpu['engine, storing all'] - cpu['loop']) / first['points']:.2f} ms"
    )
    print(f"overhead without storing   {100 * (cpu['engine'] / cpu['loop'] - 1):6.1f} %   (goal <= 10 %)")
    stored = runs["engine, storing all"][0]["bytes"]
    storing = 100 * (cpu["engine, storing all"] / cpu["loop"] - 1)
    print(f"overhead, storing all      {storing:6.1f} %   ({stored / 1e6:.0f} MB: all variables of all cells)")
    each = {way: 1e3 * cpu[way] / first["points"] for way in WAYS}
    cost = each["engine, storing all"] - each["engine"]
    appended = runs["append"][0]["bytes"]
    print(
        f"storing {cost:.2f} ms a point, appending raw with crc32c to one file {each['append']:.2f} ms "
        f"({appended / 1e6:.0f} MB): "
        f"{cost / each['append']:.2f} x   (goal <= 2)"
    )
    print(
        f"share of storing           {100 * (1 - cpu['engine'] / cpu['engine, storing all']):6.1f} %   of the engine's "
        f"CPU time"
    )


if __name__ == "__main__":
    main()
