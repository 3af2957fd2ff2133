"""Memory that a run takes beside what its plan says, for frames of 1 to 24 Mpixel.

    python benchmarks/memory.py [--mpixel 1 3] [--bands 3 31] [--precision float32 float64] [--workers 1 2] [--camera
    smallest ...]

    python benchmarks/memory.py stages [NAME ...] [--precision float32 float64]

Every row is a process of its own: largest resident set above that behind a small frame of the same camera. ``planned``
is what the plan says that is held, ``ratio`` planned over measured. Mpixel are samples of the light, or pixels where a
camera begins behind the sensor.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

PIPELINES = Path(__file__).parents[1] / "pipelines"
CAMERAS = ("smallest", "paper_physical", "sensors", "raw_to_colour")
WARM = 0.03  # Mpixel


def overrides(camera: str, mpixel: float, bands: int, precision: str) -> dict[str, Any]:
    """What makes a shipped camera one of a frame: 4 : 3, multiples of 16."""
    rows = int(math.sqrt(mpixel * 0.75e6)) // 16 * 16
    columns = rows * 4 // 3 // 16 * 16
    found: dict[str, Any] = {"precision": precision}
    if camera == "smallest":
        own = {
            "spacing": "2.8 um",
            "width": f"{2.8 * columns:.1f} um",
            "height": f"{2.8 * rows:.1f} um",
            "bin_width": f"{300 / bands} nm",
        }
        found |= {
            "sweep": {},
            "camera.f_number": 2.8,
            "camera.pixel_pitch": "2.8 um",
            "camera.integration_time": "8 ms",
        }
        found |= {f"scene.{name}": value for name, value in own.items()} | {
            "pixel.rows": rows - 32,
            "pixel.columns": columns - 32,
        }
    elif camera == "paper_physical":  # a photograph has bands of its own
        found |= {"scene.width": f"{2.7 * columns:.1f} um", "scene.height": f"{2.7 * rows:.1f} um"}
        found |= {"pixel.rows": rows // 2, "pixel.columns": columns // 2}
    elif camera == "sensors":
        found |= {"scene.width": f"{columns} um", "scene.height": f"{rows} um", "scene.bin_width": f"{300 / bands} nm"}
        found |= {
            "pixel.sensor_width": f"{(columns - 48) / 1000} mm",
            "pixel.sensor_height": f"{(rows - 48) / 1000} mm",
        }
    return found


def planned(camera: str, mpixel: float, bands: int, precision: str) -> Any:
    """The plan of a frame."""
    from etendue.contract.registry import installed_stages
    from etendue.pipeline.file import from_document, read_pipeline
    from etendue.plan.planner import make_plan

    if camera != "raw_to_colour":
        return make_plan(
            read_pipeline(PIPELINES / f"{camera}.toml", overrides(camera, mpixel, bands, precision)), installed_stages()
        )
    from importlib.metadata import EntryPoint

    import raw_to_colour

    from etendue.plugins import discovery
    from etendue.plugins.hookspecs import GROUP

    own = discovery.Discovery([*discovery.installed().points, EntryPoint("frames", "raw_to_colour", GROUP)])
    discovery.installed = lambda: own
    rows = int(math.sqrt(mpixel * 0.75e6)) // 16 * 16
    document = raw_to_colour.pipeline("light", rows, rows * 4 // 3 // 16 * 16) | {"precision": precision}
    return make_plan(from_document(document), installed_stages())


def status(name: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name + ":"))
    return 1024 * int(line.split()[1])


def measure(
    camera: str, mpixel: float, bands: int, precision: str, workers: int, archive: bool, most: float
) -> dict[str, Any]:
    """Run one frame in this process, unless more than ``most`` bytes are planned."""
    from etendue import session
    from etendue.plan import machine
    from etendue.run.memory import return_freed_memory
    from etendue.run.peak_memory import peak_memory

    machine.available_memory = lambda: 0  # what is asked is what comes, not whether it fits
    with tempfile.TemporaryDirectory() as folder:

        def run(size: float) -> Any:
            options = session.Options("threads", workers)
            return session.execute(
                planned(camera, size, bands, precision), Path(folder) / str(size) if archive else None, options
            )

        expected = peak_memory(planned(camera, mpixel, bands, precision), workers, not archive)
        said = {"planned": expected.bytes, "where": expected.ref[0] if expected.ref else ""}
        if expected.bytes > most:
            return said | {"measured": 0, "failed": []}
        run(WARM)
        gc.collect()
        return_freed_memory()  # which the frame would take again without a trace in the peak
        base = status("VmRSS")
        Path("/proc/self/clear_refs").write_text("5")
        outcome = run(mpixel)
        found = status("VmHWM") - base
    return said | {"measured": found, "failed": [r.message for r in outcome.failed]}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("stages", nargs="*", metavar="stages NAME", help="stage by stage, in place of whole frames")
    parser.add_argument("--mpixel", type=float, nargs="+", default=[1, 3])
    parser.add_argument("--bands", type=int, nargs="+", default=[3, 31])
    parser.add_argument("--precision", nargs="+", default=["float32", "float64"])
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--camera", nargs="+", default=list(CAMERAS), choices=CAMERAS)
    parser.add_argument("--in-memory", action="store_true", help="without an archive")
    parser.add_argument("--most", type=float, default=8.0, help="GB: rows that plan more are not run")
    parser.add_argument(
        "--repeats", type=int, default=1, help="of which the largest counts: a host may take pages back"
    )
    parser.add_argument("--row", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.row:
        print(json.dumps(measure(**json.loads(asked.row))))
        return 0
    if asked.stages:
        from memory_stages import main as of_stages

        return of_stages(asked.stages[1:], asked.precision)
    worst = 1.0
    print(f"{'camera':15s} {'Mpixel':>6s} {'bands':>5s} precision workers   measured    planned  ratio  largest cell")
    for camera in asked.camera:
        own_bands = asked.bands if camera in ("smallest", "sensors") else asked.bands[:1]
        for mpixel, bands, precision, workers in (
            (m, b, p, w) for m in asked.mpixel for b in own_bands for p in asked.precision for w in asked.workers
        ):
            row = {"camera": camera, "mpixel": mpixel, "bands": bands, "precision": precision, "workers": workers}
            row |= {"archive": not asked.in_memory, "most": 1e9 * asked.most}
            every = []
            for _ in range(asked.repeats):
                words = [sys.executable, __file__, "--row", json.dumps(row)]
                done = subprocess.run(words, capture_output=True, text=True)
                if done.returncode:
                    print(done.stderr[-2000:])
                    return 1
                every.append(json.loads(done.stdout.splitlines()[-1]))
            found = max(every, key=lambda one: one["measured"])
            ratio = found["planned"] / found["measured"] if found["measured"] else math.nan
            worst = max(worst, *([ratio, 1 / ratio] if found["measured"] else []))
            shown = f"{bands:5d}" if camera in ("smallest", "sensors") else "    -"
            measured = f"{found['measured'] / 1e6:7.0f} MB" if found["measured"] else "   not run"
            sizes = f"{measured} {found['planned'] / 1e6:7.0f} MB"
            failed = f" FAILED {found['failed'][0]}" if found["failed"] else ""
            print(
                f"{camera:15s} {mpixel:6g} {shown} {precision:9s} {workers:7d} {sizes} {ratio:6.2f}  "
                f"{found['where']}{failed}",
                flush=True,
            )
    print(f"worst: {worst:.2f} times, either way")
    return 0


if __name__ == "__main__":
    sys.exit(main())
