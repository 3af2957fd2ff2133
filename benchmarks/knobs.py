"""Knobs: what a figure of `resolution` costs and errs by setting, and what closed forms cost; bound beside measured
value.

    python benchmarks/knobs.py

Times are CPU milliseconds of one thread. The cameras are those of pipelines/sweep.toml: 10 f-numbers by 10 pitches.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from etendue.compute.joined.otf import Otf, weights_of
from etendue.compute.tables import TABLES
from etendue.transfer import sampling
from etendue_camera.optics import diffraction
from etendue_camera.optics.stages.lens import Diffraction
from etendue_camera.resolution.stages.analytic import Resolution
from etendue_camera.sensor import photodiode, silicon
from etendue_camera.sensor.stages.pixel import Diffusion, Pixel

EDGES = tuple(400.0 + 20.0 * i for i in range(17))
SETTINGS = ((4096, True, 320), (512, True, 160), (256, True, 64), (512, False, 48), (256, False, 48), (128, False, 48))
ABSOLUTE = ("mtf_nyquist", "aliasing")
RELATIVE = ("mtf50", "mtf10", "cut_off", "rayleigh", "sparrow", "resolution_gain")


def cameras() -> list[Any]:
    found = []
    for number in (1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 14.0, 16.0, 22.0):
        for pitch in np.linspace(2.0, 6.0, 10):
            pixel = Pixel(pixel_pitch=float(pitch), aperture_fraction=0.741, peak_qe=(0.36, 0.44, 0.40))
            parts = (("lens", Diffraction(f_number=number)), ("diffusion", Diffusion()), ("pixel", pixel))
            otfs = [(name, Otf(parts[: i + 1], EDGES)) for i, (name, _) in enumerate(parts)]
            found.append((float(pitch), otfs, weights_of(pixel, EDGES)))
    return found


def figures(every: list[Any], nodes: int, solved: bool, points: int) -> tuple[float, list[Any]]:
    """Milliseconds a camera with nothing remembered, and the figures."""
    TABLES.clear()
    start = time.process_time()
    rows = [
        Resolution(pixel_pitch=p, nodes=nodes, solved=solved, point_nodes=points).run(otfs, weights)
        for p, otfs, weights in every
    ]
    return 1e3 * (time.process_time() - start) / len(every), rows


def largest_error(rows: list[Any], exact: list[Any]) -> float:
    worst = 0.0
    for row, true in zip(rows, exact, strict=True):
        for name in (*RELATIVE, *ABSOLUTE):
            for a, b in zip(np.ravel(row[name]), np.ravel(true[name]), strict=True):
                if math.isnan(a) != math.isnan(b):
                    return math.inf
                if not math.isnan(b):
                    worst = max(worst, abs(a - b) / (abs(b) if name in RELATIVE else 1.0))
    return worst


def best_of(function: Callable[[], Any], repeats: int = 3) -> float:
    times = []
    for _ in range(repeats):
        start = time.process_time()
        function()
        times.append(1e3 * (time.process_time() - start))
    return min(times)


def main() -> int:
    every = cameras()
    figures(every[:1], 64, True, 48)
    exact, failed = figures(every, 16384, True, 800)[1], 0
    print(f"{'nodes':>6} {'solved':>6} {'point_nodes':>11} {'ms a camera':>11} {'stated':>8} {'largest error':>13}")
    for nodes, solved, points in SETTINGS:
        milliseconds, rows = min((figures(every, nodes, solved, points) for _ in range(3)), key=lambda one: one[0])
        stated = Resolution(nodes=nodes, solved=solved, point_nodes=points).error(None, None, "float64")[0]
        worst = largest_error(rows, exact)
        failed += worst > stated
        print(f"{nodes:>6} {solved!s:>6} {points:>11} {milliseconds:>11.1f} {stated:>8.1e} {worst:>13.1e}")
    fy, fx = sampling.frequencies(768, 1.0, half=False)[:481, None], sampling.frequencies(768, 1.0, half=True)[None]
    radial, wavelength = np.hypot(fy, fx), np.arange(0.41, 0.72, 0.02)[:, None, None]
    alphas, few = silicon.absorption(wavelength.ravel()), np.linspace(0.0, 0.3, 6)
    diode = (1.0, 7.0, 50.0)
    clear = best_of(lambda: diffraction.circular_otf(radial, wavelength, 4.0))
    charge = best_of(lambda: photodiode.collection_mtf_bands(few, alphas, *diode))
    print(f"clear aperture at f/4, 16 bands at 481 x 481 frequencies: {clear:.0f} ms")
    print(f"blur of charge, 16 bands at 6 frequencies: {charge:.2f} ms")
    return failed


if __name__ == "__main__":
    with threadpool_limits(1):
        sys.exit(1 if main() else 0)
