"""Exposure and noise: claims and what is measured, and error against run time of the one fidelity knob.

    python benchmarks/noise.py

A claim is printed with its bound; what misses it is marked and makes the exit code 1.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

import numpy as np

import etendue
from etendue.compute.random import philox
from etendue.compute.tables import PatternRandom
from etendue.contract.arrays.grid import Grid, Line
from etendue_camera.electronics import converter, distributions, dynamic_range, noise
from etendue_camera.electronics.stages.exposure import Exposure, FullWell, ShotNoise
from etendue_camera.electronics.stages.read_out import Adc, ReadNoise

MISSED: list[str] = []
ROWS, COLUMNS = 256, 256
GRID = Grid.of({"y": Line(ROWS, 0.0, 1.0, "1", (0.0, 5.4)), "x": Line(COLUMNS, 0.0, 1.0, "1", (0.0, 5.4))})


def claim(what: str, bound: str, measured: str, holds: bool) -> None:
    print(f"  {what:68s} {bound:>16s} {measured:>22s}{'' if holds else '   MISSED'}")
    if not holds:
        MISSED.append(what)


def sampler_moments(mean: float, exact_below: float) -> tuple[float, float, float, float]:
    """Mean, variance, skewness and excess kurtosis of the law of `noise.poisson`, computed, not drawn."""
    if mean < exact_below:
        return mean, mean, mean**-0.5, 1 / mean
    if mean <= 1e6:
        counts, weight = distributions.normal_form_pmf(mean)
        values = counts - mean
    else:  # the cubic itself: rounding is under 1e-3 sigma
        z, weight = np.polynomial.hermite_e.hermegauss(40)
        weight = weight / weight.sum()
        thin = 1 / (72 * math.sqrt(mean))
        values = z * (z * (1 / 6 - z * thin) + (math.sqrt(mean) - 2 * thin)) + 1 / 3 - 0.5
    centre = float(weight @ values)
    second, third, fourth = (float(weight @ (values - centre) ** k) for k in (2, 3, 4))
    second += 1 / 12 if mean > 1e6 else 0.0  # of rounding
    return mean + centre, second, third / second**1.5, fourth / second**2 - 3


def shot_noise() -> None:
    print("shot noise: the law of the sampler against Poisson, at every mean (computed)")
    heads = ("mean, electron", "total variation", "mean / sigma", "variance - 1", "skew x root", "kurt x mean")
    print("  " + " ".join(f"{head:>15s}" for head in heads))
    worst = 0.0
    skews = []
    for mean in (
        1e-3,
        1e-2,
        0.1,
        1.0,
        5.0,
        10.0,
        24.9,
        25.1,
        29.9,
        30.0,
        50.0,
        100.0,
        1e3,
        1e4,
        1e5,
        1e6,
        1e7,
        1e8,
        1e9,
    ):
        variation = distributions.poisson_total_variation(mean)
        m, v, skew, kurt = sampler_moments(mean, 30.0)
        worst = max(worst, variation)
        skews.append(skew * math.sqrt(mean))
        off_mean, off_variance = (m - mean) / math.sqrt(mean), v / mean - 1
        print(
            f"  {mean:15g} {variation:15.2e} {off_mean:15.1e} {off_variance:15.1e} {skews[-1]:15.4f} "
            f"{kurt * mean:15.4f}"
        )
    claim("total variation from Poisson, 1e-3 to 1e9 electron", "<= 1e-3", f"{worst:.2e}", worst <= 1e-3)
    off = max(abs(s - 1) for s in skews)
    claim(
        "skewness x sqrt(mean) is 1 (a rounded normal: 0 from 25 electron on)",
        "1 +- 0.01",
        f"1 +- {off:.4f}",
        off <= 0.01,
    )
    generator = np.random.default_rng(1)
    for mean in (0.5, 24.9, 25.1, 300.0):
        drawn = noise.poisson(np.full(4_000_000, mean, np.float32), generator).astype(float) - mean
        skew = float((drawn**3).mean() / (drawn**2).mean() ** 1.5 * math.sqrt(mean))
        error = math.sqrt(6 / drawn.size * (1 + 10 / mean)) * math.sqrt(mean)
        claim(f"  drawn, 4e6 counts about {mean:g}", f"1 +- {4 * error:.3f}", f"{skew:.4f}", abs(skew - 1) < 4 * error)


def knob() -> None:
    print(
        "the knob exact_below: worst total variation against time per draw (1 million means, log-uniform, float32, one "
        "thread)"
    )
    frames = [(10.0 ** np.random.default_rng(2).uniform(low, 4, 1_000_000)).astype(np.float32) for low in (0, 2)]
    for below in (10.0, 30.0, 100.0, 1000.0, math.inf):
        best = [nanoseconds(lambda of, rng, below=below: noise.poisson(of, rng, below), means) for means in frames]
        worst = distributions.poisson_total_variation(below, below) if below < math.inf else 0.0
        print(
            f"  exact_below {below:7g}: {worst:9.2e}   means 1 to 1e4 {best[0]:6.1f} ns   100 to 1e4 {best[1]:6.1f} ns"
        )


def nanoseconds(draw: Any, means: Any) -> float:
    """Shortest thread time of a draw, ns a pixel."""
    shortest, generator = math.inf, philox(b"speed")
    for _ in range(9):
        began = time.thread_time()
        draw(means, generator)
        shortest = min(shortest, time.thread_time() - began)
    return shortest * 1e9 / float(means.size)


def speed() -> None:
    print("ns a pixel, 256 x 256 means, one thread: exact draws below 64 electrons from a table, beyond numpy's")
    print(f"  {'mean, electron':>15s} {'float32':>9s} {'float64':>9s} {'numpy':>9s}")

    def exact(of: Any, generator: Any) -> Any:
        return noise.poisson(of, generator, math.inf)

    slowest = 0.0
    shape = (ROWS, COLUMNS)
    frames = {
        f"{mean:g}": np.full(shape, mean)
        for mean in (1e-3, 1e-2, 0.1, 0.5, 1, 2, 3, 5, 7, 9.9, 10, 12, 15, 20, 25, 29.9, 45, 63)
    }
    for top in (2, 10, 30, 64):
        frames[f"0 to {top}"] = np.random.default_rng(1).uniform(0, top, shape)
    for name, means in frames.items():
        taken = [nanoseconds(exact, of) for of in (means.astype(np.float32), means)]
        numpys = nanoseconds(lambda of, generator: generator.poisson(of), means)
        if means.max() <= 30:
            slowest = max(slowest, *taken)
        print(f"  {name:>15s} " + " ".join(f"{one:9.1f}" for one in (*taken, numpys)))
    claim("ns a pixel at every mean below 30 electron", "<= 25", f"{slowest:.1f}", slowest <= 25)


def chain(charge: Any, seed: str, **values: Any) -> dict[str, Any]:
    """Expected charge through the product's own stages."""
    found = {"expected_charge": charge}
    for kind in (ShotNoise, FullWell, ReadNoise, Adc):
        stage = kind(**{k: v for k, v in values.items() if k in kind.__dataclass_fields__})
        given = {"rng": philox(f"{seed}|{kind.__name__}".encode())} if kind in (ShotNoise, ReadNoise) else {}
        if kind is ReadNoise:
            given["rng_sensor"] = PatternRandom(b"sensor", GRID, "float32")
        port = next(iter(kind.reads))
        found |= stage.run(found[port], **given)
    return found


