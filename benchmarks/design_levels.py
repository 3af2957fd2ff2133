"""What levels of the f-number save and cost: ``pipelines/sweep.toml`` over six factors, with and without 16 levels.

    python benchmarks/design_levels.py [POINTS] [SCRAMBLES] [REPEATS]

(a) measured seconds of stages, on one thread, for one design: the least of some repeats in turn;
(b) the error of the mean of every metric over scrambles of a design, on a frame of 32 x 32 pixels: rms about the mean
of all scrambles without levels.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from etendue.contract.registry import installed_stages
from etendue.pipeline.file import read_pipeline
from etendue.plan.model import Plan
from etendue.plan.planner import make_plan
from etendue.session import Options, execute

FILE = Path(__file__).parents[1] / "pipelines" / "sweep.toml"
FACTORS = {
    "pixel_pitch": ["3 um", "4.2 um", "5.4 um"],  # a continuous one reaches the pixel in every sample
    "integration_time": {"from": "4 ms", "to": "64 ms", "spacing": "log"},
    "read_noise": {"normal": [4, 0.8], "at_least": 0},
    "dsnu": {"from": 0.5, "to": 2},
    "dark_current_density": {"from": 1e-11, "to": 1e-9, "spacing": "log"},
}
METRICS = ("mtf50_lp_mm", "mean_snr", "dr_elgamal", "clipped_fraction")
SMALL = {
    "scene.width": "192 um",
    "scene.height": "192 um",
    "scene.bin_width": "80 nm",
    "pixel.rows": 32,
    "pixel.columns": 32,
    "tolerance": 1e-3,
}
ALLOWED_SECONDS, ALLOWED_ERROR = 0.35, 1.2


def planned(levels: int, points: int, seed: int, frame: dict[str, object]) -> Plan:
    f_number = {"from": 2, "to": 11, "spacing": "log"} | ({"levels": levels} if levels else {})
    design = {"method": "sobol", "points": points, "seed": seed, "factors": {"f_number": f_number, **FACTORS}}
    over = {
        "sweep": {},
        "keep": ["resolution", "dynamic_range", "exposure_report"],
        "wanted": list(METRICS),
        "design": design,
        **frame,
    }
    return make_plan(read_pipeline(FILE, over), installed_stages())


def stage_seconds(points: int, repeats: int) -> tuple[float, float]:
    """Return the least seconds of stages without and with levels."""
    found: dict[int, list[float]] = {0: [], 16: []}
    for _ in range(repeats):
        for levels, own in found.items():
            plan = planned(levels, points, 1, {})
            began = time.process_time()
            outcome = execute(plan, None, Options("serial", pictures=False))
            assert not outcome.failed
            spent, stages = time.process_time() - began, float(outcome.tree["summary"]["seconds"].sum())
            own.append(stages)
            count = {name: len(plan.of(name)) for name in ("irradiance", "lens", "pixel", "exposure_report")}
            print(
                f"  {levels or 'no'} levels: stages {stages:.1f} s, CPU in all {spent:.1f} s, cells {count}", flush=True
            )
    return min(found[0]), min(found[16])


def means(levels: int, points: int, seed: int) -> list[float]:
    """Return the mean of every metric over one scramble."""
    outcome = execute(planned(levels, points, seed, SMALL), None, Options("serial", pictures=False))
    assert not outcome.failed
    found = []
    for name in METRICS:
        data = next(one for one in outcome.tree.subtree if name in one.data_vars).to_dataset(inherit=False)
        for row in [str(word) for word in data.variables if str(word).endswith("_row")]:
            dim = row.removesuffix("_row")
            data = data.sel({dim: data[row]}) if dim in data[name].dims else data
        values = data[name].isel(stage=0) if "stage" in data[name].dims else data[name]
        found.append(float(values.mean("sample")))
    return found


def errors(points: int, scrambles: int) -> None:
    """Print the errors of the means."""
    plain, levelled = (np.array([means(levels, points, seed) for seed in range(scrambles)]) for levels in (0, 16))
    truth = plain.mean(axis=0)
    own, other = plain.std(axis=0, ddof=1), np.sqrt(((levelled - truth) ** 2).mean(axis=0))
    print(f"{points} points, {scrambles} scrambles: rms errors of means without levels and with 16", flush=True)
    for name, true, a, b in zip(METRICS, truth, own, other, strict=True):
        said = f"{name:18s} mean {true:9.4g}, rms {a:.3g} and {b:.3g}: {b / a if a else 1:.2f}"
        print(f"{said}; allowed {ALLOWED_ERROR}", flush=True)


def main(points: int = 128, scrambles: int = 20, repeats: int = 3) -> None:
    """Print both."""
    if scrambles:
        errors(points, scrambles)
    without, having = stage_seconds(points, repeats)
    print(f"{points} points: with levels {having / without:.2f} of the seconds without; allowed {ALLOWED_SECONDS}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]))
