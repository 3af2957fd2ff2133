"""The mean that a stage states for its draws, or for values before rounding.

In:  a ``Bench``, and its input.
Out: the arrays that ``mean`` returns when the engine calls it.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from etendue.compute.cell import compute
from etendue.compute.joined.segments import Result
from etendue.plan.model import CellRef
from etendue.testing.bench import FRAME, Arrays, Bench, Frame, LawBroken
from etendue.types.arrays import Array


def mean_of(bench: Bench, inputs: Arrays, frame: Frame = FRAME) -> dict[str, Array]:
    """Return the result of ``mean`` when the engine calls it, with every input as floats."""
    job = dataclasses.replace(bench.job(frame=frame), expected=True)
    floats = {port: np.asarray(array, dtype=np.float64) for port, array in inputs.items()}
    results: dict[CellRef, Result] = {}
    for port, array in floats.items():
        variable = bench.reads[port].variable
        results[port, ()] = Result({variable: array}, {variable: float(array.min())})
    result, report = compute(job, results)
    if report.status != "done":
        raise LawBroken(f"{bench.name}.mean failed: {report.message}")
    return result.arrays


def events(values: Array) -> bool:
    """Return whether most places have the same value, as in the output of a stage that draws rare events, such as dead
    pixels.
    """
    return bool(np.count_nonzero(values == np.median(values)) > 0.5 * values.size)


def missed(values: Array, p: float) -> float:
    """Return by how much a mean over all pixels may differ from its expected value because rare events, such as dead
    pixels, happen not to occur; 0 if the values show no rare events.

    Events of which ln(1/p) are expected do not occur at all with the probability ``p``. The bound is ln(1/p) divided by
    the number of pixels, times the effect of one event: the larger of the median's magnitude and the largest distance
    from the median.
    """
    if not events(values):
        return 0.0
    usual = float(np.median(values))
    return math.log(1 / p) / values.size * max(abs(usual), float(np.abs(values - usual).max(initial=0.0)))
