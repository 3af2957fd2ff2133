"""Is the cheapest setting that ``etendue accuracy`` prints the cheapest? By the clock, against brute force.

    python benchmarks/cheapest.py [--only NAME ...] [--repeat 3] [--trials 12]

On a grid of 48 combinations of three knobs, for pipelines at the middle of their sweep. The search may try a few of
them; brute force runs every one of them so many times, in a random order, and takes the least time of each. Printed for
every tolerance that is reached: the printed error and time, the time that brute force has for the same settings, and
the least time that it has within the tolerance, with their ratio. A ratio above 1.1 is more than this clock scatters.
"""

from __future__ import annotations

import argparse
import os
import random
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from etendue.accuracy import trials
from etendue.accuracy.study import accuracy, chosen_knobs
from etendue.accuracy.trials import Effort, Trials
from etendue.contract.registry import installed_stages
from etendue.plan.expansion.search import Value
from etendue.session import load

FOLDER = Path(__file__).parent.parent / "pipelines"
KNOBS: dict[str, tuple[Value, ...]] = {
    "pixel.kept_frequencies": (0.125, 0.25, 0.5, 1.0),
    "pixel.wavelength_terms": (3, 5, 0),
    "precision": ("float32", "float64"),
}
GRIDS: dict[str, tuple[Value, ...]] = {"smallest": (50.0, 25.0), "sweep": (40.0, 20.0), "paper": (20.0, 10.0)}
Combination = tuple[tuple[str, Value], ...]


def brute(study: Trials, combinations: list[Combination], repeat: int) -> dict[Combination, float]:
    """Return the least warm time of every combination, run in a random order."""
    order, found = combinations * repeat, dict[Combination, float]()
    random.Random(0).shuffle(order)
    for own in order:
        settings = {key: value for key, value in own if value != study.search.start[key]}
        measurement = study.on(settings)
        timing = study.timed(measurement, measurement.plan(study.combined(settings)), 1)[1]
        found[own] = min(timing.least(trials.WARM), found.get(own, float("inf")))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=list(GRIDS), metavar="NAME")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--trials", type=int, default=12)
    given = parser.parse_args()
    registry = installed_stages()
    print(f"{'pipeline':10} {'tolerance':>9} {'error':>8} {'printed':>9} {'again':>9} {'least':>9} {'ratio':>6}")
    for name in given.only:
        pipeline = load(FOLDER / f"{name}.toml")
        asked = {**KNOBS, "scene.bin_width": GRIDS[name]}
        own = accuracy(pipeline, registry, asked, repeat=given.repeat, most=given.trials)
        every = accuracy(pipeline, registry, asked, repeat=1, most=1000)
        knobs = chosen_knobs(pipeline, registry, asked)
        study = Trials(pipeline, registry, knobs, frozenset(asked), Effort(1, given.repeat, lambda text: None))
        errors = {
            tuple((k.key, t.setting(k)) for k in knobs): max(t.error, every.floor)
            for t in every.trials
            if t.error is not None
        }
        least = brute(study, list(errors), given.repeat)
        for tolerance, one in own.cheapest:
            if one is None:
                continue
            again = least[tuple((k.key, one.setting(k)) for k in knobs)]
            best = min(seconds for settings, seconds in least.items() if errors[settings] <= tolerance)
            times = " ".join(f"{1e3 * seconds:6.1f} ms" for seconds in (one.cost, again, best))
            print(f"{name:10} {tolerance:9.0e} {one.error:8.2g} {times} {again / best:6.2f}", flush=True)


if __name__ == "__main__":
    main()
