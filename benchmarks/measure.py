"""How often the intervals of ``etendue measure`` hold the truth, over photographs whose MTF, noise and colours are
known.

    python benchmarks/measure.py            # 400 seeds, 100 where edges are looked for: some minutes
    python benchmarks/measure.py --seeds 50

Edges and stars are blurred by a Gaussian in closed form, noise is added in linear light, and the picture is written as
files are: sRGB of 8 and of 16 bits (of JPEG: measure_coverage.py). Noise is white, or averaged over 3 x 3 pixels as a
demosaicer does.
"""

import argparse
import math
import tempfile
from pathlib import Path

import numpy as np
import scipy
import tifffile
from PIL import Image

from etendue.errors import RequestError
from etendue_camera.colour.encoding import srgb_encode
from etendue_camera.quality.patch_noise import patch_noise
from etendue_camera.resolution.star_interval import star_resolution
from etendue_lab.measure.study import MeasurementRequest, measure

FIFTY = math.sqrt(math.log(2) / 2) / math.pi  # MTF50 of a Gaussian of 1 pixel rms
SIGMA = 1.0


def slanted(angle: float, shape: tuple[int, int] = (120, 120)) -> np.ndarray:
    y, x = (np.arange(n) - 0.5 * (n - 1) for n in shape)
    turn = math.radians(angle)
    distance = x * math.cos(turn) - y[:, None] * math.sin(turn)
    return 0.1 + 0.6 * scipy.special.ndtr(distance / SIGMA)


def star(cycles: int = 72, shape: tuple[int, int] = (260, 264), sigma: float = SIGMA) -> np.ndarray:
    y, x = np.arange(shape[0])[:, None] - 130.3, np.arange(shape[1]) - 131.8
    z = (y**2 + x**2) / (4 * sigma**2)
    held = np.sqrt(np.pi * z / 2) * (scipy.special.ive((cycles - 1) / 2, z) + scipy.special.ive((cycles + 1) / 2, z))
    return 0.4 * (1 + 0.8 * held * np.cos(cycles * np.arctan2(y, x)))


def written(folder: Path, kind: str, linear: np.ndarray) -> Path:
    encoded = srgb_encode(np.clip(linear, 0, 1))
    if kind == "TIFF, 16 bits":
        tifffile.imwrite(folder / "a.tif", np.rint(65535 * encoded).astype(np.uint16))
        return folder / "a.tif"
    Image.fromarray(np.rint(255 * encoded).astype(np.uint8)).save(folder / "a.png")
    return folder / "a.png"


def said(held: int, found: list[float]) -> str:
    return f"{100 * held / len(found):5.1f} %, {100 * np.mean(found):+.2f} %, {100 * np.std(found):.2f} %"


def edges(seeds: int) -> None:
    truth = FIFTY / SIGMA
    print("slanted edge, 120 x 120 pixels, 5 degrees: intervals that hold the truth, mean error and spread of MTF50")
    for kind in ("PNG, 8 bits", "TIFF, 16 bits"):  # of JPEG: measure_coverage.py
        for noise in (0.0, 0.002, 0.01):
            held, found = 0, []
            with tempfile.TemporaryDirectory() as folder:
                for seed in range(seeds):
                    rng = np.random.default_rng(seed)
                    picture = rng.uniform(0.95, 1.05) * slanted(5.0) + rng.normal(
                        0, noise, (120, 120)
                    )  # rounded elsewhere in each
                    one = measure(written(Path(folder), kind, picture), MeasurementRequest(edges=("0,0,120,120",)))[
                        "edges"
                    ][0]
                    held += one["mtf50_low"] <= truth <= one["mtf50_high"]
                    found.append(one["mtf50"] / truth - 1)
            print(
                f"  {kind:14} noise {noise:5.3f}: {100 * held / seeds:5.1f} %, {100 * np.mean(found):+.2f} %, "
                f"{100 * np.std(found):.2f} %"
            )