def saturation() -> None:
    print("full well after the draw: the photon transfer collapses at saturation (well 9000 electron, no read noise)")
    values = {"full_well_density": 9000.0 / (5.4 * 0.741) ** 2, "read_noise": 0.0, "dsnu": 0.0}
    for share in (0.25, 0.5, 0.9, 0.99, 1.0, 1.01, 1.1):
        expected = np.full((ROWS, COLUMNS), 9000.0 * share, np.float32)
        print(
            f"  {share:5.2f} of the well: standard deviation {chain(expected, 'well', **values)['charge'].std():8.3f} "
            f"electron"
        )
    deep = chain(np.full((ROWS, COLUMNS), 9900.0, np.float32), "well", **values)["charge"].std()
    first = noise.poisson(np.full((ROWS, COLUMNS), 9000.0, np.float32), np.random.default_rng(3)).std()
    claim("deviation at 1.1 wells, electron (clipping the mean first: " + f"{first:.0f})", "0", f"{deep:g}", deep == 0)


def codes() -> None:
    print("converter and pedestal")
    for bits in (8, 10, 12, 14, 16):
        top = int(converter.digitise(np.array([1e12]), 1.0, 0.0, bits)[0])
        claim(f"top code of {bits} bits", str(2**bits - 1), str(top), top == 2**bits - 1)
    dark = np.zeros((ROWS, COLUMNS), np.float32)
    sigma = 2.5  # DN
    for pedestal, lifted in ((64, 0.0), (0, 1 / math.sqrt(math.tau))):
        values = {"read_noise": 10.0, "dsnu": 0.0, "conversion_gain": sigma / 10, "black_level": pedestal, "bits": 12}
        raw = chain(dark, "dark", **values)["raw"]
        found = float(raw.mean() - pedestal) / sigma
        error = 4 / 256
        claim(
            f"mean of a dark frame over its pedestal of {pedestal} DN, in sigma",
            f"{lifted:.2f} +- {error:.3f}",
            f"{found:+.4f}",
            abs(found - lifted) < error,
        )
        warned = Adc(**{k: v for k, v in values.items() if k in Adc.__dataclass_fields__}).warn(None, {})  # type: ignore[arg-type]
        claim(
            "  a warning", "yes" if pedestal == 0 else "no", "yes" if warned else "no", bool(warned) == (pedestal == 0)
        )


