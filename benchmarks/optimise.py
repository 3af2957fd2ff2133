"""Does a search find what a grid of 10,000 known cells has? One goal within a limit, and two goals, against the grid.

    python benchmarks/optimise.py [--seeds 20] [--trials 150] [--front 300] [--grid FILE]

Of a small camera f-number, exposure time and pixel pitch are searched; its noise is common to all cells. The grid is
computed, cell by cell; trials get the metrics of their settings from it, linear between cells, so that the best is known
and many searches can be tried. ``--computed N`` also computes N settings between the cells, to show how far that is off.
One goal: the largest
mean_snr of which at most 2 % is clipped and mtf50 is at least 60 cycles/mm. Two goals: mean_snr and mtf50, by the share
of the grid's hypervolume. Beside both: random search. ``--grid`` keeps the cells in a file for the next call.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from etendue.contract.registry import installed_stages
from etendue.evaluation.session import Row, Session
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


def between(known: np.ndarray, settings: Any) -> dict[str, float]:
    """The metrics at settings between the cells: linear in the steps of the grid."""
    cube = known.reshape(RANGES["f_number"][2], RANGES["pixel_pitch"][2], RANGES["integration_time"][2], 3)
    for name in ("f_number", "pixel_pitch", "integration_time"):
        low, high, count = RANGES[name]
        value = settings[name]
        share = (value - low) / (high - low) if name == "pixel_pitch" else np.log(value / low) / np.log(high / low)
        place = share * (count - 1)
        below = min(int(place), count - 2)
        cube = cube[below] + (place - below) * (cube[below + 1] - cube[below])
    return dict(zip(("mean_snr", "clipped_fraction", "mtf50_lp_mm"), map(float, cube), strict=True))


def from_grid(known: np.ndarray) -> Any:
    """What replaces the evaluation of rows: the same without a camera."""

    def rows(session: Session, settings: Any, names: Any) -> Iterator[Row]:
        for number, own in enumerate(settings):
            yield Row(number, own, between(known, own))

    return rows


def apart(known: np.ndarray, count: int) -> list[float]:
    """By how much mean_snr and mtf50 between cells differ from those of the camera there, at random settings."""
    draw, session, found = np.random.default_rng(1), Session(camera()), list[float]()
    for _ in range(count):
        own = {
            "f_number": float(np.exp(draw.uniform(*np.log(RANGES["f_number"][:2])))),
            "integration_time": float(np.exp(draw.uniform(*np.log(RANGES["integration_time"][:2])))),
            "pixel_pitch": float(draw.uniform(*RANGES["pixel_pitch"][:2])),
        }
        record, linear = session.metrics(METRICS, **own), between(known, own)
        found.append(abs(linear["mean_snr"] / record["mean_snr"] - 1))
        found.append(abs(linear["mtf50_lp_mm"] / float(np.min(record["mtf50_lp_mm"])) - 1))
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
    given.add_argument("--computed", type=int, default=5)
    given.add_argument("--samplers", nargs="+", default=["tpe", "random"])
    asked = given.parse_args()
    began = time.process_time()
    known = cells(asked.grid)
    seconds = time.process_time() - began
    allowed = known[(known[:, 1] <= 0.02) & (known[:, 2] >= 60)]
    best = allowed[:, 0].max()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print(f"{len(known)} cells in {seconds:.0f} CPU s, {len(allowed)} within the limits, the best {best:.5g}")
    if asked.computed:
        print(f"between cells the grid is within {100 * max(apart(known, asked.computed)):.1f} % of the camera")
    Session.rows = from_grid(known)  # type: ignore[method-assign]
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
        met = [one for one in needed if one is not None]
        print(
            f"{sampler}: within 0.5 % of the best cell in {len(met)} of {asked.seeds} seeds of {asked.trials} trials "
            f"(median trial {np.median(met) if met else float('nan'):.0f}); smallest share {min(ratios):.4f}; "
            f"{(time.process_time() - began) / (asked.seeds * asked.trials) * 1e3:.0f} CPU ms a trial",
            flush=True,
        )
        shares = []
        for seed in range(min(asked.seeds, 5)):
            found = search(pipeline, replace(two, seed=seed, sampler=sampler), asked.front)
            shares.append(volume(np.array([t.values for t in found.trials if t.values]), worst) / whole)
        print(f"{sampler}: {', '.join(f'{100 * s:.1f} %' for s in shares)} of the grid's hypervolume", flush=True)


if __name__ == "__main__":
    main()
