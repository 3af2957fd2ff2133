"""Do the bounds of a plan's decisions hold? Each decision is undone alone, in double precision; both runs are compared.

    python benchmarks/bounds.py [--count 300] [--seed 1] [--workers 1] [--show]

Pipelines are drawn: light made here (hot pixels, stars, thin lines, lamps at night, noise, blobs, bars, ramps) in own
spectra, a lens of several parts, a sensor, an exposure that is given or metered, white and display. A decision is a
stage that is left out or a knob that the plan has set. Its true error is the largest, in the pipeline's norm and
relative to full scale, at its own stage and at every wanted variable that it reaches; it holds if that is at most the
bound stated there (and rounding of double precision). Decisions about noise and draws, which means do not show, are
counted apart. Lines appear as pipelines are done; then a table by kind of scene, the worst ten, and the seconds of
the stages with and without the decisions. Exit code 1 below 99 %.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from etendue.accuracy.differences import difference
from etendue.contract.registry import installed_stages
from etendue.contract.stage import writes_of
from etendue.errors import EtendueError
from etendue.plan.model import Cell, CellRef, Plan
from etendue.plan.planner import make_plan
from etendue.session import Options, collect, load

ROUNDING = 1e-11  # of two runs in double precision; some pass a root or a quotient
WANTED = ("photon_rate", "mosaic_linear", "rgb_linear")
# their bounds are shares of variances and distances of distributions
UNSEEN = {("exposure", "dark_pattern"), ("shot_noise", "exact_below")}
Rng = np.random.Generator


# -- light, (y, x), largest value 1 -------------------------------------------------------------------------------


def spots(rng: Rng, size: tuple[int, int], count: int, width: float, spread: float) -> np.ndarray:
    """Gaussian spots of one width in samples, of brightnesses over some decades; of no width: single samples."""
    plane, (ny, nx) = np.zeros(size), size
    y, x = np.mgrid[:ny, :nx]
    for _ in range(count):
        cy, cx, level = rng.uniform(4, ny - 5), rng.uniform(4, nx - 5), 10 ** -rng.uniform(0, spread)
        if width == 0:
            plane[round(cy), round(cx)] += level
        else:
            plane += level * np.exp(-0.5 * ((y - cy) ** 2 + (x - cx) ** 2) / width**2)
    return plane


def lines(rng: Rng, size: tuple[int, int], count: int, width: float) -> np.ndarray:
    """Thin lines across the frame."""
    y, x = np.mgrid[: size[0], : size[1]]
    plane = np.zeros(size)
    for _ in range(count):
        angle = rng.uniform(0, np.pi)
        away = (y - rng.uniform(0, size[0])) * np.cos(angle) + (x - rng.uniform(0, size[1])) * np.sin(angle)
        plane = np.maximum(plane, rng.uniform(0.2, 1) * np.exp(-0.5 * (away / width) ** 2))
    return plane


def fractal(rng: Rng, size: tuple[int, int], slope: float) -> np.ndarray:
    """Noise whose amplitude falls with frequency."""
    fy, fx = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])
    radial = np.maximum(np.hypot(fy, fx), 1 / max(size))
    plane = np.fft.irfft2(np.fft.rfft2(rng.standard_normal(size)) * radial**-slope, s=size)
    return (plane - plane.min()) / (plane.max() - plane.min())


def bars(rng: Rng, size: tuple[int, int]) -> np.ndarray:
    """Bars of a period that shortens across the frame."""
    x = np.arange(size[1]) / size[1]
    first, last = 1 / rng.uniform(20, 60), 1 / rng.uniform(2.5, 8)
    wave = np.cos(2 * np.pi * size[1] * (first * x + 0.5 * (last - first) * x * x))
    return np.repeat(0.5 + 0.5 * rng.uniform(0.1, 1) * wave[None], size[0], axis=0)


def ramp(rng: Rng, size: tuple[int, int]) -> np.ndarray:
    y, x = np.linspace(0, 1, size[0])[:, None], np.linspace(0, 1, size[1])
    return rng.uniform(0, 0.3) + rng.uniform(0, 0.3) * y + rng.uniform(0.05, 0.5) * x


SPARSE: dict[str, Callable[[Rng, tuple[int, int]], np.ndarray]] = {
    "hot pixel": lambda rng, size: spots(rng, size, 1, 0, 0) + 10 ** -rng.uniform(1, 6),
    "points": lambda rng, size: spots(rng, size, int(rng.integers(2, 12)), rng.uniform(0.6, 2), 0),
    "stars": lambda rng, size: (
        spots(rng, size, int(rng.integers(20, 80)), rng.uniform(0.7, 1.6), 4) + 10 ** -rng.uniform(2, 6)
    ),
    "thin lines": lambda rng, size: lines(rng, size, int(rng.integers(1, 5)), rng.uniform(0.6, 1.5)),
    "lamps": lambda rng, size: (
        10 ** -rng.uniform(2, 4) * fractal(rng, size, 1.5)
        + spots(rng, size, int(rng.integers(1, 4)), rng.uniform(1.5, 5), 0.5)
    ),
}
FULL: dict[str, Callable[[Rng, tuple[int, int]], np.ndarray]] = {
    "noise": lambda rng, size: fractal(rng, size, rng.uniform(0, 2)),
    "blobs": lambda rng, size: 0.05 + spots(rng, size, 30, rng.uniform(3, 9), 1),
    "bars": bars,
    "ramp": ramp,
    "edge": lambda rng, size: (
        0.02
        + 1
        / (1 + np.exp(-np.add.outer(0.1 * np.arange(size[0]), np.arange(size[1]) - size[1] / 2) / rng.uniform(0.5, 2)))
    ),
}


def store(path: Path, rng: Rng, plane: np.ndarray, spacing: float, bands: int) -> None:
    """Write a cube relative to white: two spectra, one for the light and one for a wash of it."""
    import zarr

    edges = np.linspace(400, 700, bands + 1)
    centres = 0.5 * (edges[1:] + edges[:-1])
    own = 1e-9 + np.exp(-0.5 * ((centres - rng.uniform(420, 680)) / 10 ** rng.uniform(1.2, 3)) ** 2)
    peak = 10 ** rng.choice([0, 0, rng.uniform(-1, 2)])  # some lamps are brighter than white
    cube = (peak * np.maximum(plane, 1e-9 * plane.max()) / plane.max())[None] * (own / own.max())[:, None, None]
    group = zarr.open_group(str(path), mode="w")
    for name, values, dims in (
        ("radiance", cube, ("wavelength", "y", "x")),
        ("wavelength", centres, ("wavelength",)),
        ("y", (np.arange(plane.shape[0]) - 0.5 * (plane.shape[0] - 1)) * spacing, ("y",)),
        ("x", (np.arange(plane.shape[1]) - 0.5 * (plane.shape[1] - 1)) * spacing, ("x",)),
    ):
        group.create_array(name, data=np.asarray(values, np.float64), dimension_names=dims)
        group[name].attrs.update({} if name == "radiance" else {"units": "nm" if name == "wavelength" else "um"})


# -- pipelines ------------------------------------------------------------------------------------------------------


def drawn(seed: int, number: int, folder: Path) -> tuple[str, dict[str, Any]]:
    """Return the kind of scene and a pipeline."""
    rng = np.random.default_rng([8026, seed, number])

    def log(low: float, high: float) -> float:
        return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")

    def some(share: float, *stages: dict[str, Any]) -> list[dict[str, Any]]:
        return list(stages) if rng.random() < share else []

    kinds = SPARSE if number % 5 < 2 else FULL
    kind = sorted(kinds)[int(rng.integers(len(kinds)))]
    size = (int(rng.integers(48, 110)), int(rng.integers(56, 130)))
    spacing, pitch = log(0.25, 1.5), log(0.6, 6)
    pitch = min(max(pitch, 0.6 * spacing), 0.08 * min(size) * spacing)  # at least a dozen pixels along each side
    store(folder / "cube.zarr", rng, kinds[kind](rng, size), spacing, int(rng.choice([5, 6, 10, 12])))
    stages: list[dict[str, Any]] = [
        {"use": "radiance_cube", "name": "scene", "file": str(folder / "cube.zarr"), "white_luminance": log(1, 3e4)},
        {"use": "irradiance"},
    ]
    stages[0]["white_luminance"] = f"{stages[0]['white_luminance']} cd m-2"
    stages += some(0.3, {"use": "optical_filter", "cut_off": f"{log(640, 2000)} nm"})
    stages += some(0.3, {"use": "distortion", "k1": log(1e-6, 0.1), "reference_radius": f"{log(0.05, 3)} mm"})
    stages += some(0.7, {"use": "falloff"})
    stages += some(0.2, {"use": "vignetting", "rim_radius": f"{log(25, 60)} mm", "rim_distance": f"{log(0.1, 10)} mm"})
    lens = [
        some(0.7, {"use": "diffraction"}),
        some(0.6, {"use": "lens_gaussian", "sigma": f"{log(0.005, 4)} um"}),
        some(0.25, {"use": "birefringent", "separation_x": f"{log(0.01, 5)} um", "separation_y": f"{log(0.01, 5)} um"}),
        some(0.3, {"use": "glare", "fraction": log(1e-6, 0.1), "veil": log(1e-7, 0.05), "radius": f"{log(2, 50)} um"}),
    ]
    for place in rng.permutation(4):
        stages += lens[place]
    stages += some(0.8, {"use": "diffusion"})
    rows, columns = (max(2, int(0.95 * n * spacing / pitch)) for n in size)
    stages += [{"use": "pixel", "rows": rows, "columns": columns}, {"use": "mosaic"}]
    meter = {
        "use": "meter",
        "metering": str(rng.choice(["mean", "centre", "highlight"])),
        "ev_bias": rng.uniform(-3, 6),
    }
    metered = some(0.5, meter)
    stages += metered
    stages += [{"use": name} for name in ("exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")]
    stages += [{"use": name} for name in ("white", "balance_mosaic")]
    stages += [{"use": "demosaic_bilinear", "name": "demosaic"}]
    stages += some(0.3, {"use": "sharpen", "strength": log(1e-5, 0.3)})
    stages += [{"use": name} for name in ("colour_fit", "camera_to_xyz", "balance", "display")]
    camera: dict[str, Any] = {
        "f_number": log(1.4, 22),
        "focal_length": f"{log(2, 60)} mm",
        "pixel_pitch": f"{pitch} um",
        "aperture_fraction": round(rng.uniform(0.4, 1), 3),
        "diffusion_depth": f"{log(0.3, 12)} um",
        "peak_qe": [0.36, 0.44, 0.40],
        "read_noise": log(0.1, 10),
        "full_well_density": log(300, 3000),
    }
    if not metered:
        camera["integration_time"] = f"{log(1e-4, 10)} s"
    return kind, {
        "name": f"bounds_{number}",
        "seed": number,
        "tolerance": float(rng.choice([0.05, 1e-2, 3e-3, 1e-3, 1e-4])),
        "norm": str(rng.choice(["rms", "rms", "max"])),
        "precision": "float64",
        "camera": camera,
        "stages": stages,
        "wanted": list(WANTED),
    }


# -- decisions ------------------------------------------------------------------------------------------------------


class Found(NamedTuple):
    """One decision of one pipeline."""

    number: int
    kind: str
    decision: str
    norm: str
    tolerance: float
    bound: float
    true: float
    at: str
    seen: bool  # whether means show it

    @property
    def holds(self) -> bool:
        return self.true <= self.bound + ROUNDING


def decisions_of(cell: Cell) -> list[tuple[str, float, dict[str, Any]]]:
    """Return (name, bound at its stage, fields of the cell that undo it) of every decision about a cell."""
    found: list[tuple[str, float, dict[str, Any]]] = []
    if cell.left_out:
        found.append(("left out", cell.left_out.bound, {"left_out": None}))
    for one in cell.approximated:
        found.append((one.knob, one.bound, {"stage": replace(cell.stage, **{one.knob: one.reference})}))
    return found


def arrays_of(plan: Plan, wanted: dict[CellRef, set[str]]) -> tuple[dict[tuple[CellRef, str], Any], float]:
    """Return the arrays of a run and the seconds of its stages."""
    got = collect(plan, wanted, Options("serial", pictures=False))
    failed = [report for report in got.reports.values() if report.status == "failed"]
    if failed:
        raise RuntimeError(f"{failed[0].stage}: {failed[0].error}")
    spent = sum(report.seconds for report in got.reports.values())
    return {(ref, name): own[name] for ref, own in got.arrays.items() for name in own}, spent


def undone(plan: Plan, ref: CellRef, fields: dict[str, Any]) -> Plan:
    """Return the plan with one decision undone. All keys are new: what was computed before is found by its key."""
    mark = f"undone {ref} {sorted(fields.items(), key=str)}"
    cells = {other: cell.changed(key=f"{cell.key} {mark}") for other, cell in plan.cells.items()}
    return replace(plan, cells=cells | {ref: cells[ref].changed(**fields)})


def measured(plan: Plan, number: int, kind: str) -> tuple[list[Found], float]:
    """Return every decision of a plan, and the seconds of the run with all of them."""
    norm, found = plan.pipeline.norm, []
    ends = [(cell.ref, name) for name in WANTED for cell in plan.of(plan_writer(plan, name))]
    whole: dict[CellRef, set[str]] = {}
    for ref, name in ends:
        whole.setdefault(ref, set()).add(name)
    own_of = {ref: next(d.variable for d in writes_of(type(c.stage)).values()) for ref, c in plan.cells.items()}
    for ref, cell in plan.cells.items():
        if decisions_of(cell):
            whole.setdefault(ref, set()).add(own_of[ref])
    base, spent = arrays_of(plan, whole)
    order = [node.name for node in plan.nodes]
    for ref, cell in plan.cells.items():
        for name, bound, fields in decisions_of(cell):
            places = [(ref, own_of[ref])] + [e for e in ends if order.index(e[0][0]) > order.index(ref[0])]
            asked: dict[CellRef, set[str]] = {}
            for place, variable in places:
                asked.setdefault(place, set()).add(variable)
            other = undone(plan, ref, fields)
            exact, _ = arrays_of(other, asked)
            worst = (-1.0, bound, 0.0, "")  # true / stated, stated, true, where
            for place, variable in dict.fromkeys(places):
                declared = next(d for d in plan.node(place[0]).writes.values() if d.variable == variable)
                apart = difference(base[place, variable], exact[place, variable], declared, plan.cells[place].stage)
                value = apart.largest if norm == "max" else apart.rms
                value = value / apart.scale if apart.scale else 0.0
                stated = bound if place == ref else cell.at_wanted(bound)
                row = (max(value - ROUNDING, 0.0) / max(stated, 1e-300), stated, value, f"{place[0]}.{variable}")
                worst = max(worst, row)
            _, stated, true, at = worst
            seen = (ref[0], name) not in UNSEEN and not (name == "left out" and ref[0] == "read_noise")
            found.append(Found(number, kind, f"{ref[0]} {name}", norm, plan.pipeline.tolerance, stated, true, at, seen))
    return found, spent


def plan_writer(plan: Plan, variable: str) -> str:
    return [node.name for node in plan.nodes if variable in node.writes][-1]


def one(job: tuple[int, int]) -> tuple[int, str, str, list[Found], float, float, float]:
    """Number, kind, what was refused, decisions, seconds of planning, of stages with and without decisions."""
    seed, number = job
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ETENDUE_CACHE"] = folder
        kind, document = drawn(seed, number, Path(folder))
        try:
            pipeline, registry = load(document), installed_stages()
            began = time.perf_counter()
            plan = make_plan(pipeline, registry, expected=True)
            planned = time.perf_counter() - began
            found, spent = measured(plan, number, kind)
            bare = make_plan(pipeline, registry, False, expected=True)
            last = {cell.ref: {WANTED[-1]} for cell in bare.of(plan_writer(bare, WANTED[-1]))}
            return number, kind, "", found, planned, spent, arrays_of(bare, last)[1]
        except (EtendueError, ValueError, RuntimeError) as error:
            return number, kind, str(error).splitlines()[0], [], 0.0, 0.0, 0.0


# -- tables ---------------------------------------------------------------------------------------------------------


def table(found: list[Found], group: Callable[[Found], str]) -> None:
    print(f"{'':24s} decisions  above 1e-9   hold      %   worst true/bound   median bound/true   bound > tolerance")
    for name in (*sorted({group(f) for f in found}), "all"):
        own = [f for f in found if name in (group(f), "all")]
        hold = sum(f.holds for f in own)
        worst = max((f.true - ROUNDING) / max(f.bound, 1e-300) for f in own)
        large = sum(f.true > 1e-9 for f in own)
        slack = np.median([f.bound / f.true for f in own if f.true > 1e-9] or [np.nan])
        loose = sum(f.bound > f.tolerance for f in own)
        print(
            f"{name:24s} {len(own):9d} {large:11d} {hold:6d} {100 * hold / len(own):6.1f} {max(worst, 0):18.3g} "
            f"{slack:19.3g} {loose:19d}"
        )


def line(f: Found) -> str:
    return (
        f"{f.number:4d} {f.kind:10s} {f.decision:28s} {f.norm:3s} tolerance {f.tolerance:<6g} stated {f.bound:8.2e} "
        f"true {f.true:8.2e} at {f.at}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--show", action="store_true", help="every decision on a line")
    given = parser.parse_args()
    jobs = [(given.seed, number) for number in range(given.first, given.first + given.count)]
    rows: list[Found] = []
    refused, spent, sparse, full = [], np.zeros(3), 0, 0
    with multiprocessing.get_context("spawn").Pool(given.workers) as pool:
        for number, kind, why, found, *seconds in pool.imap_unordered(one, jobs):
            if why:
                refused.append(f"{number} {kind}: {why}")
                print(f"refused {refused[-1]}", flush=True)
                continue
            sparse, full = sparse + (kind in SPARSE), full + (kind not in SPARSE)
            spent += seconds
            rows += found
            done = len(refused) + sparse + full
            if done % 25 == 0:
                hold = sum(f.holds for f in rows if f.seen)
                print(f"{done} pipelines: {hold} of {sum(f.seen for f in rows)} decisions hold", flush=True)
            for f in found:
                if given.show or (f.seen and not f.holds):
                    print(("" if f.holds else "BROKEN ") + line(f), flush=True)
    shown = [f for f in rows if f.seen]
    if not shown:
        sys.exit("no pipeline has a decision that means show")
    print(f"\n{given.count - len(refused)} pipelines, {sparse} of them sparse; {len(refused)} refused")
    print(f"{len(shown)} decisions that means show, {len(rows) - len(shown)} about noise (not counted)\n")
    table(shown, lambda f: f.kind)
    print()
    table(shown, lambda f: f.decision)
    print("\nworst ten")
    for f in sorted(shown, key=lambda f: -(f.true - ROUNDING) / max(f.bound, 1e-300))[:10]:
        print(line(f))
    print(f"\nseconds: planning {spent[0]:.1f}, stages {spent[1]:.1f} with decisions, {spent[2]:.1f} without")
    sys.exit(int(sum(f.holds for f in shown) < 0.99 * len(shown)))


if __name__ == "__main__":
    main()