def patterns() -> None:
    print("fixed patterns: DSNU and PRNU belong to the sensor")
    flat = np.full((ROWS, COLUMNS), 1e5, np.float32)
    sensor = PatternRandom(b"sensor", GRID, "float32")
    expected = [
        Exposure(integration_time=time, prnu=0.01).run(flat, sensor)["expected_charge"] for time in (0.05, 0.05, 0.0125)
    ]
    values = {"read_noise": 0.0, "dsnu": 5.0, "conversion_gain": 0.25, "full_well_density": 1e4}
    frame_to_frame = np.corrcoef(expected[0].ravel(), expected[1].ravel())[0, 1]
    bracket = np.corrcoef(expected[0].ravel(), expected[2].ravel())[0, 1]
    claim(
        "PRNU: correlation of two frames, shot noise removed", "1", f"{frame_to_frame:.9f}", frame_to_frame > 1 - 1e-6
    )
    claim("PRNU: correlation of two brackets, shot noise removed", "1", f"{bracket:.9f}", bracket > 1 - 1e-6)
    quiet = chain(np.zeros((2, ROWS, COLUMNS), np.float32), "quiet", **values)["charge"]
    dsnu = np.corrcoef(quiet[0].ravel(), quiet[1].ravel())[0, 1]
    claim("DSNU: correlation of two dark frames, read noise removed", "1", f"{dsnu:.9f}", dsnu > 1 - 1e-6)
    noisy = chain(np.full((2, ROWS, COLUMNS), 10, np.float32), "noisy", **values)["charge"].astype(float)
    covariance = float(np.cov(noisy[0].ravel(), noisy[1].ravel())[0, 1])
    claim(
        "DSNU: covariance of two frames with shot noise, electron^2",
        "25 +- 0.8",
        f"{covariance:.2f}",
        abs(covariance - 25) < 0.8,
    )
    small = Grid.of({"y": Line(40, 30.0, 1.0, "1", (0.0, 5.4)), "x": Line(33, 50.0, 1.0, "1", (0.0, 5.4))})
    crop, window = (PatternRandom(b"s", g, "float32") for g in (GRID, small))
    same = np.array_equal(crop.normal("prnu")[30:70, 50:83], window.normal("prnu"))
    lines = np.array_equal(crop.row_normal("row")[30:70], window.row_normal("row"))
    claim(
        "a window of the sensor equals the crop, pixels and rows",
        "bit for bit",
        str(bool(same and lines)),
        bool(same and lines),
    )


