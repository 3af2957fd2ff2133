"""Honest error bars: random pipelines with small sweeps, errors stated for cells that nobody measured against the true
ones.

    python benchmarks/error_bars.py [--count 200] [--workers 2]

Every pipeline is a scene, a lens, a sensor and colours with values drawn from wide ranges, swept over two quantities (4
x 4); four places are measured. Counted are the wanted variables of which the true error of the worst unmeasured cell is
above 1e-6: stated >= true in so many percent, and stated < 10 x true. Exit code 1 below 95 and 80.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from etendue.accuracy.measuring import Measurement
from etendue.accuracy.pilot import stated_elsewhere
from etendue.contract.registry import installed_stages
from etendue.errors import EtendueError
from etendue.plan.planner import make_plan
from etendue.session import Options, load

MEASURED, ABOVE = 4, 1e-6
SCENES = ("composite", "slanted_edge", "siemens_star", "zone_plate", "step_wedge", "points", "colorchecker")
AXES = {
    "f_number": (1.4, 22),
    "pixel_pitch": (1.5, 6),
    "integration_time": (1e-3, 1e-1),
    "focal_length": (3, 40),
    "diffusion_depth": (1, 15),
    "aperture_fraction": (0.4, 1),
}
UNITS = {"pixel_pitch": " um", "integration_time": " s", "focal_length": " mm", "diffusion_depth": " um"}


def document(seed: int) -> dict[str, Any]:
    """A pipeline with a sweep."""
    rng = np.random.default_rng([2026, seed])

    def log(low: float, high: float) -> float:
        return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.4g}")

    bins = int(rng.choice([10, 20, 25, 50]))
    scene = {
        "use": str(rng.choice(SCENES)),
        "name": "scene",
        "white_luminance": f"{log(10, 1e4)} cd m-2",
        "width": "220 um",
        "height": "200 um",
        "spacing": "1 um",
        "wavelength_from": "400 nm",
        "wavelength_to": "700 nm",
        "bin_width": f"{bins} nm",
    }
    if rng.random() < 0.5:
        scene["softness"] = log(0.7, 8)
    blur = [{"use": "diffraction"}, {"use": "lens_gaussian", "sigma": f"{log(0.1, 4)} um"}]
    stages = [scene, {"use": "irradiance"}, {"use": "falloff"}, *blur[: int(rng.integers(1, 3))], {"use": "diffusion"}]
    stages += [
        {"use": "pixel", "rows": 30, "columns": 32},
        {"use": "mosaic"},
        {"use": "exposure"},
        {"use": "shot_noise"},
    ]
    stages += [
        {"use": "full_well"},
        {"use": "read_noise"},
        {"use": "adc"},
        {"use": "linearise"},
        {"use": "white"},
        {"use": "balance_mosaic"},
    ]
    stages += [{"use": str(rng.choice(["demosaic_bilinear", "demosaic_colour_difference"])), "name": "demosaic"}]
    stages += [{"use": "sharpen", "strength": log(0.01, 0.3)}] if rng.random() < 0.5 else []
    stages += [{"use": use} for use in ("colour_fit", "camera_to_xyz", "balance", "display", "encode")]
    camera = {
        name: f"{log(*span)}{UNITS.get(name, '')}" if name in UNITS else log(*span) for name, span in AXES.items()
    }
    swept = [str(name) for name in rng.choice(list(AXES), 2, replace=False)]
    sweep = {}
    for name in swept:
        camera.pop(name)
        low, high = sorted((log(*AXES[name]), log(*AXES[name])))
        sweep[name] = {
            "from": f"{low}{UNITS.get(name, '')}",
            "to": f"{max(high, 1.2 * low):.4g}{UNITS.get(name, '')}",
            "steps": 4,
        }
        if name not in UNITS:
            sweep[name] = [float(f"{v:.4g}") for v in np.linspace(low, max(high, 1.2 * low), 4)]
        if name == "aperture_fraction":
            sweep[name] = [min(v, 1.0 - 0.01 * (3 - i)) for i, v in enumerate(sweep[name])]
    return {
        "name": f"drawn_{seed}",
        "seed": seed,
        "tolerance": float(rng.choice([1e-2, 3e-3, 1e-3, 1e-4])),
        "camera": camera | {"peak_qe": [0.5] * 3},
        "stages": stages,
        "sweep": sweep,
        "wanted": ["photon_rate", "mosaic_linear", "rgb_display"],
    }


def one(seed: int) -> tuple[int, str, list[tuple[str, float, float]]]:
    """Seed, what was refused, and (variable, stated, true) of the worst unmeasured cell."""
    registry = installed_stages()
    try:
        pipeline = load(document(seed))
        few = Measurement(pipeline, registry, MEASURED, Options("serial"))
        plan = make_plan(pipeline, registry, expected=True)
        stated = stated_elsewhere(plan, few.errors(), few.places)
        whole = Measurement(pipeline, registry, 10**6, Options("serial"))
        held = [place for place in whole.places if place not in few.places]
        whole.places = tuple(held)
        true = whole.errors().errors
    except EtendueError as error:
        return seed, str(error).splitlines()[0], []
    return seed, "", [(n, s, true[n].rms) for n, s in stated.items() if s is not None and true[n].rms is not None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--show", action="store_true", help="every pipeline on a line")
    given = parser.parse_args()
    with multiprocessing.get_context("spawn").Pool(given.workers) as pool:
        found = list(pool.imap_unordered(one, range(given.count)))
    refused = [(seed, why) for seed, why, _ in found if why]
    pairs = [(seed, *row) for seed, _, rows in sorted(found) for row in rows if row[2] > ABOVE]
    if given.show:
        for seed, name, stated, true in pairs:
            print(f"{seed:4d} {name:14s} stated {stated:.1e} true {true:.1e} {stated / true:6.2f} x")
    honest = 100 * np.mean([stated >= true for _, _, stated, true in pairs])
    near = 100 * np.mean([stated < 10 * true for _, _, stated, true in pairs])
    for seed, why in refused:
        print(f"refused: {seed}: {why}")
    print(
        f"{given.count - len(refused)} pipelines, {len(pairs)} variables with an error above {ABOVE:g}: "
        f"stated >= true in {honest:.1f} %, stated < 10 x true in {near:.1f} %"
    )
    sys.exit(int(honest < 95 or near < 80))


if __name__ == "__main__":
    main()
