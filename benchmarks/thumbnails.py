"""What pictures for the sheet cost of a frame of 12 Mpixel, from raw to colour through the engine: share of its CPU
time, and memory.

    python benchmarks/thumbnails.py [--root CHECKOUT ...] [--rows 3000] [--columns 4000] [--repeats 2]

Each checkout runs by its own ``.venv`` in a process of its own, one thread, one variable kept. Memory is the largest
resident set above that in front of the run.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent.parent
STAGES = (
    "irradiance",
    "pixel",
    "mosaic",
    "exposure",
    "shot_noise",
    "full_well",
    "read_noise",
    "adc",
    "linearise",
    "white",
    "demosaic_bilinear",
    "colour_fit",
    "camera_to_xyz",
    "balance",
    "display",
    "encode",
)


def pipeline(rows: int, columns: int) -> dict[str, Any]:
    scene = {
        "use": "slanted_edge",
        "name": "scene",
        "width": 3 * columns,
        "height": 3 * rows,
        "spacing": 3,
        "white_luminance": 100,
        "wavelength_from": 400,
        "wavelength_to": 700,
        "bin_width": 100,
    }
    camera = {"f_number": 4, "pixel_pitch": 3, "peak_qe": [0.4, 0.5, 0.4], "pattern": "RGGB", "integration_time": 0.01}
    stages = [scene, *({"use": name} for name in STAGES)]
    return {"name": "large", "precision": "float32", "keep": ["encode"], "camera": camera, "stages": stages}


def timed(owner: Any, name: str, spent: list[float]) -> None:
    """Add what a function takes to a list."""
    kept = getattr(owner, name)

    @functools.wraps(kept)
    def timing(*args: Any, **words: Any) -> Any:
        began = time.thread_time()
        try:
            return kept(*args, **words)
        finally:
            spent.append(time.thread_time() - began)

    setattr(owner, name, timing)


def child(rows: int, columns: int) -> None:
    from etendue.contract.registry import installed_stages
    from etendue.plan.planner import make_plan
    from etendue.present.pictures import pictures
    from etendue.session import Options, execute, from_document

    spent: list[float] = []
    try:
        from etendue.present.pictures import thumbnails

        timed(thumbnails.Observer, "__call__", spent)
    except ImportError:  # of a checkout that makes pictures at the end
        pass
    timed(pictures, "render", spent)
    with tempfile.TemporaryDirectory() as folder:
        execute(
            make_plan(from_document(pipeline(64, 64)), installed_stages()), Path(folder) / "warm", Options("serial")
        )
        spent.clear()
        plan = make_plan(from_document(pipeline(rows, columns)), installed_stages())
        base, began = 4096 * int(Path("/proc/self/statm").read_text().split()[1]), time.process_time()
        outcome = execute(plan, Path(folder) / "large", Options("serial"))
        seconds = time.process_time() - began
        assert not outcome.failed, outcome.failed
    peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - base
    print(json.dumps({"seconds": seconds, "pictures": sum(spent), "bytes": peak}))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--root", type=Path, action="append", default=[], help="another checkout, with a .venv; may be repeated"
    )
    for name, default in (("rows", 3000), ("columns", 4000), ("repeats", 2)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--child", action="store_true")
    asked = parser.parse_args()
    if asked.child:
        child(asked.rows, asked.columns)
        return
    print(f"{'checkout':16s} {'run, CPU s':>10s} {'pictures':>9s} {'share':>7s} {'bytes a pixel':>13s}")
    for root in [*(root.resolve() for root in asked.root), HERE]:
        words = [root / ".venv/bin/python", __file__, "--child", f"--rows={asked.rows}", f"--columns={asked.columns}"]
        done = [
            subprocess.run(words, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
            for _ in range(asked.repeats)
        ]
        if failed := [one.stderr for one in done if one.returncode]:
            raise SystemExit(failed[0])
        best = min((json.loads(one.stdout.splitlines()[-1]) for one in done), key=lambda found: found["seconds"])
        share, pixels = best["pictures"] / best["seconds"], asked.rows * asked.columns
        print(
            f"{root.name[-16:]:16s} {best['seconds']:10.2f} {best['pictures']:9.2f} {100 * share:6.1f}% "
            f"{best['bytes'] / pixels:13.0f}"
        )


if __name__ == "__main__":
    main()