def camera(serial: str = "1", name: str = "", **words: Any) -> tuple[Any, Any]:
    """What a whole camera shows of its PRNU and DSNU, the noise of the frame taken off."""
    light = {
        "white_luminance": 100,
        "width": 6 * COLUMNS,
        "height": 6 * ROWS,
        "spacing": 6,
        "wavelength_from": 545,
        "wavelength_to": 555,
    }
    stages = [
        {"use": "uniform", "bin_width": 10, **light},
        {"use": "irradiance"},
        {"use": "pixel", "rows": ROWS, "columns": COLUMNS},
        {"use": "mosaic"},
        {"use": "exposure", "prnu": 0.02, "dark_nonuniformity": 0, "name": "exposure" + name},
        {"use": "shot_noise"},
        {"use": "read_noise", "name": "read_noise" + name},
    ]
    quantities = {
        "pattern": "mono",
        "peak_qe": [0.5],
        "sensitivity": "flat",
        "pixel_pitch": 6,
        "read_noise": 0,
        "dsnu": 8,
    }
    tree = etendue.simulate(
        {
            "name": "one",
            "camera": {**quantities, "integration_time": 0.05, "sensor_serial": serial},
            "stages": stages,
            **words,
        }
    )
    charge = tree[f"read_noise{name}"].charge.values.astype(float) - tree["shot_noise"].charge.values
    return tree[f"exposure{name}"].expected_charge.values.astype(float), charge


def sensors() -> None:
    print("a fixed pattern follows the serial, its own name and the pixel; correlations of two runs, PRNU and DSNU")
    base = {"seed": 1, "precision": "float64"}
    one = camera(**base)
    for what, other in (
        ("another seed", camera(**{**base, "seed": 2})),
        ("the other precision", camera(**{**base, "precision": "float32"})),
        ("other names of the stages", camera(name="_b", **base)),
        ("another serial", camera("2", **base)),
        ("PRNU against DSNU", (one[1], one[0])),
    ):
        found = [float(np.corrcoef(a.ravel(), b.ravel())[0, 1]) for a, b in zip(one, other, strict=True)]
        apart = what in ("another serial", "PRNU against DSNU")
        holds = all(abs(r) < 0.02 if apart else r > 1 - 1e-8 for r in found)
        claim(what, "below 0.02" if apart else "1", ", ".join(f"{r:.9f}" for r in found), holds)


def ranges() -> None:
    print("dynamic range, two definitions (well 16000 electron, read noise 10, dark current 4 electron/s)")
    for seconds in (0.01, 1.0):
        dark = dynamic_range.dark_electrons(4 * 1.602176634e-19 / 2.916e-7, 29.16, seconds)
        elgamal = float(dynamic_range.dynamic_range_elgamal(16000.0, dark, 10.0, 0.0))
        emva = float(dynamic_range.dynamic_range_emva(16000.0, dark, 10.0, 0.25))
        print(f"  {seconds:5g} s: dark noise as smallest signal {elgamal:.3f} dB, SNR = 1 {emva:.3f} dB")


def main() -> int:
    for part in (shot_noise, speed, knob, saturation, codes, patterns, sensors, ranges):
        part()
    print("missed: " + (", ".join(MISSED) or "none"))
    return 1 if MISSED else 0


if __name__ == "__main__":
    sys.exit(main())
