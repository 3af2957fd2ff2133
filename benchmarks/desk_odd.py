"""Measurements as they come: 8 to 16 bits, levels by time, light or both, few frames, rows that move, an unsteady lamp.

    python benchmarks/desk_odd.py [--count 60] [--first 0]

Each sensor is drawn with NumPy alone, independently of the product's stages, calibrated and checked. Of every
parameter: in how many sets its 95 % interval holds what was put in; then the sets that are refused, where a bend is
missed or found without one, and where the check finds its own camera beyond a limit. With dark frames at one exposure
time, and dark charge that cannot be told, black level and read noise hold it, and are not counted.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from etendue.errors import RequestError
from etendue_lab.calibrate.study import calibrated

Take = Callable[[float, float, int], np.ndarray]  # time (s), photons, frames: codes (frame, y, x)


def sensor(rng: np.random.Generator) -> tuple[dict[str, float], float, Take]:
    """Draw a sensor: its parameters, the photons that fill its converter, and how it takes frames."""
    top = 2 ** int(rng.choice([8, 10, 12, 14, 16])) - 1
    gain = float(rng.uniform(0.3, 1.5) * top / rng.choice([8000, 15000, 40000]))
    read = max(float(np.exp(rng.uniform(np.log(1.5), np.log(20)))), 0.6 / gain)
    true = {
        "gain": gain,
        "quantum_efficiency": rng.uniform(0.2, 0.9),
        "read_noise": read,
        "dsnu": rng.uniform(0.1, 1) * read,
        "prnu": rng.uniform(0.003, 0.02),
        "black_level": float(np.ceil(6 * np.hypot(read, 2) * gain + rng.uniform(0, 50) * top / 4095)),
        "dark_current": rng.choice([0.0, rng.uniform(0, 3000)]),
    }
    if rng.random() < 1 / 3:
        true["bend"] = rng.uniform(0.01, 0.05)
    order, side = int(rng.integers(1, 4)), int(rng.choice([48, 64, 96, 128]))
    rows, lamp = rng.choice([0, 0, rng.uniform(0.1, 1) * read]), rng.choice([0, 0, 0.003])
    offset = true["dsnu"] * rng.standard_normal((side, side))
    response = 1 + true["prnu"] * rng.standard_normal((side, side))

    def one(time: float, photons: float) -> np.ndarray:
        light = true["quantum_efficiency"] * photons * (1 + lamp * rng.standard_normal())
        charge = rng.poisson(light * response + true["dark_current"] * time) + offset
        charge = charge + read * rng.standard_normal(charge.shape) + rows * rng.standard_normal((side, 1))
        charge = charge * (1 - true.get("bend", 0.0) * (np.maximum(charge, 0) * gain / top) ** order)
        return np.clip(np.rint(charge * gain + true["black_level"]), 0, top).astype(np.uint16)

    def take(time: float, photons: float, frames: int) -> np.ndarray:
        return np.stack([one(time, photons) for _ in range(frames)])

    return true, (top - true["black_level"]) / gain / true["quantum_efficiency"], take


def frames(rng: np.random.Generator, full: float, take: Take) -> dict[str, Any]:
    """Take a measurement with levels in any order."""
    levels, count = int(rng.integers(6, 40)), int(rng.choice([2, 2, 3]))
    shares = np.linspace(1 / levels, 1, levels) if rng.random() < 0.5 else rng.uniform(0.01, 1, levels)
    photons = rng.permutation(shares) * full * float(rng.choice([0.8, 1.3]))
    times = {
        "time": photons / photons.max() * float(rng.choice([0.002, 0.05])),
        "light": np.full(levels, 0.01),
        "both": rng.choice([0.001, 0.004, 0.02], levels),
    }[str(rng.choice(["time", "light", "both"]))]
    dark = np.unique(times) if rng.random() < 0.7 else np.array([times.mean()])
    found = {
        "light": np.stack([take(*one, count) for one in zip(times, photons, strict=True)]),
        "light_time_s": times,
        "light_photons_per_pixel": photons,
        "dark": np.stack([take(one, 0.0, 8 if dark.size < 4 else 2) for one in dark]),
        "dark_time_s": dark,
    }
    if rng.random() < 0.6:
        half = levels // 2
        found |= {
            "light_stack": take(times[half], photons[half], 12),
            "light_stack_time_s": times[half],
            "light_stack_photons_per_pixel": photons[half],
            "dark_stack": take(times[half], 0.0, 12),
            "dark_stack_time_s": times[half],
        }
    return found


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--count", type=int, default=60)
    asked.add_argument("--first", type=int, default=0)
    given = asked.parse_args()
    held: dict[str, list[bool]] = defaultdict(list)
    kinds: dict[str, list[int]] = defaultdict(list)
    for number in range(given.first, given.first + given.count):
        rng = np.random.default_rng((1288, number))
        true, full, take = sensor(rng)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "frames.npz"
            np.savez(path, **frames(rng, full, take))
            try:
                document, _ = calibrated(path, check=True)
            except RequestError:
                kinds["refused"].append(number)
                continue
        channel = document["channels"][0]
        found = {one["name"]: one for one in channel["parameters"]}
        for name, value in true.items():
            counted = name in found and not (
                name in ("black_level", "read_noise") and "dark_current" in channel["needs"]
            )
            if counted:
                held[name].append(found[name]["low"] <= value <= found[name]["high"])
        if ("bend" in found) != ("bend" in true):
            kinds["a bend that is missed" if "bend" in true else "a bend where there is none"].append(number)
        if not all(document["checks"][0]["within"].values()):
            kinds["beyond a limit of the check"].append(number)
    for name, values in held.items():
        print(f"{name:20s} {sum(values):3d} of {len(values):3d}")
    pairs = [own for values in held.values() for own in values]
    print(f"{'all':20s} {sum(pairs):3d} of {len(pairs):3d} = {100 * np.mean(pairs):.1f} %")
    for kind, numbers in kinds.items():
        print(f"{kind}: {len(numbers)} ({', '.join(map(str, numbers))})")


if __name__ == "__main__":
    main()
