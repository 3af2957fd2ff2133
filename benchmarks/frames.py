"""Frames of real size: CPU seconds, Mpixel/s and memory by row, against another checkout and against peers.

    python benchmarks/frames.py [--rows photograph_3 raw_48 ...] [--root CHECKOUT] [--repeats 2] [--peer] [--scale 1]

``photograph_3`` and ``photograph_31``: 12 Mpixel from a photograph in so many bands, through optics, noise and colour,
in memory; ``burst_8``: eight frames of 12 Mpixel of one light, read out; ``archive``: ``photograph_3`` stored with its
mosaic; ``report``: ``etendue report`` of that archive; ``raw_48``: 48 Mpixel from raw numbers to colour. ``--scale``:
so many times fewer rows and columns.

Every figure is of a process of its own, on one thread; CPU counts from the document to the result, imports and a small
frame of the same camera before it; the fewest seconds of the repeats count. Memory is the largest resident set above
that behind the small frame. ``--root``: the same rows with the sources (and ``.venv``, if there is one) of another
checkout, in turn. ``--peer``: demosaicing (EA), matrix and sRGB of ``raw_48`` by OpenCV in float32, if installed.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve()
SENSOR = ("mosaic", "exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")
COLOUR = (
    "white",
    "balance_mosaic",
    "demosaic_colour_difference",
    "sharpen",
    "colour_fit",
    "camera_to_xyz",
    "balance",
    "display",
    "encode",
)
PITCH = 2.8  # um
TOUCHED = 2 << 30  # bytes
ROWS = ("photograph_3", "photograph_31", "burst_8", "archive", "report", "raw_48")


def size(row: str, scale: int) -> tuple[int, int]:
    """Return rows and columns of the frame."""
    rows, columns = (6000, 8000) if row == "raw_48" else (3000, 4000)
    return rows // scale, columns // scale


def picture(file: Path, rows: int, columns: int) -> None:
    """Write a photograph with detail of every size, darkness, and lights that are clipped."""
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None
    random = np.random.default_rng(11)
    found = np.zeros((rows, columns), np.float32)
    for octave in range(2, 12):
        coarse = random.standard_normal((3 << octave, 4 << octave), np.float32)[: rows + 1, : columns + 1]
        grown = Image.fromarray(coarse).resize((columns, rows), Image.Resampling.BILINEAR)
        found += np.asarray(grown) / np.float32(1.6 ** (octave - 2))
    tints = (
        np.linspace(-0.3, 0.3, columns, dtype=np.float32)[None, :],
        0.0,
        np.linspace(0.3, -0.3, rows, dtype=np.float32)[:, None],
    )
    planes = [np.clip(110 + 50 * (found + tint), 0, 255).astype(np.uint8) for tint in tints]
    Image.fromarray(np.stack(planes, 2)).save(file, quality=95)


def document(row: str, file: str, rows: int, columns: int) -> dict[str, Any]:
    """Return the pipeline of a row from light."""
    scene = {
        "use": "photograph",
        "name": "scene",
        "file": file,
        "white_luminance": 500,
        "width": PITCH * columns,
        "height": PITCH * rows,
        "spacing": PITCH,
        "wavelength_from": 390,
        "wavelength_to": 700,
        "bin_width": 10 if row == "photograph_31" else 310 / 3,
    }
    optics = ("irradiance", "falloff", "diffraction", "diffusion", "pixel")
    sensor: tuple[Any, ...] = SENSOR
    wanted = "rgb_display"
    if row == "burst_8":
        sensor = ("mosaic", {"use": "bracket", "repeats": 8}, *SENSOR[1:])
        wanted = "mosaic_linear"
    chain = (*optics, *sensor, *(() if row == "burst_8" else COLOUR))
    return {
        "name": "frame",
        "tolerance": 1e-4,
        "keep": [wanted, "raw"] if row in ("archive", "report") else [wanted],
        "wanted": [wanted],
        "camera": {
            "peak_qe": [0.4, 0.5, 0.3],
            "pixel_pitch": PITCH,
            "f_number": 4.0,
            "focal_length": 12,
            "integration_time": 0.01,
            "full_well_density": 2000.0,
        },
        "stages": [scene, *({"use": one} if isinstance(one, str) else one for one in chain)],
    }


def status(name: str) -> int:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(name + ":"))
    return 1024 * int(line.split()[1])


def spent() -> tuple[float, float]:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime, used.ru_stime


def measured(row: str, file: str, scale: int, out: str, stages: bool) -> dict[str, Any]:
    """Run a row from light in this process."""
    from etendue import session
    from etendue.plan import planner

    try:
        from etendue.contract.registry import installed_stages
    except ImportError:  # as it was called
        from etendue.registry import installed_stages

    def run(rows: int, columns: int, archive: Path | None) -> Any:
        plan = planner.make_plan(session.from_document(document(row, file, rows, columns)), installed_stages())
        return plan, session.execute(plan, archive, session.Options("serial", pictures=False))

    np.ones(TOUCHED, np.uint8)  # memory the machine has never touched costs more than filling it: the same for all
    archived = row in ("archive", "report")
    with tempfile.TemporaryDirectory() as folder:
        run(96, 128, Path(folder) / "small" if archived else None)
        base = status("VmRSS")
        Path("/proc/self/clear_refs").write_text("5")
        began = spent()
        plan, outcome = run(*size(row, scale), Path(out) if archived else None)
        user, system = (now - then for now, then in zip(spent(), began, strict=True))
        peak = status("VmHWM") - base
    taken: dict[str, float] = {}
    for report in outcome.reports.values():
        taken[report.stage] = taken.get(report.stage, 0.0) + report.seconds
    found = {
        "cpu": user + system,
        "system": system,
        "memory": peak,
        "precision": str(plan.precision),
        "failed": [r.message for r in outcome.failed],
    }
    return found | ({"stages": taken} if stages else {})


def by_opencv(scale: int) -> dict[str, Any]:
    """Demosaic a mosaic, apply a matrix and encode it, in this process."""
    import cv2

    cv2.setNumThreads(1)
    rows, columns = size("raw_48", scale)
    raw = np.random.default_rng(1).integers(200, 4095, (rows, columns), np.uint16)
    matrix = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.0, -0.5, 1.5]], np.float32)
    base, began = status("VmRSS"), spent()
    found = cv2.demosaicing(raw, cv2.COLOR_BayerBG2RGB_EA).astype(np.float32)
    found *= np.float32(1 / 4095)
    found = np.clip(cv2.transform(found, matrix), 0, 1)
    curved = cv2.pow(found, 1 / 2.4)
    curved *= np.float32(1.055)
    curved -= np.float32(0.055)
    np.multiply(found, np.float32(12.92), out=curved, where=found <= 0.0031308)
    user, system = (now - then for now, then in zip(spent(), began, strict=True))
    return {"cpu": user + system, "system": system, "memory": status("VmHWM") - base, "failed": []}


def command(words: list[str], environment: dict[str, str]) -> tuple[float, float, int, str]:
    """Run a command; return its CPU seconds, those of the system among them, its peak in bytes, and what it said."""
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(words, env=environment, stdout=said, stderr=subprocess.STDOUT)
        _, code, used = os.wait4(process.pid, 0)
        process.returncode = code
        said.seek(0)
        text = said.read()
    if code:
        raise SystemExit(text[-3000:])
    return used.ru_utime + used.ru_stime, used.ru_stime, 1024 * used.ru_maxrss, text


def figures(row: str, root: Path, asked: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Return the figures of a row with the sources of a checkout."""
    own = root / ".venv" / "bin" / "python"
    python = str(own) if own.exists() else sys.executable
    sources = [root / "src", *sorted(root.glob("plugins/*/src"))]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, sources))}
    environment |= {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    subprocess.run(["rm", "-rf", str(folder / "cache")], check=True)
    environment["ETENDUE_CACHE"] = str(folder / "cache")  # as on a machine that has never seen the photograph
    rows, columns = size(row, asked.scale)
    if row == "raw_48":
        script = str(root / "benchmarks" / "raw_to_colour.py")
        words = [python, script, "--start", "raw", "--rows", str(rows), "--columns", str(columns), "--one", "in strips"]
        return json.loads(command(words, environment)[3].splitlines()[-1])
    archive = folder / f"archive {root.name}"
    if row == "report":
        if not archive.exists():
            figures("archive", root, asked, folder)
        cpu, system, peak, _ = command(
            [python, "-m", "etendue", "report", str(archive), "-o", f"{archive}.html"], environment
        )
        return {"cpu": cpu, "system": system, "memory": peak, "failed": []}
    subprocess.run(["rm", "-rf", str(archive)], check=True)
    file = folder / f"{rows} x {columns}.jpg"
    if not file.exists():
        picture(file, rows, columns)
    words = [python, str(HERE), "--child", row, str(file), str(archive), "--scale", str(asked.scale)]
    return json.loads(command([*words, *(["--stages"] if asked.stages else [])], environment)[3].splitlines()[-1])


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=ROWS)
    parser.add_argument("--root", type=Path, action="append", default=[], help="another checkout, measured in turn")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--scale", type=int, default=1)
    parser.add_argument("--stages", action="store_true", help="with the seconds of every stage")
    parser.add_argument("--peer", action="store_true", help="raw_48 by OpenCV, too")
    parser.add_argument("--child", nargs="+", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.child == ["opencv"]:
        print(json.dumps(by_opencv(asked.scale)))
        return 0
    if asked.child:
        print(json.dumps(measured(asked.child[0], asked.child[1], asked.scale, asked.child[2], asked.stages)))
        return 0
    roots = [HERE.parents[1], *(root.resolve() for root in asked.root)]
    print(f"{'row':15s} {'checkout':10s} {'CPU s':>7s} {'system':>7s} {'Mpixel/s':>9s} {'MB':>6s} {'bytes/pixel':>11s}")
    with tempfile.TemporaryDirectory() as made:
        for row in asked.rows:
            found: dict[Path, list[dict[str, Any]]] = {root: [] for root in roots}
            for _ in range(asked.repeats):
                for root in roots:
                    found[root].append(figures(row, root, asked, Path(made)))
                if asked.peer and row == "raw_48":
                    words = [sys.executable, str(HERE), "--child", "opencv", "--scale", str(asked.scale)]
                    own = json.loads(command(words, dict(os.environ))[3].splitlines()[-1])
                    found.setdefault(Path("opencv"), []).append(own)
            rows, columns = size(row, asked.scale)
            pixels = rows * columns * (8 if row == "burst_8" else 1)
            for root, every in found.items():
                best = min(every, key=lambda one: one["cpu"])
                print(
                    f"{row:15s} {root.name:10s} {best['cpu']:7.2f} {best.get('system', float('nan')):7.2f} "
                    f"{1e-6 * pixels / best['cpu']:9.2f} {1e-6 * best['memory']:6.0f} {best['memory'] / pixels:11.1f} "
                    f"{best.get('precision', '')} {' '.join(best['failed'])[:100]}",
                    flush=True,
                )
                if best.get("stages"):
                    print("   " + " ".join(f"{name} {taken:.2f}" for name, taken in best["stages"].items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
