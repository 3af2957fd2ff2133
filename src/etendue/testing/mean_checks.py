"""What is measured of a stage that draws or rounds: its mean is that of its draws.

In:  a ``Bench`` whose stage is ``Sampled``.
Out: nothing, or ``LawBroken``.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from etendue.compute.cell import compute
from etendue.compute.joined.segments import Result
from etendue.contract.capabilities import Sampled, is_random, mean_arguments_of, rounds
from etendue.plan.model import CellRef
from etendue.testing.bench import Bench, LawBroken
from etendue.testing.measured import hold

DRAWS = 24
ERRORS = 6.0  # standard errors of the mean of so many draws
LEVEL = 0.3  # of full scale: far from clipping


def check_mean(bench: Bench) -> None:
    """The same variables; on a flat input the mean over draws and pixels within six standard errors, and half a code
    where it rounds.
    """
    kind = bench.kind
    assert issubclass(kind, Sampled)
    try:
        mean_arguments_of(kind)
    except TypeError as error:
        raise LawBroken(str(error)) from None
    inputs = bench.arrays("uniform", factor=LEVEL)
    expected = mean_of(bench, inputs)
    drawn: dict[str, list[float]] = {}
    for seed in range(DRAWS):
        for name, array in bench.result(inputs, seed=f"draw {seed}".encode()).arrays.items():
            drawn.setdefault(name, []).append(float(np.mean(array, dtype=np.float64)))
    for name, declaration in bench.writes.items():
        if declaration.dtype != "float" and declaration.unit == "1":
            continue  # a map of what was drawn has no mean
        values, said = np.array(drawn[name]), float(np.mean(expected[name], dtype=np.float64))
        if is_random(kind) and not values.std():
            continue  # what is drawn is too rare to be seen in so few pixels
        room = ERRORS * values.std(ddof=1) / np.sqrt(DRAWS) + 1e-6 * abs(said) + (0.5 if rounds(kind) else 0.0)
        hold(
            abs(values.mean() - said) <= room,
            f"{bench.name} gives {name} = {values.mean():.6g} on average over {DRAWS} draws, but mean says {said:.6g}",
        )


def mean_of(bench: Bench, inputs: Any) -> dict[str, Any]:
    """What ``mean`` gives, through the engine; every input as floats."""
    job = dataclasses.replace(bench.job(), expected=True)
    floats = {port: np.asarray(array, dtype=np.float64) for port, array in inputs.items()}
    results: dict[CellRef, Result] = {}
    for port, array in floats.items():
        variable = bench.reads[port].variable
        results[port, ()] = Result({variable: array}, {variable: float(array.min())})
    result, report = compute(job, results)
    if report.status != "done":
        raise LawBroken(f"{bench.name}.mean breaks off: {report.message}")
    return result.arrays
