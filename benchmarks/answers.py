"""Error of the answer: random pipelines, the stated error of every wanted variable against the true one.

    python benchmarks/answers.py [--count 300] [--workers 2] [--seed N] [--show]

Every pipeline is a scene of one of ten kinds with a lens, a sensor, processing and metrics drawn from wide ranges; one
in four sweeps two parameters of the camera. The truth is one run of the same camera written independently: a third of
the bins and of the spacing, twice the width and height where the chart allows it, nothing left out, 64 bits; of a
sweep, the largest difference over its points. Errors are stated twice: within the budget of a run on the command line
(the larger of a tenth of the run and 0.2 s), and without one, as by ``--measure``. Printed for both and for each kind
of scene: how many stated errors are at least the true one, how many are below ten times it, and how many are incomplete
("at least"), which are left out of the two. True errors below 1e-7 of full scale count as held, and not in the ten
times. Exit code 1 below 95 and 80 %, or above 20 % incomplete within the budget.
"""

from __future__ import annotations

import argparse
import copy
import itertools
import math
import multiprocessing
import os
import sys
import time
from dataclasses import dataclass
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from etendue.accuracy.answers.error import is_number, part_between
from etendue.accuracy.answers.pilots import state_errors
from etendue.accuracy.answers.refinement import Point
from etendue.contract.registry import Registry, installed_stages
from etendue.errors import EtendueError
from etendue.plan.model import Plan, StageVariable
from etendue.plan.planner import make_plan
from etendue.session import Options, execute, load

NOTHING = 1e-7  # of full scale
FINER = 3
PICTURE = "package:matplotlib/mpl-data/sample_data/grace_hopper.jpg"
KINDS = (
    "slanted_edge",
    "siemens_star",
    "zone_plate",
    "step_wedge",
    "points",
    "colorchecker",
    "composite",
    "dead_leaves",
    "photograph",
    "uniform",
)
EXTENDED = ("slanted_edge", "siemens_star", "zone_plate", "points", "uniform")
DEMOSAIC = ("bilinear", "colour_difference", "directional", "residual", "nearest", "any", "malvar")


def document(kind: str, seed: int) -> dict[str, Any]:
    """Return a pipeline."""
    rng = np.random.default_rng([20261126, KINDS.index(kind), seed])

    def log(low: float, high: float) -> float:
        return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")

    def maybe(share: float, *stages: dict[str, Any]) -> list[dict[str, Any]]:
        return [dict(one) for one in stages] if rng.random() < share else []

    pitch = log(1.5, 6)
    rows, columns = 2 * int(rng.integers(9, 15)), 2 * int(rng.integers(9, 16))
    spacing = round(pitch / float(rng.choice([2, 2.5, 3])), 4)
    larger = float(rng.uniform(1.1, 1.6))
    height, width = (round(math.ceil(n * pitch * larger / spacing) * spacing, 6) for n in (rows, columns))
    scene: dict[str, Any] = {
        "use": kind,
        "name": "scene",
        "white_luminance": f"{log(3, 1e4)} cd m-2",
        "width": width,
        "height": height,
        "spacing": spacing,
        "wavelength_from": 400,
        "wavelength_to": 700,
        "bin_width": int(rng.choice([10, 20, 25, 50])),
    }
    softened = kind not in ("photograph", "uniform")
    if softened and rng.random() < 0.4:
        scene["softness"] = log(0.7, 4)
    if softened and columns <= 20 and rng.random() < 0.5:  # small frames: the exact means over cells are slow
        scene |= {"light": "cells", "softness": 0.0, "bin_width": 50}
    if kind == "points":
        sigma = log(0.4, 1.2) * spacing
        scene |= {
            "spot_sigma": round(sigma, 4),
            "pitch": round(14 * spacing + 9 * sigma, 3),
            "background": log(1e-5, 1e-2),
        }
        scene["softness"] = 1.0
        scene.pop("light", None)
    if kind == "photograph":
        scene["file"] = PICTURE
    if kind == "siemens_star":
        scene |= {"radius": round(0.4 * min(width, height), 3), "cycles": int(rng.integers(6, 24))}
    if kind == "zone_plate":
        scene |= {"radius": round(0.4 * min(width, height), 3), "highest_frequency": round(0.2 / spacing, 4)}
    if kind == "dead_leaves":
        scene |= {"smallest": round(2 * spacing, 3), "largest": round(0.4 * min(width, height), 3)}
    stages = [scene, {"use": "irradiance"}, *maybe(0.2, {"use": "optical_filter"})]
    stages += maybe(0.7, {"use": "falloff"})
    stages += maybe(0.2, {"use": "distortion", "k1": round(float(rng.uniform(-0.05, 0.05)), 4)})
    stages += maybe(0.7, {"use": "diffraction"})
    stages += maybe(0.6, {"use": "lens_gaussian", "sigma": f"{log(0.1, 4)} um"})
    stages += maybe(0.15, {"use": "glare"})
    stages += maybe(0.7, {"use": "diffusion"})
    stages += [{"use": "pixel", "rows": rows, "columns": columns}, {"use": "mosaic"}]
    stages += maybe(0.3, {"use": "meter"})
    stages += [{"use": use} for use in ("exposure", "shot_noise", "full_well", "read_noise", "adc", "linearise")]
    stages += [{"use": use} for use in ("white", "balance_mosaic")]
    stages += [{"use": f"demosaic_{rng.choice(DEMOSAIC)}", "name": "demosaic"}]
    stages += maybe(0.4, {"use": "sharpen", "strength": log(0.01, 0.3)})
    stages += [{"use": use} for use in ("colour_fit", "camera_to_xyz", "balance", "display", "encode")]
    wanted = ["photon_rate", "mosaic_linear", "rgb_display"]
    figures = {
        "exposure_report": ("mean_snr",),
        "resolution": ("mtf50_lp_mm",),
        "exposure_numbers": ("exposure_value",),
        "dynamic_range": ("dr_elgamal",),
        "to_xyz": ("xyz_display",),
        "light_budget": (),
        "illuminance": (),
    }
    for use, names in figures.items():
        if rng.random() < 0.5:
            stages.append({"use": use})
            wanted += names or [use]
    if kind == "slanted_edge" and rng.random() < 0.6:
        stages.append({"use": "edge_resolution"})
        wanted.append("edge_resolution")
    camera: dict[str, Any] = {
        "f_number": log(1.4, 16),
        "pixel_pitch": f"{pitch} um",
        "integration_time": f"{log(1e-3, 1e-1)} s",
        "focal_length": f"{log(3, 40)} mm",
        "diffusion_depth": f"{log(1, 12)} um",
        "aperture_fraction": round(float(rng.uniform(0.5, 1)), 3),
        "peak_qe": [0.36, 0.44, 0.4],
        "illuminant": str(rng.choice(["D65", "A", "FL2", "LED-B3"])),
    }
    if any(one["use"] == "meter" for one in stages):
        camera.pop("integration_time")
    made = {
        "name": f"drawn_{kind}_{seed}",
        "seed": seed,
        "tolerance": float(rng.choice([1e-2, 1e-3, 1e-4])),
        "camera": camera,
        "stages": stages,
    }
    return made | {"wanted": [one for one in wanted if one not in figures]}


