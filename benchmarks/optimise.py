"""Does a search find what a grid of 10,000 known cells has? One goal within limits, and two goals, against the grid.

    python benchmarks/optimise.py [--seeds 20] [--trials 150] [--fronts 5] [--front 300] [--grid FILE]

Of a small camera f-number, exposure time and pixel pitch are searched; its noise is common to all cells. Every trial is
computed, at its own settings between the cells of the grid. One goal: the largest mean_snr of which at most 2 % is
clipped and mtf50 is at least 60 cycles/mm. Two goals: mean_snr and mtf50, by the share of the grid's hypervolume.
Beside both: random search. ``--grid`` keeps the cells in a file for the next call.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.registry import installed_stages
from etendue.evaluation.session import Session
from etendue.session import load
from etendue_lab.search.asked import read_request
from etendue_lab.search.study import Found, search

CAMERA = """
name = "searched"
seed = 1
tolerance = 1e-3
[camera]
noise = "common"
peak_qe = [0.36, 0.44, 0.40]
focal_length = "6 mm"
read_noise = 3
[[stages]]
use = "slanted_edge"
name = "scene"
white_luminance = "300 cd m-2"
width = "120 um"
height = "90 um"
spacing = "1.25 um"
wavelength_from = "400 nm"
wavelength_to = "700 nm"
bin_width = "50 nm"
"""
STAGES = ("irradiance", "falloff", "diffraction", "diffusion", "pixel", "mosaic", "exposure", "shot_noise", "full_well")
STAGES += ("read_noise", "adc", "exposure_report", "resolution")
RANGES = {"f_number": (1.4, 11.0, 25), "integration_time": (1e-3, 3e-2, 20), "pixel_pitch": (1.4, 6.0, 20)}
OVER = ["f_number=1.4:11:log", "integration_time=1 ms:30 ms:log", "pixel_pitch=1.4:6"]
LIMITS = ["clipped_fraction <= 0.02", "mtf50_lp_mm[min] >= 60"]
METRICS = ("mean_snr", "clipped_fraction", "mtf50_lp_mm")


def camera() -> Any:
    own = {"pixel": "rows = 12\ncolumns = 16\n"}
    return load(CAMERA + "".join(f'[[stages]]\nuse = "{name}"\n{own.get(name, "")}' for name in STAGES))


def cells(kept: Path | None) -> np.ndarray:
    """The metrics of every cell of the grid, (10000, 3): mean_snr, clipped_fraction, the smallest mtf50."""
    if kept is not None and kept.exists():
        return np.load(kept)
    session, rows = Session(camera()), []
    times = [float(one) for one in np.geomspace(*RANGES["integration_time"])]
    for stop in np.geomspace(*RANGES["f_number"]):
        for pitch in np.linspace(*RANGES["pixel_pitch"]):
            record = session.metrics(METRICS, f_number=float(stop), pixel_pitch=float(pitch), integration_time=times)
            sharp = np.asarray(record["mtf50_lp_mm"]).reshape(-1, 3).min(axis=1)
            columns = (record["mean_snr"], record["clipped_fraction"], np.broadcast_to(sharp, len(times)))
            rows.append(np.stack([np.ravel(one) for one in columns], axis=1))
    found = np.concatenate(rows)
    if kept is not None:
        np.save(kept, found)
    return found


def volume(points: np.ndarray, worst: np.ndarray) -> float:
    """The area that points of two goals, both to be large, have before a worst point."""
    area, reached = 0.0, worst[1]
    for first, second in sorted(map(tuple, points), reverse=True):
        if first > worst[0] and second > reached:
            area += (first - worst[0]) * (second - reached)
            reached = second
    return area


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--seeds", type=int, default=20)
    given.add_argument("--trials", type=int, default=150)
    given.add_argument("--front", type=int, default=300)
    given.add_argument("--grid", type=Path)
    given.add_argument("--fronts", type=int, default=5)
    given.add_argument("--samplers", nargs="+", default=["model", "tpe", "random"])
    asked = given.parse_args()
    began = time.process_time()
    known = cells(asked.grid)
    seconds = time.process_time() - began
    allowed = known[(known[:, 1] <= 0.02) & (known[:, 2] >= 60)]
    best = allowed[:, 0].max()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print(f"{len(known)} cells in {seconds:.0f} CPU s, {len(allowed)} within the limits, the best {best:.5g}")
    pipeline, stages = camera(), installed_stages()
    one = read_request(pipeline, stages, maximise=["mean_snr"], subject=LIMITS, over=OVER)
    two = read_request(pipeline, stages, maximise=["mean_snr", "mtf50_lp_mm[min]"], over=OVER)
    worst = np.array([known[:, 0].min(), known[:, 2].min()])
    whole = volume(known[:, [0, 2]], worst)
    for sampler in asked.samplers:
        began, ratios, needed = time.process_time(), [], []
        for seed in range(asked.seeds):
            found: Found = search(pipeline, replace(one, seed=seed, sampler=sampler), asked.trials)
            ratios.append(found.best[0].values[0] / best if found.best else 0.0)
            good = [t.number + 1 for t in found.trials if t.allowed and t.values[0] >= 0.995 * best]
            needed.append(good[0] if good else None)
            print(f"{sampler}, seed {seed}: {ratios[-1]:.4f}, 0.5 % at trial {needed[-1]}", flush=True)
        met = [one for one in needed if one is not None]
        if needed:
            print(
                f"{sampler}: within 0.5 % of the best in {len(met)} of {asked.seeds} seeds, {asked.trials} "
                f"trials (median trial {np.median(met) if met else float('nan'):.0f}); smallest {min(ratios):.4f}; "
                f"{(time.process_time() - began) / (asked.seeds * asked.trials) * 1e3:.0f} CPU ms a trial",
                flush=True,
            )
        shares = []
        for seed in range(asked.fronts):
            found = search(pipeline, replace(two, seed=seed, sampler=sampler), asked.front)
            shares.append(volume(np.array([t.values for t in found.trials if t.values]), worst) / whole)
        print(f"{sampler}: {', '.join(f'{100 * s:.1f} %' for s in shares)} of the grid's hypervolume", flush=True)


if __name__ == "__main__":
    main()
