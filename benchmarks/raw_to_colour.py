"""A large frame behind the sensor: from light on the pixels, or from raw numbers, to a picture; memory and time.

    python benchmarks/raw_to_colour.py [--columns 4000 --rows 3000] [--start raw] [--pictures] [--archive]

In strips as the engine works large frames, and with every cell whole; each way in a process of its own, on one thread.
Memory is the largest resident set above that of the interpreter after a small frame of the same camera. One variable is
kept: the picture.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from etendue.api import Bands, Facts, Grid, Line, Source, hookimpl, param

WAYS = ("in strips", "whole")
CHAIN = (
    "exposure",
    "shot_noise",
    "full_well",
    "read_noise",
    "adc",
    "linearise",
    "demosaic_colour_difference",
    "sharpen",
)
BEHIND = ("white", "colour_fit", "camera_to_xyz", "balance", "display", "encode")
EDGES = tuple(float(edge) for edge in range(400, 701, 50))


@dataclass(frozen=True, kw_only=True)
class _Frame(Source):
    """A frame of the sensor under light that varies smoothly, with fine texture."""

    rows: int = param(64, at_least=8)
    columns: int = param(64, at_least=8)

    light: ClassVar[str] = ""
    lights: ClassVar[dict[str, str]] = {
        "white_radiance": "wavelength [W m-2 sr-1 nm-1]",
        "white_irradiance": "wavelength [W m-2 nm-1]",
    }

    def describe(self) -> Any:
        lines = {
            dim: Line(size, 0.0, 1.0, "pixel", (-0.5 * (size - 1), 1.0))
            for dim, size in (("y", self.rows), ("x", self.columns))
        }
        bands = Grid.of({"wavelength": Bands(EDGES)})
        return Facts(), {self.light: Grid.of(lines), "white_radiance": bands, "white_irradiance": bands}

    def pattern(self, out_y: Any, out_x: Any) -> Any:
        """Shares from 0 to 1."""
        y, x = (np.asarray(line, np.float32) for line in (out_y[:, None], out_x[None, :]))
        found = np.sin(0.003 * x + 0.0007 * y)
        found *= np.cos(0.3 * y).astype(np.float32)
        found += np.float32(1.5)
        found *= np.float32(0.3)
        return found

    def whites(self) -> dict[str, Any]:
        return {"white_radiance": np.full(len(EDGES) - 1, 0.1), "white_irradiance": np.full(len(EDGES) - 1, 0.01)}


@dataclass(frozen=True, kw_only=True)
class LightFrame(_Frame):
    light: ClassVar[str] = "photocurrent"
    writes: ClassVar = {"photocurrent": "y x [electron/s]", **_Frame.lights}

    def run(self, out_y: Any, out_x: Any) -> dict[str, Any]:
        light = self.pattern(out_y, out_x)
        light *= np.float32(4e5)
        return {"photocurrent": light, **self.whites()}


@dataclass(frozen=True, kw_only=True)
class RawFrame(_Frame):
    light: ClassVar[str] = "raw"
    writes: ClassVar = {"raw": "y x [DN] uint16", **_Frame.lights}

    def run(self, out_y: Any, out_x: Any) -> dict[str, Any]:
        return {"raw": (200 + 2500 * self.pattern(out_y, out_x)).astype(np.uint16), **self.whites()}


@hookimpl
def etendue_stages() -> dict[str, Any]:
    return {"light_frame": LightFrame, "raw_frame": RawFrame}


def pipeline(start: str, rows: int, columns: int) -> dict[str, Any]:
    chain = CHAIN if start == "light" else CHAIN[CHAIN.index("linearise") :]
    return {
        "name": "frame",
        "precision": "float32",
        "keep": ["rgb_display"],
        "wanted": ["rgb_display"],
        "camera": {
            "peak_qe": [0.4, 0.5, 0.3],
            "pixel_pitch": 2.0,
            "integration_time": 0.01,
            "full_well_density": 2000.0,
        },
        "stages": [
            {"use": f"{start}_frame", "name": "frame", "rows": rows, "columns": columns},
            *({"use": n} for n in (*chain, *BEHIND)),
        ],
    }


def peak() -> int:
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def measure(way: str, asked: argparse.Namespace) -> None:
    from etendue import session
    from etendue.compute import rows as strips
    from etendue.contract.registry import installed_stages
    from etendue.plan import planner
    from etendue.plugins import discovery
    from etendue.plugins.hookspecs import GROUP
    from etendue.run.peak_memory import peak_memory

    own = discovery.Discovery([*discovery.installed().points, EntryPoint("frames", "raw_to_colour", GROUP)])
    discovery.installed = lambda: own
    registry = installed_stages()
    if way == "whole":
        strips.LARGEST_WHOLE = 1 << 62

    def run(rows: int, columns: int, folder: str) -> Any:
        plan = planner.make_plan(session.from_document(pipeline(asked.start, rows, columns)), registry)
        options = session.Options("serial", pictures=asked.pictures)
        return session.execute(plan, Path(folder) / f"{rows}" if asked.archive else None, options)

    with tempfile.TemporaryDirectory() as folder:
        run(64, 64, folder)
        base, wall, cpu = peak(), time.perf_counter(), time.process_time()
        outcome = run(asked.rows, asked.columns, folder)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        found = {
            "memory": peak() - base,
            "base": base,
            "wall": wall,
            "cpu": cpu,
            "failed": [r.message for r in outcome.failed],
        }
        found["expected"] = peak_memory(outcome.plan, 1, not asked.archive).bytes
        if outcome.tree is None:
            import xarray

            outcome.tree = xarray.open_datatree(Path(folder) / f"{asked.rows}" / "data.zarr", engine="zarr")
        picture = np.ascontiguousarray(outcome.tree["encode"].rgb_display.values)
        print(json.dumps({**found, "digest": hashlib.sha256(picture).hexdigest()[:16]}))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=3000)
    parser.add_argument("--columns", type=int, default=4000)
    parser.add_argument("--start", choices=("light", "raw"), default="light")
    parser.add_argument(
        "--pictures", action="store_true", help="with pictures of every stage, as simulate() makes them"
    )
    parser.add_argument(
        "--archive", action="store_true", help="kept in Zarr instead of in memory; with the contact sheet"
    )
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    parser.add_argument("--one", choices=WAYS, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        measure(asked.one, asked)
        return 0
    pixels = asked.rows * asked.columns
    print(
        f"{asked.columns} x {asked.rows} pixels, from {asked.start} to encoded colour, float32, one thread, one "
        f"variable kept"
    )
    digests = set()
    for way in asked.ways:
        done = subprocess.run(
            [sys.executable, __file__, *sys.argv[1:], "--one", way], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise SystemExit(done.stderr)
        found = json.loads(done.stdout.strip().splitlines()[-1])
        assert not found["failed"], found["failed"]
        digests.add(found["digest"])
        memory = (
            f"{found['memory'] / 1e6:6.0f} MB above {found['base'] / 1e6:.0f}   {found['memory'] / pixels:6.1f} "
            f"bytes a pixel"
        )
        expected = f"{found['expected'] / 1e6:.0f} MB expected by the plan"
        print(f"{way:10s} peak {memory}, {expected}   CPU {found['cpu']:6.2f} s   wall {found['wall']:6.2f} s")
    print("same bits" if len(digests) == 1 else f"other bits: {digests}")
    return len(digests) != 1


if __name__ == "__main__":
    sys.exit(main())
