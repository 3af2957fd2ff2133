"""A frame of 4000 x 3000 samples and 31 bands, streamed by band: memory, error and time against reading the cube.

    python benchmarks/large_frame.py [--bands 31] [--rows 3000] [--columns 4000] [--folder DIR]

The cube is written once to a Zarr store (default compression of zarr), one band per chunk. Each way runs in a process
of its own on two threads; memory is the largest resident set above that of the interpreter with everything imported.
The reference is the float64 whole frame, every band its own transform, by plain scipy with the same kernels.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SPACING, F_NUMBER = 2.0, 5.6
WAYS = {"exact": 0, "7 terms": 7, "8 terms": 8}


def write_cube(path: Path, bands: int, rows: int, columns: int) -> None:
    """Smooth light, fine texture and coloured points 20 times as bright: harsh for every approximation."""
    import zarr

    group = zarr.open_group(str(path), mode="w", zarr_format=3)
    cube = group.create_array("radiance", shape=(bands, rows, columns), chunks=(1, rows, columns), dtype="float32")
    random = np.random.default_rng(7)
    y, x = np.linspace(0, 1, rows, dtype=np.float32)[:, None], np.linspace(0, 1, columns, dtype=np.float32)[None, :]
    texture = random.random((rows, columns), dtype=np.float32)
    points = [(random.integers(rows), random.integers(columns), random.integers(bands)) for _ in range(300)]
    for band in range(bands):
        phase = np.float32(band / bands)
        light = np.float32(0.02) * (1.5 + np.sin(9 * (x + phase)) * np.cos(7 * y) + 0.8 * texture)
        for row, column, peak in points:
            light[row, column] += np.float32(0.8 * np.exp(-(((band - peak) / 4) ** 2)))
        cube[band] = light
    cube.attrs["actual_range"] = [0.01, 0.9]
    edges = np.linspace(395, 705, bands + 1)
    for name, values in (
        ("wavelength_bounds", np.stack([edges[:-1], edges[1:]], 1)),
        ("white_radiance", np.full(bands, 0.1)),
    ):
        group.create_array(name, data=values)
    for name, size in (("y", rows), ("x", columns)):
        group.create_array(name, data=(np.arange(size) - 0.5 * (size - 1)) * SPACING)


def pipeline(store: str, terms: int) -> dict[str, Any]:
    return {
        "name": "large",
        "precision": "float32",
        "keep": ["pixel"],
        "wanted": ["photon_rate"],
        "camera": {"peak_qe": [0.4, 0.5, 0.3], "pixel_pitch": SPACING, "f_number": F_NUMBER, "focal_length": 20},
        "stages": [
            {"use": "radiance_cube", "name": "scene", "file": store},
            {"use": "irradiance"},
            {"use": "diffraction"},
            {"use": "diffusion"},
            {"use": "pixel", "wavelength_terms": terms},
        ],
    }


def resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def read(store: str) -> None:
    """Reading alone: every band decoded once."""
    import zarr

    array = zarr.open_group(store, mode="r")["radiance"]
    total = 0.0
    began = time.perf_counter()
    for band in range(array.shape[0]):
        total += float(array[band][0, 0])
    print(json.dumps({"seconds": time.perf_counter() - began, "total": total}))


def run(store: str, terms: int, out: str) -> None:
    """The product: plan, run, archive."""
    import etendue
    from etendue import session
    from etendue.contract.registry import installed_stages
    from etendue.plan import planner

    stages = [{"use": "uniform", "name": "scene", "white_luminance": 1, "width": 60, "height": 40}]
    stages += [{"use": name} for name in ("irradiance", "diffraction", "pixel")]
    etendue.simulate(
        {"name": "warm", "camera": {"peak_qe": [1, 1, 1]}, "stages": stages}
    )  # imports, before memory is counted
    base = resident()
    began = time.perf_counter()
    plan = planner.make_plan(session.from_document(pipeline(store, terms)), installed_stages())
    planned = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        outcome = session.execute(plan, Path(folder) / "archive", session.Options("threads", 2))
        ended = time.perf_counter()
        assert not outcome.failed, outcome.failed
        peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        import xarray

        tree = xarray.open_datatree(Path(folder) / "archive" / "data.zarr", engine="zarr")
        np.save(out, tree["pixel"].photon_rate.values)
        error = float(tree["ledger"].error.values[[str(s) for s in tree["ledger"].stage.values].index("pixel")])
    print(json.dumps({"plan": planned - began, "seconds": ended - planned, "memory": peak - base, "stated": error}))


def reference(store: str, out: str) -> None:
    """Float64, whole frame, every band: the same physics without the engine."""
    import zarr

    from etendue.contract.registry import installed_stages
    from etendue.plan import planner
    from etendue.session import from_document
    from etendue.transfer import sampling
    from etendue_camera.light import radiometry
    from etendue_camera.optics import diffraction
    from etendue_camera.sensor import photodiode, silicon

    group = zarr.open_group(store, mode="r")
    cube, bounds = group["radiance"], np.asarray(group["wavelength_bounds"][...])
    plan = planner.make_plan(from_document(pipeline(store, 0)), installed_stages())
    pixel = plan.of("pixel")[0].stage
    weights = pixel.weights(
        pixel.prepare({"wavelength_edges": np.append(bounds[:, 0], bounds[-1, 1]), "wavelength": bounds.mean(1)})
    )
    rows, columns = cube.shape[1:]
    fy = sampling.frequencies(rows, SPACING, half=False)
    fx = sampling.frequencies(columns, SPACING, half=True)
    radial = np.hypot(fy[: fy.size // 2 + 1, None], fx[None, :])
    number = float(radiometry.working_f_number(F_NUMBER, 0.0))
    sums: Any = 0
    for band, wavelength in enumerate(bounds.mean(1) * 1e-3):
        half = sampling.transform(np.asarray(cube[band], dtype=float))
        otf = diffraction.circular_otf(radial, wavelength, number)
        alpha = float(silicon.absorption(np.array(wavelength)))
        otf = otf * photodiode.collection_mtf(
            radial, alpha, pixel.depletion_depth, pixel.diffusion_depth, pixel.diffusion_length
        )
        half *= np.concatenate([otf, otf[1 : fy.size - fy.size // 2][::-1]])
        sums = sums + weights[:, band, None, None] * half
    width = pixel.pixel_pitch * pixel.aperture_fraction
    sums *= photodiode.aperture_otf(fy[:, None], width) * photodiode.aperture_otf(fx[None, :], width)
    factor = float(radiometry.aplanatic_factor(F_NUMBER, 0.0))
    np.save(out, np.stack([sampling.planes_of(channel, rows, columns) for channel in sums]) * factor)
    print("{}")


def child(*arguments: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, __file__, "--child", *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.strip().splitlines()[-1])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, default in (("bands", 31), ("rows", 3000), ("columns", 4000)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--child", nargs="+")
    asked = parser.parse_args()
    if asked.child:
        what, *rest = asked.child
        {"read": read, "reference": reference, "run": lambda s, t, o: run(s, int(t), o)}[what](*rest)
        return 0
    with tempfile.TemporaryDirectory(dir=asked.folder) as folder:
        store = str(Path(folder) / "cube.zarr")
        write_cube(Path(store), asked.bands, asked.rows, asked.columns)
        child("read", store)
        reading = min(child("read", store)["seconds"] for _ in range(3))
        print(f"reading the cube, warm: {reading:.2f} s ({asked.bands} x {asked.rows} x {asked.columns})")
        child("reference", store, f"{folder}/reference.npy")
        truth = np.load(f"{folder}/reference.npy", mmap_mode="r")
        scale = float(truth.max())
        heads = (
            ("plan s", 7),
            ("run s", 7),
            ("of reading", 10),
            ("bound", 6),
            ("MiB", 6),
            ("of 1024", 8),
            ("error", 9),
            ("stated", 9),
        )
        print(f"{'way':10s} " + " ".join(f"{text:>{width}s}" for text, width in heads))
        worst = 0
        for name, terms in WAYS.items():
            found = min(
                (child("run", store, str(terms), f"{folder}/own.npy") for _ in range(2)), key=lambda r: r["seconds"]
            )
            own = np.load(f"{folder}/own.npy", mmap_mode="r")
            error = max(float(np.abs(a - b).max()) for a, b in zip(own, truth, strict=True)) / scale
            bound = 5.0 if terms == 0 else 2.5
            ratio, mib = found["seconds"] / reading, found["memory"] / 2**20
            print(
                f"{name:10s} {found['plan']:7.2f} {found['seconds']:7.2f} {ratio:10.2f} {bound:6.1f} {mib:6.0f} "
                f"{mib / 1024:8.2f} "
                f"{error:9.1e} {found['stated']:9.1e}"
            )
            worst += ratio > bound or mib > 1024 or error > 1e-4
        print("beyond its bound: " + (str(worst) if worst else "nothing"))
    return 1 if worst else 0


if __name__ == "__main__":
    sys.exit(main())
