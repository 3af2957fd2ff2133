"""The cases that were timed against Pyxel: 200 points of a CMOS sweep at 256 x 256.

    python benchmarks/pyxel_case.py [--sweep own] [--repeats 3] [--workers 2]

``pitches``: 5 f-numbers x 5 pixel pitches x 8 times, which Pyxel cannot sweep; ``own``: its own sweep, as in
`pyxel_peer.py`: 5 f-numbers (its point spread functions) x 5 dark rates x 8 read noises.

Ways: in memory with the picture kept, and everything kept in Zarr; the first call in a process and the calls after it,
in wall seconds. A monochrome camera up to its codes, as Pyxel's is. The first call includes the imports that it asks
for; `import etendue` is counted apart. Pyxel on as many points: `pyxel_peer.py`; once 9.65 to 9.85 s (3.0.2, Dask
threads, warm, the image kept): `--reference`.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

PITCHES = [4.2, 4.5, 4.8, 5.1, 5.4]
CASE: dict[str, Any] = {
    "name": "cmos",
    "precision": "float32",
    "wanted": ["raw"],
    "camera": {
        "focal_length": 6.93,
        "pattern": "mono",
        "peak_qe": [0.5],
        "sensitivity_kind": "filter_transmittance",
        "full_well_density": 2000.0,
        "read_noise": 4,
    },
    "stages": [
        {
            "use": "photograph",
            "name": "scene",
            "file": "package:matplotlib/mpl-data/sample_data/grace_hopper.jpg",
            "white_luminance": 10000,
            "width": 1400,
            "height": 1400,
            "spacing": 5,
            "wavelength_from": 400,
            "wavelength_to": 700,
            "bin_width": 100,
        },
        {"use": "irradiance"},
        {"use": "diffraction"},
        {"use": "pixel", "rows": 256, "columns": 256},
        {"use": "mosaic"},
        *({"use": name} for name in ("exposure", "shot_noise", "full_well", "read_noise", "adc")),
    ],
}
F_NUMBERS = [2, 2.8, 4, 5.6, 8]
ELECTRON_PER_SECOND = 1.602176634e-19 / 25e-8  # A/cm2, of a pixel of 5 um
SWEEPS: dict[str, dict[str, Any]] = {
    "pitches": {
        "sweep": {
            "f_number": F_NUMBERS,
            "pixel_pitch": PITCHES,
            "integration_time": {"from": 0.001, "to": 0.02, "steps": 8, "spacing": "log"},
        }
    },
    "own": {
        "camera": {**CASE["camera"], "pixel_pitch": 5, "integration_time": 0.01},
        "sweep": {
            "f_number": F_NUMBERS,
            "dark_current_density": [rate * ELECTRON_PER_SECOND for rate in (1, 3, 10, 30, 100)],
            "read_noise": [1, 2, 3, 4, 5, 6, 7, 8],
        },
    },
}
WAYS = ("in memory", "everything in Zarr")


def measure(way: str, sweep: str, calls: int, workers: int) -> dict[str, Any]:
    began = time.perf_counter()
    import etendue  # noqa: F401

    imported = time.perf_counter() - began
    folder, seconds, cpu, points, failed = Path(tempfile.mkdtemp()), [], [], 0, []
    for number in range(calls):
        began, spent = time.perf_counter(), time.process_time()
        from etendue.contract.registry import installed_stages
        from etendue.pipeline.file import from_document
        from etendue.plan.planner import make_plan
        from etendue.session import Options, execute

        stored = way != WAYS[0]
        plan = make_plan(
            from_document({**CASE, **SWEEPS[sweep], "keep": "all" if stored else ["raw"]}), installed_stages()
        )
        outcome = execute(plan, folder / str(number) if stored else None, Options("threads", workers))
        seconds.append(time.perf_counter() - began)
        cpu.append(time.process_time() - spent)
        points, failed = len(plan.of("adc")), outcome.failed
        assert not failed, failed[0].message
        del outcome
    files = sum(path.is_file() for path in (folder / "0").rglob("*")) if (folder / "0").exists() else 0
    shutil.rmtree(folder)
    return {
        "import": imported,
        "first": seconds[0],
        "warm": min(seconds[1:]),
        "cpu": min(cpu[1:]),
        "first cpu": cpu[0],
        "points": points,
        "files": files,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3, help="processes for each way")
    parser.add_argument("--calls", type=int, default=4, help="calls in each process")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--reference", type=float, default=9.7, help="seconds that Pyxel takes, warm")
    parser.add_argument("--sweep", choices=SWEEPS, default="pitches")
    parser.add_argument("--one", choices=WAYS, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(json.dumps(measure(asked.one, asked.sweep, asked.calls, asked.workers)))
        return
    print(f"Pyxel 3.0.2, measured elsewhere: {asked.reference:g} s")
    for way in WAYS:
        command = [sys.executable, __file__, "--one", way, "--sweep", asked.sweep]
        command += ["--calls", str(asked.calls), "--workers", str(asked.workers)]
        found = [
            json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
            for _ in range(asked.repeats)
        ]
        best = {name: min(one[name] for one in found) for name in ("import", "first", "warm", "cpu", "first cpu")}
        print(
            f"{way:20s} {found[0]['points']} points   warm {best['warm']:6.2f} s "
            f"({asked.reference / best['warm']:4.1f} x)   "
            f"first call {best['first']:6.2f} s ({asked.reference / best['first']:4.1f} x)   "
            f"CPU {best['cpu']:6.2f} and {best['first cpu']:6.2f} s   import {best['import']:5.2f} s   "
            f"{found[0]['files']} files"
        )


if __name__ == "__main__":
    main()
