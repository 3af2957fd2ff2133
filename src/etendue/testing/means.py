"""The mean that a stage states for its draws, or for values before rounding.

In:  a ``Bench``, and its input.
Out: the arrays that ``mean`` returns when the engine calls it.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from etendue.compute.cell import compute
from etendue.compute.joined.segments import Result
from etendue.plan.model import CellRef
from etendue.testing.bench import FRAME, Arrays, Bench, Frame, LawBroken
from etendue.types.arrays import Array


def mean_of(bench: Bench, inputs: Arrays, frame: Frame = FRAME) -> dict[str, Array]:
    """Return what ``mean`` returns when the engine calls it, with every input as floats."""
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
