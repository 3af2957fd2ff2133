"""Twenty straight edges and twenty things that are none: what ``etendue measure`` takes, refuses and doubts.

    python benchmarks/measure_others.py            # some seconds
    python benchmarks/measure_others.py --draws 5  # of each, with other seeds

Each is measured in a region that is given (the whole picture) and without one. An edge should be measured without a
doubt of what it is, anything else refused or said to be doubtful; of a corner, or of two edges, one side that is found
by itself is an edge where its interval holds the truth. Exit code 1 where fewer than 19 of 20 are, in the region.
"""

import argparse
import math
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy
from PIL import Image, ImageDraw, ImageFont

from etendue.errors import RequestError
from etendue_camera.colour.encoding import srgb_encode
from etendue_lab.measure.study import MeasurementRequest, measure

SIDE, FINER = 112, 4
FIFTY = math.sqrt(math.log(2) / 2) / math.pi  # MTF50 of a Gaussian of 1 pixel rms
Picture = Callable[[np.random.Generator], np.ndarray]


def blurred(picture: np.ndarray, sigma: float) -> np.ndarray:
    return scipy.ndimage.gaussian_filter(picture, sigma, mode="nearest")


def away(rng: np.random.Generator, degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances of pixels from a line through the middle, and along it."""
    y, x = (np.arange(SIDE) - 0.5 * SIDE - rng.uniform(-5, 5) for _ in range(2))
    turn = math.radians(degrees)
    return x * math.cos(turn) - y[:, None] * math.sin(turn), x * math.sin(turn) + y[:, None] * math.cos(turn)


def edge(degrees: float, sigma: float, noise: float, **other: float) -> Picture:
    """A Gaussian edge; or one that is bent, sharpened, shaded, faint, or whose noise hangs together."""

    def drawn(rng: np.random.Generator) -> np.ndarray:
        across, along = away(rng, degrees)
        across = across + other.get("bend", 0.0) * (2 * along / SIDE) ** 2
        shape = scipy.special.ndtr(across / sigma)
        if halo := other.get("halo", 0.0):
            shape = shape + halo * (shape - blurred(shape, 2.0))
        low, high = 0.5 - 0.5 * other.get("step", 0.6), 0.5 + 0.5 * other.get("step", 0.6)
        picture = (low + (high - low) * shape) * (1 + other.get("shade", 0.0) * along / SIDE)
        grain = rng.normal(0, noise, (SIDE, SIDE))
        return 0.9 * picture + (scipy.ndimage.uniform_filter(grain, 3) if other.get("coarse") else grain)

    return drawn


def text(words: str, size: int, sigma: float, degrees: float) -> Picture:
    def drawn(rng: np.random.Generator) -> np.ndarray:
        page = Image.new("L", (SIDE * FINER, SIDE * FINER), 217)
        ImageDraw.Draw(page).text((10 * FINER, 30 * FINER), words, fill=25, font=ImageFont.load_default(size * FINER))
        own = np.asarray(page.rotate(degrees, Image.Resampling.BICUBIC, fillcolor=217), float) / 255
        small = blurred(own, FINER * sigma).reshape(SIDE, FINER, SIDE, FINER).mean((1, 3))
        return small + rng.normal(0, 0.004, small.shape)

    return drawn


def stroke(width: float, sigma: float, degrees: float, wave: float = 0.0) -> Picture:
    def drawn(rng: np.random.Generator) -> np.ndarray:
        across, along = away(rng, degrees)
        across = across + wave * np.sin(along / 17 + rng.uniform(0, 6))
        line = scipy.special.ndtr((across + width / 2) / sigma) - scipy.special.ndtr((across - width / 2) / sigma)
        return 0.8 - 0.7 * line + rng.normal(0, 0.004, line.shape)

    return drawn


def fur(degrees: float, sigma: float) -> Picture:
    """Hairs of one direction over a light and a dark field, out of focus."""

    def drawn(rng: np.random.Generator) -> np.ndarray:
        across, along = away(rng, degrees)
        grain = scipy.ndimage.gaussian_filter(rng.normal(size=(4 * SIDE, 4 * SIDE)), (14, 1.2))
        place = [np.clip(part + 2 * SIDE, 0, 4 * SIDE - 1) for part in (along, across)]
        hair = scipy.ndimage.map_coordinates(grain / grain.std(), place, order=1)
        ragged = across + 3.0 * scipy.ndimage.gaussian_filter1d(rng.normal(size=SIDE), 2)[:, None] * 2
        return np.clip(
            blurred(0.35 + 0.3 * scipy.special.ndtr(ragged / 2) + 0.07 * hair, sigma)
            + rng.normal(0, 0.004, (SIDE, SIDE)),
            0,
            1,
        )

    return drawn


def leaves(sigma: float, count: int) -> Picture:
    def drawn(rng: np.random.Generator) -> np.ndarray:
        page = Image.new("L", (SIDE * FINER, SIDE * FINER), 60)
        draw = ImageDraw.Draw(page)
        for _ in range(count):
            x, y, turn, length = *rng.uniform(0, SIDE * FINER, 2), rng.uniform(0, 6.3), rng.uniform(15, 45) * FINER
            t = np.linspace(0, 2 * math.pi, 40)
            u, v = length * np.cos(t), 0.3 * length * np.sin(t) * np.abs(np.sin(t))
            points = zip(
                x + u * math.cos(turn) - v * math.sin(turn), y + u * math.sin(turn) + v * math.cos(turn), strict=True
            )
            draw.polygon([(float(a), float(b)) for a, b in points], fill=int(rng.uniform(40, 230)))
        small = blurred(np.asarray(page, float) / 255, FINER * sigma).reshape(SIDE, FINER, SIDE, FINER).mean((1, 3))
        return small + rng.normal(0, 0.004, small.shape)

    return drawn


def disc(radius: float, sigma: float) -> Picture:
    def drawn(rng: np.random.Generator) -> np.ndarray:
        y, x = np.arange(SIDE)[:, None] - rng.uniform(40, 70), np.arange(SIDE) - 60 + radius
        return 0.2 + 0.5 * scipy.special.ndtr((np.hypot(x, y) - radius) / sigma) + rng.normal(0, 0.004, (SIDE, SIDE))

    return drawn


def corner(degrees: float, sigma: float) -> Picture:
    def drawn(rng: np.random.Generator) -> np.ndarray:
        across, along = away(rng, degrees)
        return (
            0.2
            + 0.5 * scipy.special.ndtr(across / sigma) * scipy.special.ndtr(along / sigma)
            + rng.normal(0, 0.004, (SIDE, SIDE))
        )

    return drawn


def ramp(degrees: float, width: float) -> Picture:
    def drawn(rng: np.random.Generator) -> np.ndarray:
        return 0.2 + 0.5 * np.clip(away(rng, degrees)[0] / width + 0.5, 0, 1) + rng.normal(0, 0.004, (SIDE, SIDE))

    return drawn


def two(apart: float, second: float, sigma: float) -> Picture:
    """A second edge beside the first: the same way up, or down again."""

    def drawn(rng: np.random.Generator) -> np.ndarray:
        across, _ = away(rng, 6.0)
        shape = scipy.special.ndtr(across / sigma) + second * scipy.special.ndtr((across - apart) / sigma)
        return 0.2 + 0.35 * shape + rng.normal(0, 0.004, (SIDE, SIDE))

    return drawn


def texture(size: float, step: float) -> Picture:
    def drawn(rng: np.random.Generator) -> np.ndarray:
        grain = scipy.ndimage.gaussian_filter(rng.normal(size=(SIDE, SIDE)), size)
        return np.clip(0.4 + step * scipy.special.ndtr(away(rng, 5.0)[0]) + 0.12 * grain / grain.std(), 0.02, 0.98)

    return drawn


EDGES: dict[str, Picture] = {
    f"{degrees:g} degrees, {sigma:g} pixels, noise {noise:g}": edge(degrees, sigma, noise)
    for degrees, sigma, noise in (
        (5, 1, 0.004),
        (3, 0.5, 0.002),
        (8, 0.4, 0.01),
        (12, 2, 0.004),
        (20, 0.8, 0.01),
        (30, 1.2, 0.004),
        (40, 1, 0.01),
        (-5, 1.5, 0.02),
        (-15, 0.7, 0.0),
        (85, 1, 0.004),
        (95, 0.6, 0.004),
        (5, 3, 0.004),
        (10, 1, 0.03),
    )
} | {
    "bent by 1 pixel": edge(6, 1, 0.004, bend=1.0),
    "bent by 2 pixels": edge(6, 1, 0.004, bend=2.0),
    "sharpened": edge(7, 0.8, 0.004, halo=0.5),
    "sharpened much": edge(7, 0.8, 0.004, halo=1.0),
    "light that falls off": edge(5, 1, 0.004, shade=0.15),
    "faint": edge(5, 1, 0.004, step=0.12),
    "coarse grain": edge(5, 1, 0.03, coarse=1),
}
OTHERS: dict[str, Picture] = {
    "text": text("etendue\nll1 AWI", 26, 0.6, 4),
    "text, large": text("I/l", 70, 0.8, -6),
    "pen stroke": stroke(5, 1.0, 7),
    "pen stroke, by hand": stroke(7, 0.8, 10, 1.5),
    "fur": fur(8, 1.5),
    "fur, out of focus": fur(12, 3.0),
    "leaves": leaves(0.7, 60),
    "leaves, a few": leaves(1.2, 14),
    "thin line": stroke(1.2, 0.7, 5),
    "thick line": stroke(12, 0.8, 6),
    "disc": disc(60, 0.8),
    "disc, large": disc(150, 1.0),
    "corner": corner(8, 0.8),
    "corner, blurred": corner(-12, 2.0),
    "ramp": ramp(6, 90),
    "ramp, short": ramp(9, 45),
    "steps close together": two(6, 0.6, 0.8),
    "edges up and down": two(14, -0.6, 1.0),
    "texture": texture(1.5, 0.0),
    "texture with a step": texture(2.5, 0.3),
}


SIDES = {
    "corner": 0.8,
    "corner, blurred": 2.0,
    "edges up and down": 1.0,
}  # sigma of the straight edges in what is none as a whole


def answer(path: Path, region: bool, side: float) -> str:
    """Empty where it is measured without a doubt of what it is; else why not. A side that is found, and measured as
    it is, is an edge.
    """
    try:
        one = measure(path, MeasurementRequest(edges=(f"0,0,{SIDE},{SIDE}",) if region else ()))["edges"][0]
    except RequestError as error:
        return "refused: " + str(error).partition(": ")[2][:90]
    if side and not region and not one["doubts"] and one["mtf50_low"] <= FIFTY / side <= one["mtf50_high"]:
        return "one side of it, whose MTF50 the interval holds"
    return ", ".join(one["doubts"])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--all", action="store_true", help="what is said of each")
    asked = parser.parse_args()
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for what, pictures, wanted in (("edges", EDGES, ""), ("others", OTHERS, "doubt")):
            right = [0, 0]
            for name, picture in pictures.items():
                for draw in range(asked.draws):
                    encoded = np.rint(255 * srgb_encode(np.clip(picture(np.random.default_rng(draw)), 0, 1))).astype(
                        np.uint8
                    )
                    path = Path(folder) / ("a.jpg" if draw % 2 else "a.png")
                    Image.fromarray(encoded).save(path, **({"quality": 92} if draw % 2 else {}))
                    said = [answer(path, region, SIDES.get(name, 0.0)) for region in (True, False)]
                    good = [bool(one) == bool(wanted) for one in said]
                    right = [n + one for n, one in zip(right, good, strict=True)]
                    if asked.all or not all(good):
                        print(f"  {what}: {name}: in a region: {said[0] or 'measured'}; found: {said[1] or 'measured'}")
            count = len(pictures) * asked.draws
            print(
                f"{what}: as expected in a given region {right[0]} of {count}, in the automatic search {right[1]} of "
                f"{count}"
            )
            bad += right[0] < 0.95 * count
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
