"""What being left out saves: seconds and bytes at several tolerances in turn, a line's light beside daylight, and a
figure that needs no picture.

    python benchmarks/left_out_seconds.py [--pipelines paper_physical sweep] [--tolerances 1e-1 ...] [--repeats 5]

Rows: a pipeline with nothing left out ("reference") and at each tolerance, in turn, there and back, into archives.
Columns: thread seconds of the stages (least, median, largest of the repeats) and the least as a share of the
reference's; the same of the wall; bytes of the archive; milliseconds that a cell which is left out costs, and the bytes
of variables whose cells are all left out. Below: paper_physical.toml from scene to pixel under 550 nm and under D65,
and sweep.toml with --want mtf50_lp_mm, with the number of its pixel cells.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

PIPELINES = Path(__file__).parent.parent / "pipelines"
TOLERANCES = ("1e-1", "1e-2", "1e-3", "1e-4", "1e-6")
LIGHT = ("scene", "irradiance", "falloff", "lens", "aperture", "diffraction", "diffusion", "glare", "pixel")


def run(name: str, *options: str) -> dict[str, Any]:
    """Run a pipeline into a new archive and return its JSON, with its wall seconds and bytes."""
    with tempfile.TemporaryDirectory() as place:
        archive = Path(place, "archive.zarr")
        began = time.perf_counter()
        words = ["run", str(PIPELINES / f"{name}.toml"), "--archive", str(archive), "--no-errors", "--json", *options]
        done = subprocess.run([sys.executable, "-m", "etendue", *words], capture_output=True, text=True)
        wall = time.perf_counter() - began
        if done.returncode:
            raise RuntimeError(done.stderr)
        bytes_of = {p.relative_to(archive).parts[0]: 0 for p in archive.rglob("*") if p.is_file()}
        for path in archive.rglob("*"):
            if path.is_file():
                bytes_of[path.relative_to(archive).parts[0]] += path.stat().st_size
        return json.loads(done.stdout) | {"wall": wall, "bytes": bytes_of}


def spent(found: dict[str, Any], names: tuple[str, ...] = ()) -> float:
    return sum(one["seconds"] for one in found["stages"] if not names or one["name"] in names)


def table(name: str, tolerances: list[str], repeats: int) -> None:
    asked = {"reference": ("--nothing-left-out",)} | {each: ("--tolerance", each) for each in tolerances}
    rows: dict[str, list[dict[str, Any]]] = {label: [] for label in asked}
    for turn in range(repeats):  # the order turns round, as what runs first finds other memory than what runs last
        for label, options in list(asked.items())[:: -1 if turn % 2 else 1]:
            rows[label].append(run(name, *options))
    whole, wall = (min(of(one) for one in rows["reference"]) for of in (spent, lambda one: one["wall"]))
    print(f"\n{name}: {repeats} runs each, in turn\n{'':10} {'stage seconds':26}{'wall':>14}{'MB':>14}  left out")
    for label, runs in rows.items():
        seconds, walls = [spent(one) for one in runs], [one["wall"] for one in runs]
        left = [one for one in runs[0]["stages"] if one["left_out"]]
        free = [one for one in left if one["left_out"]["cells"] == one["left_out"]["of"]]
        cost = max(
            (
                1e3 * min(s["seconds"] for r in runs for s in r["stages"] if s["name"] == one["name"]) / one["cells"]
                for one in free
            ),
            default=0.0,
        )
        stored = sum(runs[0]["bytes"].get(one["name"], 0) for one in free)
        print(
            f"{label:10} {min(seconds):6.2f} {statistics.median(seconds):6.2f} {max(seconds):6.2f} "
            f"{min(seconds) / whole:5.0%}  {min(walls):6.2f} {min(walls) / wall:6.0%} "
            f"{sum(runs[0]['bytes'].values()) / 1e6:12.1f}  {', '.join(one['name'] for one in left) or '-'}"
            + (f"; at most {cost:.2f} ms a cell, {stored} bytes in {len(free)} groups" if free else ""),
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pipelines", nargs="*", default=["paper_physical", "sweep"])
    parser.add_argument("--tolerances", nargs="*", default=list(TOLERANCES))
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args()
    for name in given.pipelines:
        table(name, given.tolerances, given.repeats)
    lights = {light: [] for light in ("550 nm", "D65")}
    for _ in range(given.repeats):
        for light, found in lights.items():
            found.append(spent(run("paper_physical", "--set", f"illuminant={light}"), LIGHT))
    line, day = (min(found) for found in lights.values())
    print(f"\nscene to pixel, 550 nm {line:.3f} s, D65 {day:.3f} s: {line / day:.0%}")
    found = min((run("sweep", "--want", "mtf50_lp_mm") for _ in range(given.repeats)), key=spent)
    pixels = sum(one["computed"] for one in found["stages"] if one["name"] == "pixel")
    print(f"sweep --want mtf50_lp_mm: {spent(found):.2f} s of stages, {pixels} cells of pixel")


if __name__ == "__main__":
    main()
