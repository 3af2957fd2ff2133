"""The two light models: flux and sign of a point, undershoot, pixels, edges, dark light beside highlights; error
against time.

    python benchmarks/light_models.py

Prints claim | bound | measured. In `cells` a value is the mean over a grid cell, in `bandlimited` a sample.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.special import ndtr

import etendue
from etendue.transfer import cell_pixels, cells
from etendue_camera.optics import diffraction, lens
from etendue_camera.optics.undershoot import undershoot
from etendue_camera.sensor import photodiode, silicon

NUMBERS = (1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 22.0, 64.0)
SPACINGS = (0.3, 0.7, 1.0, 2.0, 2.64, 4.0, 5.3, 6.0)
PAPER_PIXEL = 0.898608540025  # of an Airy pattern's energy: 5.4 um, f/2.8, 0.55 um

Otf = Callable[[Any, Any], Any]


def airy(wavelength: float, number: float) -> Otf:
    return lambda fy, fx: diffraction.circular_otf(np.hypot(fy, fx), wavelength, number)


def silicon_at(wavelength: float) -> Otf:
    alpha = float(silicon.absorption(np.array(wavelength)))
    return lambda fy, fx: photodiode.collection_mtf(np.hypot(fy, fx), alpha, 1.8, 10.0, 50.0)


def row(claim: str, bound: str, measured: str) -> None:
    print(f"{claim:<88} | {bound:>10} | {measured}")


def point_in_cells(otf: Otf, spacing: float, size: int = 160) -> Any:
    axis = cells.PeriodicAxis(size, spacing)
    table = cells.folded(
        otf, cells.reach_of(otf, spacing), axis, axis, cells.mean_rule(axis, False), cells.mean_rule(axis, True)
    )
    return cells.planes_of(table + 0j, axis, axis)


def point_in_samples(otf: Otf, spacing: float, size: int = 160) -> Any:
    f = np.fft.fftfreq(size, spacing)[:, None], np.fft.rfftfreq(size, spacing)[None, :]
    return np.fft.irfft2(otf(*f), s=(size, size))


def points() -> None:
    flux, lowest = 0.0, 0.0
    for number in NUMBERS:
        for spacing in SPACINGS:
            found = point_in_cells(airy(0.55, number), spacing)
            flux, lowest = max(flux, abs(found.sum() - 1)), min(lowest, found.min())
    row(f"cells: flux of a point, f/1.4 to f/64, {SPACINGS[0]} to {SPACINGS[-1]} um, 550 nm", "1e-6", f"{flux:.1e}")
    row("cells: most negative value of the same, over the light of the point", "rounding", f"{lowest:.1e}")
    for spacing in (2.64, 5.3):
        samples, means = point_in_samples(airy(0.55, 4.0), spacing), point_in_cells(airy(0.55, 4.0), spacing)
        made = np.abs(samples).sum() - 1
        row(f"f/4, 550 nm, {spacing} um: light made by the modulus of a cut transform", "0", f"{made:+.1%}")
        row(f"f/4, 550 nm, {spacing} um: light made in cells", "1e-6", f"{means.sum() - 1:+.1e}")
    worst = 0.0
    for number in (1.4, 2.8, 8.0):
        for spacing in (0.3, 1.0, 2.64, 6.0):
            samples = point_in_samples(airy(0.55, number), spacing, 256)
            bound = undershoot(0.5 / spacing * 0.55 * number)[0]
            measured = max(-samples.min(), 0) / samples.max()
            worst = max(worst, measured / bound if bound else 0.0)
            if bound:
                row(
                    f"bandlimited: undershoot of a point, f/{number:g}, {spacing:g} um, share of its peak",
                    f"{bound:.3%}",
                    f"{measured:.3%}",
                )
    row("bandlimited: largest of these over its bound", "1.005", f"{worst:.4f}")


def pixels() -> None:
    found, parts = [], np.array([9, 15, 25])
    for count in parts:
        size, spacing = 41 * int(count), 5.4 / count
        axis = cells.PeriodicAxis(size, spacing)
        rules = [cells.window_rule(axis, 5.4, 0.0, half) for half in (False, True)]
        otf = airy(0.55, 2.8)
        table = cells.folded(otf, cells.reach_of(otf, spacing), axis, axis, *rules)
        found.append(float(cells.planes_of(table + 0j, axis, axis)[0, 0]) * count**2)
    limit = np.linalg.solve(np.stack([parts**0.0, parts**-2.0, parts**-4.0], axis=1), found)[0]
    row(
        "cells: energy of an Airy pattern on the paper's pixel, limit of small cells",
        "5e-6",
        f"{abs(limit - PAPER_PIXEL):.1e}",
    )
    row(
        "  with 9, 15, 25 cells to a pixel (the source is a cell; error as its area)",
        "order 2",
        ", ".join(f"{v - PAPER_PIXEL:.1e}" for v in found),
    )
    rng, worst = np.random.default_rng(0), 0.0
    for otf in (airy(0.55, 2.8), silicon_at(0.65), lambda fy, fx: lens.gaussian_otf(fy, fx, 0.8)):
        y, x = cells.PeriodicAxis(60, 2.0), cells.PeriodicAxis(64, 2.0)
        half, reach = np.fft.rfft2(rng.uniform(0, 1, (60, 64))), cells.reach_of(otf, 2.0)
        rules = [cells.window_rule(y, 2.9, 0.3, False), cells.window_rule(x, 2.9, -0.4, True)]
        first = cells.planes_of(half * cells.folded(otf, reach, y, x, *rules), y, x)
        at = np.arange(60) + 0.3, np.arange(64) - 0.4
        second = cell_pixels.evaluated([otf], [reach], np.ones((1, 1)), half[None], y, x, at, (2.9, 2.9))[0]
        worst = max(worst, np.abs(second - first).max())
    row("cells: folding against the extended transform, at any offset", "1e-13", f"{worst:.1e}")
    for spacing in (1.0, 2.0, 5.0):
        otf, axis = silicon_at(0.65), cells.PeriodicAxis(24, spacing)
        rules = [cells.mean_rule(axis, False), cells.mean_rule(axis, True)]
        reach = cells.reach_of(otf, spacing)
        far = 4 * reach.radius
        rest = float(np.ravel(otf(np.array([[2 * far]]), np.zeros((1, 1))))[0])
        more = cells.folded(otf, reach._replace(radius=far, rest=rest), axis, axis, *rules)
        kept = cells.folded(otf, reach, axis, axis, *rules)
        row(
            f"cells: aliases left out of diffusion alone (no lens), {spacing:g} um",
            "1e-5",
            f"{np.abs(kept - more).max():.1e}",
        )


def simulate(chart: dict[str, Any], *stages: dict[str, Any], camera: dict[str, Any] | None = None, **more: Any) -> Any:
    bands = {"wavelength_from": 540, "wavelength_to": 560, "bin_width": 20}
    document = {"name": "light", "camera": {"peak_qe": [1, 1, 1], **(camera or {})}, **more}
    document["stages"] = [{"name": "scene", "white_luminance": 100, **bands, **chart}, {"use": "irradiance"}, *stages]
    return etendue.simulate(document)


def highlights() -> None:
    spacing, sigma = 1.0, 2.0
    x = np.arange(512) - 255.5

    def ramp(t: Any) -> Any:
        return t * ndtr(t / sigma) + sigma * np.exp(-0.5 * (t / sigma) ** 2) / np.sqrt(2 * np.pi)

    near = np.clip(x, -40, 40)
    shares = {"bandlimited": ndtr(x / np.hypot(sigma, 2.0)), "cells": ramp(near + 0.5) - ramp(near - 0.5)}
    for light, share in shares.items():
        for contrast in (1e5, 1e8):
            wrong = {}
            for precision in ("auto", "float32"):
                chart = {
                    "use": "slanted_edge",
                    "angle": 0,
                    "low": 1 / contrast,
                    "high": 1.0,
                    "softness": 2.0 if light == "bandlimited" else 0.0,
                    "light": light,
                    "spacing": spacing,
                    "width": 512,
                    "height": 512,
                }
                tree = simulate(chart, {"use": "lens_gaussian", "sigma": sigma}, precision=precision)
                found = (
                    tree["lens_gaussian"].irradiance.values[0, 256].astype(float)
                    / tree["irradiance"].irradiance.values[0, 256, -40]
                )
                truth = 1 / contrast + (1 - 1 / contrast) * share
                wrong[precision] = float(np.abs(found[30:-30] / truth[30:-30] - 1).max())
            row(
                f"{light}: darkest light beside a half plane {contrast:.0e} times brighter, as planned",
                "1e-4",
                f"{wrong['auto']:.1e}",
            )
            row("  the same forced to float32", "fails", f"{wrong['float32']:.1e}")


def edges() -> None:
    f = (np.arange(200000) + 0.5) * 1e-5
    otf = diffraction.circular_otf(f, 0.55, 4.0) * silicon_at(0.55)(0 * f, f)
    for pitch, how in ((2.7, "3 cells"), (2.5, "2.78 cells")):
        chart = {
            "use": "slanted_edge",
            "angle": 0,
            "softness": 0,
            "light": "cells",
            "spacing": 0.9,
            "width": 720,
            "height": 36,
        }
        camera = {"f_number": 4.0, "pixel_pitch": pitch}
        tree = simulate(
            chart,
            {"use": "diffraction"},
            {"use": "diffusion"},
            {"use": "pixel", "rows": 4, "columns": 40},
            camera=camera,
            precision="float64",
        )
        rate = tree["pixel"].photon_rate.values[1, 2]
        x = (np.arange(40) - 19.5) * pitch
        whole = otf * photodiode.aperture_otf(f, pitch * 0.741)
        profile = 0.5 + np.array([np.sum(np.sin(2 * np.pi * f * p) * whole / (np.pi * f)) * 1e-5 for p in x])
        wrong = np.abs((rate / np.mean(rate + rate[::-1]) - 0.1) / 0.8 - profile).max()
        # behind the borders, 360 um away, stands a mirror image: 2 lambda N/(pi^2 360) of the step, 1.2e-3
        row(f"cells: a hard edge on pixels of {pitch} um ({how}) against the exact integral", "1.5e-3", f"{wrong:.1e}")


def times() -> None:
    print()
    print(
        "tables of 256 x 256 cells and 31 bands from 400 to 700 nm, in seconds on one thread; kept for all cells of a "
        "sweep"
    )
    print(f"{'':10}" + "".join(f"{spacing:>9} um" for spacing in (1.0, 2.0, 3.5, 5.0)))
    for number in (1.4, 2.8, 5.6):
        took = []
        for spacing in (1.0, 2.0, 3.5, 5.0):
            axis = cells.PeriodicAxis(320, spacing)
            began = time.perf_counter()
            for wavelength in np.linspace(0.4, 0.7, 31):
                otf = airy(float(wavelength), number)
                rules = [cells.mean_rule(axis, half) for half in (False, True)]
                cells.folded(otf, cells.reach_of(otf, spacing), axis, axis, *rules)
            took.append(time.perf_counter() - began)
        print(f"f/{number:<8}" + "".join(f"{t:12.2f}" for t in took))


if __name__ == "__main__":
    print(f"{'claim':<88} | {'bound':>10} | measured")
    points()
    pixels()
    edges()
    highlights()
    times()
