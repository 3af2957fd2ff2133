"""Error of the answer: random pipelines, the stated error of every wanted variable against the true one.

    python benchmarks/answers.py [--count 300] [--workers 2] [--budget SECONDS] [--show]

Every pipeline is a scene of one of ten kinds with a lens, a sensor, processing and metrics drawn from wide ranges. The
truth is one run of the same camera written independently: a third of the bins and of the spacing, twice the width and
height where the chart allows it, nothing left out, 64 bits. Printed for each kind of scene: how many stated errors are
at least the true one, and how many are below ten times it. True errors below 1e-7 of full scale count as held, and not
in the ten times. Exit code 1 below 95 and 80 %.
"""

from __future__ import annotations

import argparse
import copy
import math
import multiprocessing
import os
import sys
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from etendue.accuracy.answers.error import is_number, part_between
from etendue.accuracy.answers.pilots import state_errors
from etendue.accuracy.answers.refinement import AS_PLANNED, Point
from etendue.contract.registry import installed_stages
from etendue.errors import EtendueError
from etendue.plan.planner import make_plan
from etendue.session import load

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
    spacing = round(pitch / float(rng.choice([2, 2.5, 3, 4])), 4)
    larger = float(rng.uniform(1.1, 1.8))
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
    if softened and rng.random() < 0.25:
        scene |= {"light": "cells", "softness": 0.0}
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


Row = tuple[str, str, float | None, float, float, dict[str, float], str]


def one(given: tuple[str, int, float]) -> tuple[str, int, str, list[Row], float]:
    """Kind, seed, what was refused, (variable, unit, stated, true, scale, parts, why not), seconds of stating."""
    kind, seed, budget = given
    registry = installed_stages()
    try:
        made = document(kind, seed)
        plan = make_plan(load(made), registry)
        truth = make_plan(load(refined(made)), registry, False, expected=True)
        stated = state_errors(plan, registry, None, budget)
        own, exact = (Point(which, registry, {}, plan.wanted) for which in (plan, truth))
        found, reference = own.values(own.planned({}, AS_PLANNED)), exact.values(truth)
    except EtendueError as error:
        return kind, seed, str(error).splitlines()[0], [], 0.0
    rows: list[Row] = []
    for name, error in stated.errors.items():
        key = (error.stage, error.variable)
        cell = truth.of(error.stage)[0]
        declared = truth.node(error.stage).writes[error.variable]
        if (
            key not in found
            or key not in reference
            or cell.grids[error.variable] != plan.of(error.stage)[0].grids[error.variable]
        ):
            continue
        away = part_between(found[key], reference[key], declared, cell.stage)
        if isinstance(away, str):
            continue
        scale = float(np.nanmax(np.abs(reference[key]))) if is_number(declared) else 1.0
        why = "; ".join(f"{part}: {text}" for part, text in error.open.items())
        parts = {part: value.rms for part, value in error.parts.items()}
        rows.append((name, error.unit, error.rms, away.rms, scale or 1.0, parts, why))
    return kind, seed, "", rows, stated.seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--budget", type=float, default=math.inf, help="seconds for stating one pipeline's errors")
    parser.add_argument("--show", action="store_true", help="every variable on a line")
    given = parser.parse_args()
    each = -(-given.count // len(KINDS))
    work = [(kind, seed, given.budget) for seed in range(each) for kind in KINDS][: given.count]
    with multiprocessing.get_context("spawn").Pool(given.workers) as pool:
        found = list(pool.imap_unordered(one, work))
    every: list[tuple[float, float, float, bool, str]] = []
    table: dict[str, list[tuple[float, float, float, bool]]] = {}
    for kind, seed, why, rows, _ in sorted(found, key=lambda item: (KINDS.index(item[0]), item[1])):
        if why:
            print(f"refused: {kind} {seed}: {why}")
        for name, _, stated, true, scale, parts, missing in rows:
            measured = not missing
            table.setdefault(kind, []).append((stated / scale, true / scale, scale, measured))
            shown = " ".join(f"{part} {value / scale:.1e}" for part, value in parts.items())
            line = (
                f"{kind} {seed} {name}: stated {stated / scale:.1e} true {true / scale:.1e} "
                f"{stated / true if true else math.inf:.2f} x, {shown}{f' NOT {missing}' if missing else ''}"
            )
            every.append((stated / scale, true / scale, stated / true if true else math.inf, measured, line))
            if given.show:
                print(line)
    print(f"{'kind':14} variables  held  below 10 x  not measured")
    total = [0.0, 0.0, 0.0]
    whole = [row for own in table.values() for row in own]
    for kind, every_row in [*table.items(), ("all", whole)]:
        measured = [row for row in every_row if row[3]]
        held = np.mean([stated >= true or true < NOTHING for stated, true, _, _ in measured])
        near = [stated < 10 * true for stated, true, _, _ in measured if true >= NOTHING]
        total = [100 * held, 100 * float(np.mean(near or [1.0])), 100 * (1 - len(measured) / len(every_row))]
        print(f"{kind:14} {len(every_row):9} {total[0]:5.1f} % {total[1]:9.1f} % {total[2]:11.1f} %")
    print("worst ten:")
    missed = [row for row in every if row[3] and row[1] >= NOTHING and row[0] < row[1]]
    for row in sorted(missed, key=lambda row: row[2])[:10]:
        print(f"  {row[4]}")
    print("largest overstatements:")
    for row in sorted((r for r in every if r[3] and r[1] >= NOTHING), key=lambda row: -row[2])[:10]:
        print(f"  {row[4]}")
    times = [seconds for _, _, why, _, seconds in found if not why]
    print(
        f"{len(times)} pipelines; stating an error took {np.median(times):.2f} s (median), {max(times):.2f} s at most"
    )
    sys.exit(int(total[0] < 95 or total[1] < 80))


if __name__ == "__main__":
    main()
