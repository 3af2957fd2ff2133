"""A point, an edge and the composite chart through f/1.4 to f/22 and pixels of 1.1 to 8 um.

    python benchmarks/edges.py [--pictures edges.png] [--light bandlimited|cells]

Table: MTF50 of a slanted edge of 5 degrees as measured on 200 x 400 pixels, noise-free, before the mosaic, against the
analytic one: the photon-weighted transfer function of the chart's rendering, diffraction, diffusion and pixel along the
edge's normal.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

import etendue
from etendue_camera.optics.stages.lens import Diffraction
from etendue_camera.resolution.edges.slanted_edge import slanted_edge
from etendue_camera.sensor.stages.pixel import Diffusion, Pixel

F_NUMBERS = [1.4, 2.8, 5.6, 11.0, 22.0]
PITCHES = [1.1, 2.0, 3.5, 5.4, 8.0]
ROWS, COLUMNS, ANGLE = 200, 400, 5.0
BANDS = {"wavelength_from": 400.0, "wavelength_to": 700.0, "bin_width": 50.0}
MARGIN = 60.0  # in units of wavelength times f-number
QE = [0.4, 0.5, 0.35]


def spacing(pitch: float, f_number: float) -> float:
    """As many samples in a pixel as the optics pass, at most 8: the chart's own rendering is no finer."""
    return pitch / min(max(1, math.ceil(2.2 * pitch / (0.4 * f_number))), 8)


def margin(f_number: float) -> float:
    """Of the chart around the frame, um: beyond it stands its mirror image, not more of the edge."""
    return MARGIN * 0.55 * f_number


def camera(scene: dict[str, Any], pitch: float, f_number: float, rows: int, columns: int) -> dict[str, Any]:
    step = spacing(pitch, f_number)
    size = {"width": 0.0, "height": 0.0, "spacing": step}
    for name, count in (("width", columns), ("height", rows)):
        size[name] = (count + 2 * math.ceil(margin(f_number) / pitch)) * pitch
    return {
        "name": "edges",
        "precision": "float64",
        "camera": {"peak_qe": QE, "pixel_pitch": pitch, "f_number": f_number, "focal_length": 50},
        "stages": [
            {"name": "scene", "white_luminance": 1000, **BANDS, **size, **scene},
            {"use": "irradiance"},
            {"use": "diffraction"},
            {"use": "diffusion"},
            {"use": "pixel", "rows": rows, "columns": columns},
        ],
        "wanted": ["photon_rate", "irradiance.white_irradiance"],
        "keep": ["pixel", "irradiance.white_irradiance"],
    }


def photon_rate(scene: dict[str, Any], pitch: float, f_number: float, rows: int, columns: int) -> tuple[Any, Any]:
    tree = etendue.simulate(camera(scene, pitch, f_number, rows, columns))
    return tree["pixel"].photon_rate.values, tree["irradiance"].white_irradiance.values


def analytic_mtf50(pitch: float, f_number: float, white: Any, channel: int) -> float:
    """Cycles/pixel along the normal."""
    edges = tuple(np.arange(BANDS["wavelength_from"], BANDS["wavelength_to"] + 1, BANDS["bin_width"]))
    wavelength = 0.5e-3 * (np.array(edges[:-1]) + np.array(edges[1:]))[:, None, None]
    pixel = Pixel(pixel_pitch=pitch, peak_qe=tuple(QE))
    prepared = pixel.prepare({"wavelength_edges": np.array(edges), "wavelength": 1e3 * wavelength.ravel()})
    weights = np.asarray(pixel.weights(prepared))[channel] * white
    sigma = spacing(pitch, f_number)
    normal = (math.sin(math.radians(ANGLE)), math.cos(math.radians(ANGLE)))

    def transfer(frequency: float) -> float:
        f = frequency / pitch
        fy, fx = np.full((1, 1), normal[0] * f), np.full((1, 1), normal[1] * f)
        product = Diffraction(f_number=f_number).transfer(fy, fx, wavelength) * Diffusion().transfer(fy, fx, wavelength)
        product = product * pixel.transfer(fy, fx, wavelength, prepared) * math.exp(-2 * (math.pi * sigma * f) ** 2)
        return float((weights @ product[:, 0, 0]) / weights.sum()) - 0.5

    return float(brentq(transfer, 1e-6, min(1.2, 0.999 * pitch / (0.4 * f_number) * 2), xtol=1e-10))


def pictures(path: Path) -> None:
    """Point, edge and chart for every f-number and pitch, green channel, as the pixels have it."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    scenes = {
        "point": ({"use": "points", "pitch": 400.0, "spot_sigma": 0.3, "background": 1e-4}, (21, 21)),
        "edge": ({"use": "slanted_edge", "angle": ANGLE}, (32, 48)),
        "chart": ({"use": "composite"}, (120, 160)),
    }
    figure, axes = pyplot.subplots(
        len(PITCHES) * 3, len(F_NUMBERS), figsize=(2.0 * len(F_NUMBERS), 1.7 * 3 * len(PITCHES))
    )
    for row, pitch in enumerate(PITCHES):
        for number, (name, (scene, (rows, columns))) in enumerate(scenes.items()):
            for column, f_number in enumerate(F_NUMBERS):
                given = dict(scene)
                if name == "point":
                    given["pitch"] = 4 * 21 * pitch
                if name == "chart":  # the frame holds the whole chart
                    given["margin"] = math.ceil(margin(f_number) / pitch) * pitch
                green = photon_rate(given, pitch, f_number, rows, columns)[0][1]
                axis = axes[row * 3 + number, column]
                axis.imshow(green, cmap="gray", vmin=0, vmax=np.quantile(green, 0.999), interpolation="nearest")
                axis.set_xticks([])
                axis.set_yticks([])
                axis.set_title(f"{name} f/{f_number:g} {pitch:g} um", fontsize=7)
    figure.tight_layout(pad=0.3)
    figure.savefig(path, dpi=70)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    if asked.pictures:
        pictures(asked.pictures)
        return 0
    print("MTF50 of the green channel, cycles/pixel: measured / analytic - 1 in per cent (bound 0.5)")
    print(f"{'pitch um':>9s}" + "".join(f"{f'f/{n:g}':>24s}" for n in F_NUMBERS))
    worst = 0.0
    for pitch in PITCHES:
        line = f"{pitch:9.1f}"
        for f_number in F_NUMBERS:
            rate, white = photon_rate({"use": "slanted_edge", "angle": ANGLE}, pitch, f_number, ROWS, COLUMNS)
            measured = slanted_edge(rate[1]).mtf50
            truth = analytic_mtf50(pitch, f_number, white, 1)
            apart = 100 * (measured / truth - 1)
            worst = max(worst, abs(apart))
            line += f"{measured:9.4f} {truth:7.4f} {apart:+6.3f}"
        print(line, flush=True)
    print(f"largest: {worst:.3f} % of 0.5 %")
    return int(not worst <= 0.5)


if __name__ == "__main__":
    sys.exit(main())