def squares(side: float, shape: tuple[int, int] = (240, 300)) -> np.ndarray:
    """A light square with a dark one of half its side in it, turned by 5 degrees, beside bars along the raster."""
    y, x = np.arange(shape[0])[:, None] - 118.3, np.arange(shape[1]) - 170.8
    turn = math.radians(5.0)
    u, v = x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn)

    def box(half: float) -> np.ndarray:
        parts = [
            scipy.special.ndtr((part + half) / SIGMA) - scipy.special.ndtr((part - half) / SIGMA) for part in (u, v)
        ]
        return parts[0] * parts[1]

    picture = 0.3 + 0.5 * box(0.5 * side) - 0.7 * box(0.25 * side)
    bars = scipy.ndimage.gaussian_filter1d(
        np.where((np.arange(60) // 10 % 2)[None, :], 0.8, 0.05).repeat(shape[0], 0), SIGMA, axis=1
    )
    picture[:, :60] = bars
    return picture


def found_edges(seeds: int) -> None:
    truth = FIFTY / SIGMA
    print(
        "edges found automatically, 240 x 300 pixels, squares turned by 5 degrees: found, truth held, mean error and "
        "spread of MTF50"
    )
    for side in (60, 90, 150):
        for noise in (0.004, 0.02):
            held, found, none = 0, [], 0
            with tempfile.TemporaryDirectory() as folder:
                for seed in range(seeds):
                    picture = squares(side) + np.random.default_rng(seed).normal(0, noise, (240, 300))
                    try:
                        one = measure(written(Path(folder), "TIFF, 16 bits", picture), MeasurementRequest())["edges"][0]
                    except RequestError:
                        none += 1
                        continue
                    held += one["mtf50_low"] <= truth <= one["mtf50_high"]
                    found.append(one["mtf50"] / truth - 1)
            print(
                f"  side {side:4}, noise {noise:5.3f}: {100 - 100 * none / seeds:5.1f} %, "
                f"{said(held, found) if found else '-'}"
            )


def stars(seeds: int) -> None:
    truth, clean = FIFTY / SIGMA, star()
    print("Siemens star of 72 cycles, 125 pixels radius")
    for noise in (0.005, 0.02):
        for contrast in (0.8, None):
            held, found = 0, []
            for seed in range(seeds):
                picture = clean + np.random.default_rng(seed).normal(0, noise, clean.shape)
                one = star_resolution(picture, (130.0, 132.0), 125.0, contrast=contrast)
                held += one.mtf50_low <= truth <= one.mtf50_high
                found.append(one.response.mtf50 / truth - 1)
            print(f"  contrast {'given' if contrast else 'found'}, noise {noise:5.3f}: {said(held, found)}")


def noise(seeds: int) -> None:
    print("noise of a patch with a slope of 10 %: intervals of sigma and of SNR that hold the truth")
    for side in (32, 64, 128):
        slope = 1 + 0.1 * np.linspace(-0.5, 0.5, side)
        for kind in ("white", "over 3 x 3"):
            held = [0, 0]
            sigma = 0.01 if kind == "white" else 0.01 / 3
            for seed in range(seeds):
                drawn = np.random.default_rng(seed).normal(0, 0.01, (side + 2, side + 2))
                own = drawn[1:-1, 1:-1] if kind == "white" else scipy.ndimage.uniform_filter(drawn, 3)[1:-1, 1:-1]
                one = patch_noise(0.4 * slope + own)
                held[0] += one.sigma.low <= sigma <= one.sigma.high
                held[1] += one.snr.low <= 0.4 / sigma <= one.snr.high
            print(f"  {side:4} x {side}, {kind:10}: {100 * held[0] / seeds:5.1f} %, {100 * held[1] / seeds:5.1f} %")


def rounded_noise(seeds: int) -> None:
    print(
        "noise of a uniform patch of any level, 8 bits, 64 x 64: intervals that hold the truth, patches whose noise "
        "is reported as hidden"
    )
    with tempfile.TemporaryDirectory() as folder:
        for sigma in (0.001, 0.003, 0.006):
            held = hidden = 0
            for seed in range(seeds):
                rng = np.random.default_rng([seed, round(1e4 * sigma)])
                picture = rng.uniform(0.1, 0.7) + rng.normal(0, sigma, (64, 64))
                one = measure(written(Path(folder), "PNG, 8 bits", picture), MeasurementRequest(noise=("0,0,64,64",)))[
                    "noise"
                ][0]
                found = one["channels"][0]["linear"]["sigma"]
                held += found["low"] <= sigma <= found["high"]
                hidden += bool(one["hidden"])
            print(f"  sigma {sigma:5.3f}: {100 * held / seeds:5.1f} %, {100 * hidden / seeds:5.1f} %")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=400)
    count = parser.parse_args().seeds
    noise(count)
    rounded_noise(count)
    stars(count)
    edges(count)
    found_edges(max(count // 4, 1))
