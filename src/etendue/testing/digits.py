"""Digits lost by a stage: compare single, double and long double precision at every level of its input.

In:  a ``Bench``.
Out: nothing, or ``LawBroken`` with the place where digits are lost.

This needs a machine whose long double has more digits than double; elsewhere double precision is its own reference.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import DTypeLike

from etendue.archive.read.differing import full_scale
from etendue.compute.tables import prepared_of
from etendue.contract.capabilities import Transfer, decides, is_random
from etendue.plan.wiring.parameters import SMALLEST
from etendue.testing.bench import FRAME, LARGE, Arrays, Bench, BenchTrial, Frame, largest_difference
from etendue.testing.checks import bound_of
from etendue.testing.examples import edges
from etendue.testing.measured import ratio_of, within
from etendue.types.arrays import Array

LONG = "longdouble"
UNSTATED = {
    "float32": 1e-5,
    "float64": 1e-11,
}  # of full scale, for a stage that states no error: about a hundred roundings
ANY = 1e-6  # a larger bound covers approximations and says nothing about digits
STEPS = (1e-8, 3e-8, 1e-7)
CURVED = (
    1e-9  # of full scale; deviation from a straight line over a step of 1e-7; that of smooth functions is far smaller
)
LEVELS = (
    (1.0, "ordinary"),
    (1e-6, "ordinary"),
    (1e-12, "ordinary"),
    (1e-20, "ordinary"),
    (1e3, "ordinary"),
    (1e6, "ordinary"),
    (1.0, "decades"),
    (1.0, "faint"),
    (1.0, "point"),
    (1.0, "hole"),
    (1.0, "hot"),
)
FREQUENCIES = 400  # number of frequencies first evaluated, from 1e-6 to 1e3 um-1
ZOOMS, CLOSER = 6, 30.0  # number and factor of the zooms to where the precisions differ most


def digits_kept(bench: Bench) -> None:
    """Compare the results in three precisions for several inputs, relative to the largest value of each result."""
    if isinstance(bench.stage, Transfer):
        transfer_digits(bench)
    if not bench.steady:
        return
    for what, factor, frame in inputs_of(bench):
        given = bench.given(bench.arrays(what, frame, factor), "float32")
        try:
            single, double = bench.run(given, "float32", frame), bench.run(given, "float64", frame)
        except ValueError:
            continue  # it refuses the grid
        if not (single.done and double.done):
            continue  # refused: tested by another law
        where = f"{what} input x {factor:g} of {frame[0]} x {frame[1]}" if bench.reads else "what it writes"
        compare(
            bench,
            double,
            long_double(bench, given, frame),
            where,
            "float64",
            allowed(bench, given, "float64", frame),
            frame,
        )
        both = allowed(bench, given, "float32", frame) + allowed(bench, given, "float64", frame)
        compare(bench, single, double, where, "float32", both, frame)
    for port, declaration in bench.reads.items():
        if declaration.dtype == "float" and not decides(bench.stage):
            double_inside(bench, port)


def double_inside(bench: Bench, port: str) -> None:
    """Test that double precision is kept: the effects of a small step up and down cancel except for curvature, unless
    an intermediate value is rounded to 32 bits.
    """
    inputs = bench.arrays("ordinary")
    base = bench.run(inputs)
    for step in STEPS if base.done else ():
        up, down = (bench.run({**inputs, port: inputs[port] * (1 + sign * step)}) for sign in (1, -1))
        for variable, now in base.arrays.items() if up.done and down.done else ():
            if bench.writes[variable].dtype != "float" or not full_scale(now):
                continue
            both = np.asarray(up.arrays[variable], float) + np.asarray(down.arrays[variable], float)
            off = ratio_of(largest_difference(both, 2 * np.asarray(now, float)), max(full_scale(now), SMALLEST))
            within(
                off,
                CURVED,
                f"{bench.name}: digits lost in double precision, as if rounded to 32 bits: {variable} "
                f"deviates by {off:.2g} of its "
                f"largest value from a straight line when {port} moves up and down by {step:g}; allowed: {CURVED:g}",
            )


def inputs_of(bench: Bench) -> Iterator[tuple[str, float, Frame]]:
    if not bench.reads:
        yield "ordinary", 1.0, FRAME
        return
    for factor, what in LEVELS:
        yield what, factor, FRAME
    if not bench.given_grids and bench.one_array:
        yield "ordinary", 1.0, LARGE


def long_double(bench: Bench, given: Arrays, frame: Frame) -> BenchTrial | None:
    """Return the result in long double, if the stage and the libraries below it support it."""
    if is_random(bench.kind):
        return None  # random numbers exist only in the other two precisions
    try:
        found = bench.run(given, LONG, frame)
    except Exception:  # a library does not support the type
        return None
    return found if found.done else None


def allowed(bench: Bench, given: Arrays, precision: str, frame: Frame) -> float:
    """Return the allowed error: that stated by the stage, or a default tolerance."""
    stated = bench.own_error(given, precision, frame)
    least = UNSTATED[precision] if stated is None or precision == "float64" else 0.0
    return max(least, stated or 0.0)


def compare(
    bench: Bench, found: BenchTrial, finer: BenchTrial | None, where: str, precision: str, bound: float, frame: Frame
) -> None:
    if finer is None:
        return
    for variable, exact in finer.arrays.items():
        if bench.writes[variable].dtype != "float":
            continue
        with np.errstate(all="ignore"):
            off = ratio_of(largest_difference(found.arrays[variable], exact), max(full_scale(exact), SMALLEST))
        said = (
            "cancellation: even double precision loses digits compared with long double"
            if precision == "float64"
            else "digits lost in single precision: a long sum in float32, or a difference of large numbers"
        )
        within(
            off,
            bound,
            f"{bench.name}: {said}; {variable} is off by {off:.2g} of its largest value on {where}; allowed: "
            f"{bound:.2g}",
        )


def transfer_digits(bench: Bench) -> None:
    """Compare a transfer function in double and long double along a line of frequencies, zooming in where they differ
    most.
    """
    stage = bench.stage
    assert isinstance(stage, Transfer)
    grids = bench.input_grids()
    prepared = prepared_of(stage, grids, bench.job().grids)
    last = [] if prepared is None else [prepared]
    bands = np.array(edges())
    middle = (0.5e-3 * (bands[:-1] + bands[1:]))[:, None, None]

    def planes(frequency: Array, precision: DTypeLike) -> Array:
        fx, fy = frequency.astype(precision)[None, :], np.zeros((1, 1), precision)
        with np.errstate(all="ignore"):
            return np.asarray(stage.transfer(fy, fx, middle.astype(precision), *last))

    frequency = np.geomspace(1e-6, 1e3, FREQUENCIES)
    bound = max(UNSTATED["float64"], min(ANY, bound_of(bench, bench.arrays("ordinary"), "float64")))
    for _ in range(ZOOMS):
        double = planes(frequency, np.float64)
        try:
            exact = planes(frequency, np.longdouble)
        except TypeError:
            return
        near = planes(
            frequency * (1 + 4 * np.finfo(float).eps), np.float64
        )  # the effect of rounding the argument, which is not the function's own error
        apart = np.maximum(np.abs(double - exact).astype(float) - np.abs(near - double), 0.0)
        apart = np.where(np.isfinite(apart), apart, 0.0)  # values that are not finite are tested by another law
        worst = float(apart.max())
        at = float(frequency[int(apart.reshape(-1, frequency.size).max(axis=0).argmax())])
        within(
            worst,
            bound,
            f"{bench.name}: cancellation: even double precision loses digits compared with long double; its transfer "
            f"function is off by "
            f"{worst:.2g} at {at:.9g} um-1; allowed: {bound:.2g}",
        )
        ratio = float(frequency[-1] / frequency[0]) ** (1 / CLOSER)
        frequency = np.geomspace(at / ratio, at * ratio, FREQUENCIES)
