"""Forty simulated cameras drawn at random, each calibrated from its own frames: do its intervals hold the truth?

    python benchmarks/desk.py                  # forty with a bend of 0 or 1 to 5 %, forty without, forty with 1 %
    python benchmarks/desk.py --count 10

Prints coverage by parameter, the median width of intervals relative to the Cramer-Rao bound, and how often a bend is
found. The frames are drawn here, independently of the camera's stages: Poisson counts, normal noise, rounding.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from etendue_lab.calibrate.calibration import calibrate
from etendue_lab.calibrate.sensor_model import SensorModel
from etendue_lab.frames.reading import open_frames

SIDE, LEVELS, STACK, TOP = 128, 30, 16, 4095
BOUNDED = ("gain", "quantum_efficiency", "read_noise", "dark_current", "dsnu", "prnu", "bend", "black_level")


def drawn(rng: np.random.Generator, bend: float) -> dict[str, float]:
    """Draw the parameters of a camera."""
    return {
        "gain": float(np.exp(rng.uniform(math.log(0.08), math.log(0.8)))),
        "quantum_efficiency": rng.uniform(0.2, 0.8),
        "read_noise": float(np.exp(rng.uniform(math.log(5), math.log(25)))),
        "dsnu": rng.uniform(1, 10),
        "prnu": rng.uniform(0.002, 0.015),
        "black_level": rng.uniform(60, 200),
        "dark_current": rng.uniform(0, 3000),
        "bend": bend,
        "order": float(rng.integers(1, 4)),
    }


def frames_of(camera: dict[str, float], rng: np.random.Generator) -> dict[str, Any]:
    """Draw the frames of a measurement by time at constant light."""
    shape = (SIDE, SIDE)
    offset = camera["dsnu"] * rng.standard_normal(shape)
    response = 1 + camera["prnu"] * rng.standard_normal(shape)
    full = TOP / camera["gain"]

    def take(time: float, photons: float, count: int) -> np.ndarray:
        mean = camera["quantum_efficiency"] * photons * response + camera["dark_current"] * time
        charge = (
            rng.poisson(mean, (count, *shape)) + camera["read_noise"] * rng.standard_normal((count, *shape)) + offset
        )
        charge *= 1 - camera["bend"] * (np.maximum(charge, 0) / full) ** camera["order"]
        codes = np.floor(charge * camera["gain"] + camera["black_level"] + 0.5)
        return np.clip(codes, 0, TOP).astype(np.uint16)

    times = np.linspace(0.001, 0.03, LEVELS)
    photons = times / times[-1] * 1.1 * (TOP - camera["black_level"]) / camera["gain"] / camera["quantum_efficiency"]
    half = LEVELS // 2 - 1
    return {
        "light": np.stack([take(t, p, 2) for t, p in zip(times, photons, strict=True)]),
        "light_time_s": times,
        "light_photons_per_pixel": photons,
        "dark": np.stack([take(t, 0, 2) for t in times]),
        "dark_time_s": times,
        "light_stack": take(times[half], photons[half], STACK),
        "light_stack_time_s": times[half],
        "light_stack_photons_per_pixel": photons[half],
        "dark_stack": take(times[half], 0, STACK),
        "dark_stack_time_s": times[half],
    }


def calibrated(camera: dict[str, float], rng: np.random.Generator) -> SensorModel:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.npz"
        np.savez(path, **frames_of(camera, rng))
        return calibrate(open_frames(path))


def bounds(camera: dict[str, float], model: SensorModel) -> dict[str, float]:
    """Return Cramer-Rao bounds (standard errors) of the model, for normal pixels of known kind.

    Gain, rate and bend: the Fisher information of means and variances of all levels; others: their closed forms.
    """
    curve, pixels = model.curve, SIDE**2
    used, frames = model.response.used, np.array([one.frames for one in curve.moments])
    gain, order, full = camera["gain"], camera["order"], float(TOP)
    light, dark = curve.exposure[used], (gain * camera["read_noise"]) ** 2

    def at(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s = v[1] * light
        slope = 1 - v[2] * (order + 1) * (s / full) ** order
        return s * (1 - v[2] * (s / full) ** order), slope**2 * (v[0] * s + dark)

    start = np.array([gain, gain * camera["quantum_efficiency"], camera["bend"]])
    _, variance = at(start)
    columns = []
    for i in range(3 if camera["bend"] else 2):
        step = np.zeros(3)
        step[i] = 1e-5 * max(abs(start[i]), 1e-3)
        ends = [at(start + sign * step) for sign in (1, -1)]
        columns.append([(one - other) / (2 * step[i]) for one, other in zip(*ends, strict=True)])
    own = frames[used]
    weights = (own * pixels / variance, (own - 1) * pixels / (2 * variance**2))
    information = np.array(
        [
            [sum(float((w * a * b).sum()) for w, a, b in zip(weights, one, other, strict=True)) for other in columns]
            for one in columns
        ]
    )
    covariance = np.linalg.inv(information)
    darks = sum(one.frames for one in curve.dark)
    qe = camera["quantum_efficiency"]
    gradient = np.array([-qe / gain, 1 / gain, 0.0])[: len(covariance)]
    relative = math.sqrt(covariance[0, 0]) / gain
    square = camera["dsnu"] ** 2 + (camera["read_noise"] ** 2 + 1 / 12 / gain**2) / darks
    lights = model.light.frames if model.light else 1
    noise = 1 / (lights * float(np.mean(curve.signal[0, used])) / gain)
    times = np.array([one.time for one in curve.dark for _ in range(one.frames)])
    per_time = (camera["read_noise"] / SIDE) / math.sqrt(float(((times - times.mean()) ** 2).sum()))
    origin = (
        gain
        * camera["read_noise"]
        / SIDE
        * math.sqrt(1 / darks + times.mean() ** 2 / float(((times - times.mean()) ** 2).sum()))
    )
    found = {
        "gain": math.sqrt(covariance[0, 0]),
        "quantum_efficiency": math.sqrt(float(gradient @ covariance @ gradient)),
        "read_noise": camera["read_noise"]
        * math.hypot(relative, 1 / math.sqrt(2 * pixels * sum(o.frames - 1 for o in curve.dark))),
        "dark_current": math.hypot(per_time, camera["dark_current"] * relative),
        "dsnu": math.hypot(square / camera["dsnu"] / math.sqrt(2 * pixels), camera["dsnu"] * relative),
        "prnu": (camera["prnu"] ** 2 + noise) / camera["prnu"] / math.sqrt(2 * pixels),
        # the pattern's own mean over the pixels belongs to the level that is asked for
        "black_level": math.hypot(origin, gain * camera["dsnu"] / SIDE),
    }
    return found | ({"bend": math.sqrt(covariance[2, 2])} if camera["bend"] else {})


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("--count", type=int, default=40)
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    held: dict[str, list[bool]] = {}
    widths: dict[str, list[float]] = {}
    for number in range(given.count):
        rng = np.random.default_rng((given.seed, number))
        camera = drawn(rng, float(rng.choice([0.0, rng.uniform(0.01, 0.05)])))
        model = calibrated(camera, rng)
        limits = bounds(camera, model)
        for name in BOUNDED:
            if name not in model.values:
                if name == "bend" and camera["bend"]:
                    held.setdefault(name, []).append(False)
                continue
            one = model.values[name]
            held.setdefault(name, []).append(one.low <= camera[name] <= one.high)
            if name in limits:
                widths.setdefault(name, []).append((one.high - one.low) / (2 * 1.96 * limits[name]))
    pairs = [own for values in held.values() for own in values]
    print(f"{'parameter':20s} inside        width over the bound (median)")
    for name, values in held.items():
        print(f"{name:20s} {sum(values):3d} of {len(values):3d}    {np.median(widths[name]):.2f}")
    print(f"{'all':20s} {sum(pairs):3d} of {len(pairs):3d} = {100 * np.mean(pairs):.1f} %")
    for bend in (0.0, 0.01):
        found = 0
        for number in range(given.count):
            rng = np.random.default_rng((given.seed + 1, number))
            camera = drawn(rng, bend)
            found += "bend" in calibrated(camera, rng).values
        print(f"bend {100 * bend:g} % at the top: found in {found} of {given.count}")


if __name__ == "__main__":
    main()
