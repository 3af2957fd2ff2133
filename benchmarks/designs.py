"""How often intervals of a design hold the truth, over many seeds: Sobol' indices of functions and of
metrics of a camera whose indices are known, and the yield of units whose yield is known.

That a stage of a plugin, and the camera, give these functions over a design is a law in ``tests/designs``.

    python benchmarks/designs.py [SEEDS] [POINTS]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from etendue.plan.designs.points import unit_points
from etendue_lab.designs.indices import indices, mixed_of
from etendue_lab.designs.yields import required, yields
from tests.designs.cameras import CAMERAS
from tests.designs.known import FUNCTIONS, Known
from tests.designs.test_yields import truth, units

LEAST = 0.01  # smaller indices are not counted
RESAMPLED = 499


def points_of(method: str, points: int, factors: int, seed: int) -> np.ndarray:
    """Return the rows of a Saltelli design, from a scrambled sequence or from independent numbers."""
    if method == "sobol":
        return unit_points("saltelli", points, factors, seed, ())
    first, second = np.random.default_rng(seed).random((2, points, factors))
    mixed = np.repeat(first[:, None], factors, axis=1)
    mixed[:, range(factors), range(factors)] = second
    return np.concatenate([first[:, None], second[:, None], mixed], axis=1).reshape(-1, factors)


def held(known: Known, method: str, seeds: int, points: int) -> np.ndarray:
    """Return the share of seeds whose interval holds each index: (first and total, factors)."""
    factors, found = len(known.total), []
    for seed in range(seeds):
        rows = points_of(method, points, factors, seed)
        own = indices(mixed_of(known.function(rows.T), factors), RESAMPLED, seed=seed)
        both = ((own.first, known.first), (own.total, known.total))
        found.append([(one[:, 1] <= true + 1e-12) & (true <= one[:, 2] + 1e-12) for one, true in both])
    return np.mean(found, axis=0)


def main(seeds: int = 200, points: int = 1024) -> None:
    """Print the shares."""
    print(f"{points} points: share of intervals at 95 % that hold the truth, factor by factor")
    for method, seeds_of in (("sobol", seeds), ("random", 5 * seeds)):  # shares near 0.95 need more seeds to be told
        print(f"{method}: {seeds_of} seeds")
        least, dummies = 1.0, 1.0
        for known in (*FUNCTIONS, *CAMERAS):
            shares, true = held(known, method, seeds_of, points), np.stack([known.first, known.total])
            least = min(least, shares[true > LEAST].min())
            dummies = min([dummies, *shares[1, known.total == 0]])
            for name, own, there in zip(("first", "total"), shares, true > LEAST, strict=True):
                texts = [f"{share:.3f}" if one else f"({share:.3f})" for share, one in zip(own, there, strict=True)]
                print(f"{method:7s} {known.name:16s} {name:6s} {' '.join(texts)}")
        print(f"{method:7s} least above {LEAST}: {least:.3f}; total indices of dummy factors: {dummies:.3f}")
    for method in ("random", "sobol"):
        own = [yields(units(method, seed=seed), required(["sum >= 13"]))["places"][0] for seed in range(seeds)]
        share = np.mean([one["yield"]["low"] <= truth(13) <= one["yield"]["high"] for one in own])
        gain = truth(13, 0.1) - truth(13)
        gains = [next(f["gain"] for f in one["tighter"] if f["factor"] == "a") for one in own]
        of_gain = np.mean([one["low"] <= gain <= one["high"] for one in gains])
        print(f"yield of 400 units, {method}: {share:.3f}; gain of a spread smaller by a tenth: {of_gain:.3f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