def refined(made: dict[str, Any]) -> dict[str, Any]:
    """Return the same camera with everything finer."""
    found = copy.deepcopy(made)
    scene = found["stages"][0]
    size = {name: round(scene[name] / scene["spacing"]) for name in ("width", "height")}
    scene["bin_width"] /= FINER
    scene["spacing"] /= FINER
    if scene["use"] in EXTENDED:
        scene |= {name: count * made["stages"][0]["spacing"] * 2 for name, count in size.items()}
    return found | {"precision": "float64", "leave_out": False}


def swept(made: dict[str, Any], seed: int) -> dict[str, Any]:
    """Return the pipeline, every fourth of them with a sweep of two parameters."""
    if seed % 4 != 3:
        return made
    rng = np.random.default_rng([20261127, seed])
    f_number = made["camera"]["f_number"]
    sweep: dict[str, Any] = {"f_number": sorted({f_number, *(round(float(rng.uniform(1.4, 16)), 2) for _ in range(2))})}
    if "integration_time" in made["camera"]:
        sweep["integration_time"] = [made["camera"]["integration_time"], "3 ms"]
    return made | {"sweep": sweep}


@dataclass(frozen=True)
class Row:
    """One wanted variable of a pipeline. Errors of numbers are relative to the largest true value."""

    kind: str
    seed: int
    name: str
    stated: float
    true: float
    parts: dict[str, float]
    missing: str

    @property
    def ratio(self) -> float:
        return self.stated / self.true if self.true else math.inf

    def __str__(self) -> str:
        parts = " ".join(f"{part} {value:.1e}" for part, value in self.parts.items())
        found = f"stated {self.stated:.1e} true {self.true:.1e} {self.ratio:.2f} x, {parts}"
        return f"{self.kind} {self.seed} {self.name}: {found}{f' NOT {self.missing}' if self.missing else ''}"


@dataclass(frozen=True)
class Drawn:
    """A pipeline: why it was refused, and its variables within the budget and without one, with the seconds of each."""

    kind: str
    seed: int
    refused: str = ""
    rows: tuple[list[Row], list[Row]] = ((), ())  # type: ignore[assignment]
    seconds: tuple[float, float] = (0.0, 0.0)
    run: float = 0.0


