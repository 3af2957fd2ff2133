"""A simulated EMVA 1288 measurement against what was put in: 200 sensors, each with patterns and noise of its own.

    python benchmarks/emva.py [--seeds 200] [--first 0]

The sensor is the product's own stages (bracket, exposure, shot_noise, full_well, read_noise, adc); the measurement is
`etendue_camera.electronics.emva.measure`, which sees raw frames only. For each quantity: truth, mean over the sensors,
bias (in percent, and in standard errors of the mean), half an interval, how wide that is beside what estimates spread
(1 is right), and the share of 95 % intervals that hold the truth. Bound: 90 to 98 %.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from typing import Any

import numpy as np

from etendue.compute.random import philox
from etendue.compute.tables import PatternRandom
from etendue.contract.arrays.grid import Grid, Line
from etendue_camera.electronics import dynamic_range, emva
from etendue_camera.electronics.stages.exposure import Exposure, FullWell, ShotNoise
from etendue_camera.electronics.stages.read_out import Adc, ReadNoise

ROWS, COLUMNS, LEVELS, FRAMES = 96, 128, 16, 2
BASE = {
    "pixel_pitch": 5.4,
    "aperture_fraction": 0.741,
    "full_well_density": 1000.0,
    "bits": 12,
    "black_level": 128.0,
    "dark_current_density": 2e-9,
    "read_noise": 8.0,
    "dsnu": 3.0,
    "prnu": 0.01,
    "dark_nonuniformity": 0.1,
}
SENSORS = {
    "limited by the well, gain 1": {"conversion_gain": 0.23},
    "limited by the converter, gain 8": {
        "conversion_gain": 0.23,
        "analogue_gain": 8.0,
        "read_noise": 2.0,
        "read_noise_after": 6.0,
    },
}
GRID = Grid.of({"y": Line(ROWS, 0.0, 1.0, "1", (0.0, 5.4)), "x": Line(COLUMNS, 0.0, 1.0, "1", (0.0, 5.4))})
CHECKED = ("gain", "read_noise", "dark_current", "full_well", "prnu", "dsnu")
LOW, HIGH = 0.90, 0.98
T_63 = 1.998  # Student's t of the jackknife's 63 degrees of freedom, at 95 %


def stage(kind: Any, values: dict[str, Any], **own: Any) -> Any:
    return kind(**{k: v for k, v in {**values, **own}.items() if k in kind.__dataclass_fields__})


def times() -> Any:
    """Ten levels up to 70 % of 0.1 s x full scale, and on to twice saturation."""
    return np.concatenate([np.linspace(0.0035, 0.07, 11), [0.08, 0.09, 0.1, 0.15, 0.2]])


def frames(values: dict[str, Any], rate: float, seed: int, what: str) -> Any:
    """Raw frames (level, frame, y, x) of a light of so many electron/s, from the product's own stages."""
    chain = (ShotNoise, FullWell, ReadNoise, Adc)
    light, sensor = np.full((ROWS, COLUMNS), rate, np.float32), PatternRandom(str(seed).encode(), GRID, "float32")
    exposed = [
        stage(Exposure, values, integration_time=float(time)).run(light, sensor)["expected_charge"] for time in times()
    ]
    charge = np.repeat(exposed, FRAMES, axis=0)
    for kind in chain:
        one = stage(kind, values)
        given = {"rng": philox(f"{seed}|{what}|{kind.__name__}".encode())} if kind in (ShotNoise, ReadNoise) else {}
        if kind is ReadNoise:
            given["rng_sensor"] = sensor
        (charge,) = one.run(charge, **given).values()
    return charge.reshape(times().size, FRAMES, ROWS, COLUMNS)


def truth(values: dict[str, Any], pattern_time: float = 0.05) -> tuple[dict[str, float], float]:
    """What a perfect measurement finds, with its patterns after a time; and the photocurrent that saturates after
    0.1 s.
    """
    adc = stage(Adc, values)
    dark = float(dynamic_range.dark_electrons(values["dark_current_density"], values["pixel_pitch"] ** 2, 1.0))
    rate = (adc.saturation() / 0.1) - dark
    return {
        "gain": adc.dn_per_electron(),
        "read_noise": stage(ReadNoise, values).read_sigma(),
        "dark_current": dark,
        "full_well": adc.saturation(),
        "prnu": values["prnu"],
        "dsnu": math.hypot(values["dsnu"], values["dark_nonuniformity"] * dark * pattern_time),
    }, rate


def study(
    values: dict[str, Any], seeds: int, first: int = 0
) -> tuple[dict[str, float], dict[str, list[emva.Estimate]]]:
    """The truth, and the estimates of every quantity for each of so many sensors."""
    true, rate = truth(values)
    found: dict[str, list[emva.Estimate]] = {name: [] for name in CHECKED}
    for seed in range(first, first + seeds):
        result = emva.measure(times(), frames(values, rate, seed, "light"), frames(values, 0.0, seed, "dark"))
        for name in CHECKED:
            found[name].append(getattr(result, name))
        true, _ = truth(values, float(times()[result.pattern_level]))
    return true, found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    asked = parser.parse_args()
    seeds = asked.seeds
    beyond = []
    for title, own in SENSORS.items():
        began = time.perf_counter()
        values = {**BASE, **own}
        true, found = study(values, seeds, asked.first)
        print(
            f"{title}: {seeds} sensors of {COLUMNS} x {ROWS} pixels, {LEVELS} times, {FRAMES} frames each of light and "
            f"dark"
        )
        heads = (
            f"{'truth':>11s} {'mean':>11s} {'bias %':>8s} {'of s.e.':>8s} {'+- %':>7s} {'wide':>6s} {'coverage':>9s}"
        )
        print(f"  {'quantity':14s} {'unit':12s} {heads}")
        for name in CHECKED:
            value = np.array([e.value for e in found[name]])
            held = np.mean([e.low <= true[name] <= e.high for e in found[name]])
            wide = np.mean([e.high - e.low for e in found[name]]) / 2 / true[name]
            error = value.std(ddof=1) / math.sqrt(seeds)
            bias = value.mean() - true[name]
            mark = "" if LOW <= held <= HIGH else "   beyond 90-98 %"
            print(
                f"  {name:14s} {found[name][0].unit or '1':12s} {true[name]:11.5g} {value.mean():11.5g} "
                f"{100 * bias / true[name]:8.3f} "
                f"{bias / error:8.2f} {100 * wide:7.2f} {wide * true[name] / T_63 / value.std(ddof=1):6.2f} "
                f"{100 * held:8.1f}%{mark}"
            )
            if mark:
                beyond.append(f"{name} ({title})")
        print(f"  {time.perf_counter() - began:.0f} s")
    print("beyond the bound: " + (", ".join(beyond) or "none"))
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main())
