"""How often the 95 % intervals of ``etendue measure`` hold the MTF50 of one slanted edge, by sharpness, file and noise.

    python benchmarks/measure_coverage.py              # 200 draws a cell: about half an hour of one core
    python benchmarks/measure_coverage.py --draws 60 --files "JPEG 75" --sigmas 0.5

Each draw has an edge of its own: blurred by a Gaussian of so many pixels rms, 3 to 15 degrees from rows or columns, at
any place of pixel and block, of other levels; white noise (of full scale) in linear light, sRGB, written as a file and
measured as the command does. For each cell: share of intervals that hold the truth, mean error and median half width in
% of MTF50, and how many draws the command itself calls not covered, or conservative (an upper bound, where nothing is
noise). Cells outside 93 to 97 % are marked, as far as 200 draws can tell (90 to 98.5 %); exit code 1 where one is
without the command saying so.
"""

import argparse
import math
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import scipy
import tifffile
from PIL import Image

from etendue.errors import RequestError
from etendue_camera.colour.encoding import srgb_encode
from etendue_lab.measure.study import MeasurementRequest, measure

FIFTY = math.sqrt(math.log(2) / 2) / math.pi  # MTF50 of a Gaussian of 1 pixel rms
SIGMAS, NOISES = (0.35, 0.5, 0.7, 1.0, 2.0), (0.0, 0.005, 0.02)
FILES = ("16 bits", "8 bits", "JPEG 100", "JPEG 95", "JPEG 85", "JPEG 75")
SIDE = 80


def edge(rng: np.random.Generator, sigma: float, noise: float) -> np.ndarray:
    y, x = (np.arange(SIDE) - 0.5 * SIDE - rng.uniform(-4, 4) for _ in range(2))
    turn = math.radians(rng.uniform(3, 15)) * rng.choice([-1, 1])
    distance = rng.choice([-1, 1]) * (x * math.cos(turn) - y[:, None] * math.sin(turn))
    low, high = rng.uniform(0.05, 0.15), rng.uniform(0.5, 0.8)
    picture = low + (high - low) * scipy.special.ndtr(distance / sigma) + rng.normal(0, noise, (SIDE, SIDE))
    return picture if rng.uniform() < 0.5 else picture.T


def written(folder: Path, file: str, linear: np.ndarray) -> Path:
    encoded = srgb_encode(np.clip(linear, 0, 1))
    if file == "16 bits":
        tifffile.imwrite(folder / "a.tif", np.rint(65535 * encoded).astype(np.uint16))
        return folder / "a.tif"
    path = folder / ("a.png" if file == "8 bits" else "a.jpg")
    quality = {"quality": int(file.split()[1])} if path.suffix == ".jpg" else {}
    Image.fromarray(np.rint(255 * encoded).astype(np.uint8)).save(path, **quality)
    return path


def cell(folder: Path, file: str, sigma: float, noise: float, draws: int, seed: int = 0) -> tuple[str, float, str]:
    """A line, the share of intervals that hold the truth, and what the command says of most of them or, in brackets,
    what it should.
    """
    truth, held, errors, wide, doubtful, bounds, refused = FIFTY / sigma, 0, [], [], 0, 0, 0
    for draw in range(draws):
        rng = np.random.default_rng([draw, round(1000 * sigma), round(1e4 * noise), *([seed] if seed else [])])
        try:
            one = measure(
                written(folder, file, edge(rng, sigma, noise)), MeasurementRequest(edges=(f"0,0,{SIDE},{SIDE}",))
            )["edges"][0]
        except RequestError:
            refused += 1
            continue
        held += one["mtf50_low"] <= truth <= one["mtf50_high"]
        errors.append(one["mtf50"] / truth - 1 if math.isfinite(one["mtf50"]) else math.nan)
        wide.append((one["mtf50_high"] - one["mtf50_low"]) / 2 / truth)
        doubtful += bool(one["not_covered"])
        bounds += one["conservative"]
    count = max(len(errors), 1)
    share = held / count
    error = 1.96 * math.sqrt(0.95 * 0.05 / count) + 0.02  # what so many draws leave open about 93 to 97 %
    said = "not covered" if doubtful > 0.5 * count else "conservative" if bounds > 0.5 * count else ""
    mark = said or ("(below)" if share < 0.95 - error else "(above)" if share > 0.95 + error else "")
    told = f"{100 * doubtful / count:4.0f} %" if doubtful else "     -"
    text = (
        f"  {file:8}  {sigma:5.2f}  {noise:6.3f}  {100 * share:6.1f} %  {100 * np.nanmean(errors or [math.nan]):+6.2f} "
        f"%"
        f"  {100 * np.median(wide or [math.nan]):6.2f} %  {told}  {f'{refused} refused ' if refused else ''}{mark}"
    )
    return text.rstrip(), share, mark


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--files", nargs="+", default=FILES)
    parser.add_argument("--sigmas", nargs="+", type=float, default=SIGMAS)
    parser.add_argument("--noises", nargs="+", type=float, default=NOISES)
    parser.add_argument("--seed", type=int, default=0, help="other edges")
    asked = parser.parse_args()
    began, shares, bad = time.process_time(), [], 0
    print(f"{asked.draws} edges a cell, {SIDE} x {SIDE} pixels")
    print("  file      sigma   noise      held      bias      half   not covered")
    with tempfile.TemporaryDirectory() as folder:
        for file in asked.files:
            for sigma in asked.sigmas:
                for noise in asked.noises:
                    text, share, mark = cell(Path(folder), file, sigma, noise, asked.draws, asked.seed)
                    shares += [share] if mark in ("", "(below)", "(above)") else []
                    bad += mark in ("(below)", "(above)")
                    print(text, flush=True)
    few, many = sum(share < 0.93 for share in shares), sum(share > 0.97 for share in shares)
    whole = len(asked.files) * len(asked.sigmas) * len(asked.noises)
    print(
        f"of {whole} cells below 93 %: {few}, in 93 to 97 %: {len(shares) - few - many}, above: {many}, not covered or "
        f"conservative: "
        f"{whole - len(shares)}"
    )
    mean = 100 * sum(shares) / max(len(shares), 1)
    print(f"outside the range that this number of draws allows: {bad}; mean {mean:.1f} %")
    print(f"{time.process_time() - began:.0f} s", file=sys.stderr)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