def true_errors(plan: Plan, truth: Plan, registry: Registry) -> dict[StageVariable, tuple[float, float]]:
    """Return the true error of every wanted variable that has one, and the scale of its values."""
    found: dict[StageVariable, tuple[float, float]] = {}
    for place in itertools.product(*(axis.values for axis in plan.axes)):
        at = {axis.dim: value for axis, value in zip(plan.axes, place, strict=True)}
        own, exact = (Point(which, registry, at, plan.wanted) for which in (plan, truth))
        values, reference = own.values(own.base), exact.values(exact.base)
        for stage, name in plan.wanted:
            cell = exact.base.of(stage)[0]
            declared, one = truth.node(stage).writes[name], (stage, name)
            if one not in values or one not in reference:
                continue
            if cell.grids[name] != own.base.of(stage)[0].grids[name]:
                continue
            away = part_between(values[one], reference[one], declared, cell.stage)
            if isinstance(away, str):
                continue
            scale = float(np.nanmax(np.abs(reference[one]))) if is_number(declared) else 1.0
            known = found.get(one, (0.0, 0.0))
            found[one] = max(known[0], away.rms), max(known[1], scale)
    return found


def one(given: tuple[str, int]) -> Drawn:
    kind, seed = given
    registry = installed_stages()
    try:
        made = swept(document(kind, seed), seed)
        plan = make_plan(load(made), registry)
        truth = make_plan(load(refined(made)), registry, False, expected=True)
        began = time.process_time()
        outcome = execute(plan, None, Options("serial", pictures=False))
        run = time.process_time() - began
        every = [state_errors(plan, registry, outcome, budget) for budget in (max(0.2, 0.1 * run), math.inf)]
        true = true_errors(plan, truth, registry)
    except EtendueError as error:
        return Drawn(kind, seed, str(error).splitlines()[0])
    rows: tuple[list[Row], list[Row]] = ([], [])
    for own, stated in zip(rows, every, strict=True):
        for name, error in stated.errors.items():
            if (error.stage, error.variable) in true:
                away, scale = true[error.stage, error.variable]
                scale = scale or 1.0
                why = "; ".join(f"{part}: {text}" for part, text in error.open.items() if part != "noise")
                parts = {part: value.rms / scale for part, value in error.parts.items()}
                own.append(Row(kind, seed, name, error.rms / scale, away / scale, parts, why))
    return Drawn(kind, seed, "", rows, (every[0].seconds, every[1].seconds), run)


def table(rows: list[Row]) -> tuple[float, float, float]:
    """Print the shares by kind of scene; return those of all."""
    print(f"{'kind':14} variables     held  below 10 x  incomplete")
    total = 100.0, 100.0, 0.0
    for kind in (*KINDS, "all"):
        every = [row for row in rows if kind in (row.kind, "all")]
        measured = [row for row in every if not row.missing]
        held = [row.stated >= row.true or row.true < NOTHING for row in measured]
        near = [row.stated < 10 * row.true for row in measured if row.true >= NOTHING]
        shares = [100 * float(np.mean(one or [True])) for one in (held, near)]
        total = shares[0], shares[1], 100 * (1 - len(measured) / max(len(every), 1))
        print(f"{kind:14} {len(every):9} {total[0]:6.1f} % {total[1]:9.1f} % {total[2]:9.1f} %")
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="number of the first pipeline of each kind")
    parser.add_argument("--show", action="store_true", help="every variable on a line")
    given = parser.parse_args()
    each = -(-given.count // len(KINDS))
    work = [(kind, given.seed + seed) for seed in range(each) for kind in KINDS][: given.count]
    found: list[Drawn] = []
    with multiprocessing.get_context("spawn").Pool(given.workers) as pool:
        for number, drawn in enumerate(pool.imap_unordered(one, work), 1):
            found.append(drawn)
            seconds = " and ".join(f"{one:.2f}" for one in drawn.seconds)
            what = drawn.refused or f"run {drawn.run:.2f} s, stating {seconds} s"
            print(f"{number}/{len(work)} {drawn.kind} {drawn.seed}: {what}", file=sys.stderr, flush=True)
            for row in drawn.rows[1] if given.show else ():
                print(row, flush=True)
    made = [drawn for drawn in found if not drawn.refused]
    print(f"{len(made)} pipelines; refused: {len(found) - len(made)}")
    shares = []
    for number, title in enumerate(("within the budget of a run", "without a budget")):
        rows = [row for drawn in made for row in drawn.rows[number]]
        print(f"\n{title}")
        shares.append(table(rows))
        times = [drawn.seconds[number] for drawn in made]
        print(f"stating an error took {np.median(times):.2f} s (median), {max(times):.2f} s at most")
        known = sorted((r for r in rows if not r.missing and r.true >= NOTHING), key=lambda row: row.ratio)
        print("worst ten:", *(row for row in known[:10] if row.ratio < 1), sep="\n  ")
        print("largest overstatements:", *known[:-11:-1], sep="\n  ")
    sys.exit(int(any(one[0] < 95 or one[1] < 80 for one in shares) or shares[0][2] > 20))


if __name__ == "__main__":
    main()
