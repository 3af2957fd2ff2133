"""Built-in stages compared with stored references: the results of each case when the reference was recorded.

In:  ``data/stage_references.json``: by stage and case, three numbers for each variable and input; and the bounds of
     stages whose kernels compute in 32 bits, because processors round these differently.
Out: a row per case.

The references are this project's own results in double precision, recorded by ``python benchmarks/stage_references.py``
once the laws and the closed forms held. They reveal changes by a mistake or by another version of a library. They do
not show that the recorded result was correct; the comparison with closed forms does. Random stages are compared by
mean, variance and data sheet, because another version of a generator may draw other numbers.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from etendue.contract.capabilities import Datasheet, Noisy, Sampled, is_random
from etendue.telling import said
from etendue.testing.bench import FRAME, Bench, BenchTrial, Frame
from etendue.testing.cases import END, ORDINARY, Case
from etendue.testing.means import mean_of
from etendue.types.arrays import Array
from etendue_lab.stability.rows import LawCase

LAW = "stored reference"
FILE = "stage_references.json"
BOUND = 1e-9  # relative to full scale; rounding differences between machines and libraries stay far below
DIGITS = 12
LEVELS = (0.0, 1.0, 30.0, 1e4)  # relative tolerance of a variance
INPUTS: dict[str, tuple[tuple[str, float, Frame], ...]] = {  # by kind of case: picture, level, frame
    ORDINARY: (
        ("ordinary", 1.0, FRAME),
        ("decades", 1.0, FRAME),
        ("point", 1.0, (11, 13)),
        ("ordinary", 3.0, FRAME),
        ("ordinary", 1e-3, FRAME),
        ("ordinary", 1.0, (40, 50)),
        ("ordinary", 1.0, (1, 14)),
    ),
    END: (("ordinary", 1.0, FRAME),),
}
OTHER = (("ordinary", 1.0, FRAME), ("ordinary", 1e-2, FRAME))
Numbers = dict[str, list[float]]


@cache
def stored() -> tuple[Mapping[str, Mapping[str, Numbers]], Mapping[str, float]]:
    """Return all references by stage and case, and the bounds that differ from ``BOUND``, by stage."""
    found = json.loads((resources.files("etendue_lab") / "data" / FILE).read_text(encoding="utf-8"))
    return found["stages"], found["bounds"]


def numbers_of(case: Case) -> Numbers:
    """Return the numbers of one case, by variable and input."""
    assert case.stage is not None
    bench = Bench(case.stage)
    found: Numbers = {}
    inputs = INPUTS.get(case.where, OTHER) if bench.reads else (("ordinary", 1.0, FRAME),)
    for what, level, frame in inputs:
        try:
            arrays = bench.arrays(what, frame, level)
            results = means(bench, arrays, frame) if is_random(bench.kind) else result(bench.run(arrays, frame=frame))
        except ValueError:
            continue  # the stage refuses the grid
        place = f"{what} x {level:g}, {frame[0]} x {frame[1]}"
        for variable, values in results.items():
            found[f"{variable}, {place}"] = summary(values)
    with suppress(ValueError):  # the stage refuses the case
        if isinstance(case.stage, Noisy):
            found["variance"] = [rounded(float(case.stage.variance(level))) for level in LEVELS]
        if isinstance(case.stage, Datasheet):
            found["datasheet"] = [rounded(float(value)) for value in case.stage.datasheet().values()]
    return found


def result(trial: BenchTrial) -> Mapping[str, Array]:
    return {v: a for v, a in trial.arrays.items() if np.asarray(a).dtype.kind in "iufbc"} if trial.done else {}


def means(bench: Bench, arrays: Any, frame: Frame) -> Mapping[str, Array]:
    if issubclass(bench.kind, Sampled):
        return mean_of(bench, arrays, frame)
    return result(bench.run(arrays, frame=frame)) if bench.steady else {}


def summary(values: Array) -> list[float]:
    """Return the largest magnitude in an array and two weighted sums of its values. The weights are cosines; each sum
    is divided by the largest magnitude and by the square root of the number of values.

    Values that are not finite are replaced by a number that ordinary results do not contain.
    """
    array = np.asarray(values, dtype=float).ravel()
    array = np.where(np.isfinite(array), array, -12345.678)
    top = float(np.abs(array).max(initial=0.0))
    count = np.arange(array.size, dtype=float)
    size = math.sqrt(array.size) or 1.0
    sums = [float((array * np.cos(rate * count + 0.3)).sum()) / (top or 1.0) / size for rate in (0.61, 1.93)]
    return [rounded(number) for number in (top, *sums)]


def rounded(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")


def row_of(name: str, case: Case) -> Iterator[LawCase]:
    """Yield the row of a case that has a reference."""
    references, bounds = stored()
    wanted = references.get(name, {}).get(case.name)
    if wanted is None or case.stage is None:
        return
    try:
        found = numbers_of(case)
    except Exception as error:
        yield LawCase(name, LAW, case.name, False, why=said(error))
        return
    worst, place, bound = 0.0, "", bounds.get(name, BOUND)
    for what in {**wanted, **found}:
        off = apart(found.get(what), wanted.get(what), what)
        if off > worst:
            worst, place = off, what
    why = "" if worst <= bound else f"{place} is {worst:.2g} of full scale from its stored reference"
    yield LawCase(name, LAW, case.name, worst <= bound, worst, bound, why=why)


def apart(found: list[float] | None, wanted: list[float] | None, what: str) -> float:
    """Return the largest difference between two summaries: relative for the largest magnitude, absolute for the sums.
    Condition numbers that differ only by rounding in double precision count as equal.
    """
    if found is None or wanted is None or len(found) != len(wanted):
        return math.inf
    relative = what in ("variance", "datasheet")
    off = 0.0
    for place, (one, other) in enumerate(zip(found, wanted, strict=True)):
        if one == other or (math.isnan(one) and math.isnan(other)):
            continue
        scale = max(abs(one), abs(other)) if relative or place == 0 else 1.0
        difference = abs(one - other) / scale
        if "condition" in what and difference <= 8 * np.finfo(float).eps * scale:
            continue
        off = max(off, difference if math.isfinite(difference) else math.inf)
    return off
