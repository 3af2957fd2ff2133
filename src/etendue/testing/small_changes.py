"""The effect of a small change: of the input, of a parameter, of the unit of light.

In:  a ``Bench``.
Out: nothing, or ``LawBroken`` that names the jump.

Apart from rounding, a change by one unit in the last place may have at most ``SHARE`` of the effect of a change by
1e-6, and a change by 1e-6 may change the result by at most ``JUMP`` of full scale. The effect of a change by 1e-6,
times 1e6, is the condition number.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from etendue.archive.read.differing import full_scale
from etendue.contract.capabilities import decides
from etendue.contract.stage import parameters_of
from etendue.plan.wiring.parameters import SMALLEST
from etendue.testing.bench import Arrays, Bench, BenchTrial, largest_difference
from etendue.testing.checks import bound_of
from etendue.testing.digits import UNSTATED
from etendue.testing.measured import hold, magnified, ratio_of, within

STEP = 1e-6
JUMP = 1e-2  # largest effect of a change of 1e-6, of full scale: a condition number of 10 000
SHARE = 1e-3  # largest effect of an ulp, as a fraction of that of a change of 1e-6: 4e6 times that of a straight line
LIGHT = ("W m-2 sr-1 nm-1", "W m-2 nm-1")  # units used only for light
UNITS = (2.0**-20, 2.0**20)


def jumps(bench: Bench) -> bool:
    """Return whether a stage decides or rounds by design: it writes integers, or declares ``decides``."""
    return decides(bench.stage) or any(d.dtype != "float" for d in bench.writes.values())


def input_changes(bench: Bench) -> None:
    """Compare the results before and after a change of a whole input by one ulp, and by 1e-6."""
    if not bench.steady or jumps(bench):
        return
    for port, declaration in bench.reads.items():
        if declaration.dtype != "float":
            continue
        for what in ("ordinary", "decades"):
            inputs = bench.arrays(what)
            base = bench.run(inputs)
            moved = {
                "an ulp": bench.run({**inputs, port: np.nextafter(inputs[port], np.inf)}),
                "1e-6": bench.run({**inputs, port: inputs[port] * (1 + STEP)}),
            }
            compare(bench, base, moved, f"{port} of {what} input", inputs)


def parameter_changes(bench: Bench, names: tuple[str, ...] | None = None) -> None:
    """Compare the results before and after a change of every numeric parameter by one ulp, and by 1e-6, within its
    allowed range.
    """
    if not bench.steady:
        return
    inputs = bench.arrays("ordinary")
    base = bench.run(inputs)
    for name, (parameter, kind, _) in parameters_of(bench.kind).items():
        value = getattr(bench.stage, name)
        if (
            kind is not float
            or parameter.fidelity
            or not math.isfinite(value)
            or not value
            or (names is not None and name not in names)
        ):
            continue
        if jumps(bench):
            continue
        trials = {}
        for word, step in (("an ulp", math.ulp(value)), ("1e-6", STEP * abs(value))):
            near = next((v for v in (value + step, value - step) if parameter.allows(v)), None)
            trial = None if near is None else with_parameter(bench, name, near, inputs)
            if trial is not None:
                trials[word] = trial
        compare(bench, base, trials, f"{name} = {value:g}", inputs)


def with_parameter(bench: Bench, name: str, value: float, inputs: Arrays) -> BenchTrial | None:
    """Return the result with one parameter changed; None if the stage refuses it, or the grid differs."""
    try:
        stage = dataclasses.replace(bench.stage, **{name: value})
        return Bench(stage, bench.given_grids or bench.input_grids(), bench.scales, bench.coordinates).run(inputs)
    except ValueError:
        return None


def compare(bench: Bench, base: BenchTrial, moved: dict[str, BenchTrial], what: str, inputs: Arrays) -> None:
    """Compare results relative to the largest value of the result or, if it is larger and of the same variable, of the
    input.
    """
    if not base.done:
        return
    rounding = 2 * max(UNSTATED["float64"], min(1e-6, bound_of(bench, inputs, "float64")))
    read = {d.variable: full_scale(inputs[port]) for port, d in bench.reads.items()}
    for variable, now in base.arrays.items():
        scale = max(full_scale(now), read.get(variable, 0.0), SMALLEST)
        apart = {
            word: ratio_of(largest_difference(trial.arrays[variable], now), scale)
            for word, trial in moved.items()
            if trial.done and trial.arrays[variable].shape == now.shape
        }
        if "1e-6" in apart:
            magnified(apart["1e-6"] / STEP)
            within(
                apart["1e-6"],
                JUMP + rounding,
                f"{bench.name}: {variable} jumps by {apart['1e-6']:.2g} of its largest value when {what} moves by "
                f"1e-6; "
                "declare decides = True if the stage rounds, counts or chooses",
            )
        if "an ulp" in apart:
            within(
                apart["an ulp"],
                SHARE * min(apart.get("1e-6", 0.0), JUMP) + rounding,
                f"{bench.name}: {variable} jumps by {apart['an ulp']:.2g} of its largest value when {what} moves by "
                f"its last bit: "
                "digits are lost, or the stage makes a decision at this value",
            )


def unit_changes(bench: Bench) -> None:
    """Check that the result does not depend on the unit of light, for units a million times as large or small. This
    reveals constants that are hidden in the code.

    Applies to stages that read and write one variable of light and use its unit nowhere else.
    """
    port = bench.one_array
    if port is None or not bench.steady:
        return
    declaration = bench.reads[port]
    main = next((v for v, d in bench.writes.items() if v == declaration.variable), None)
    if (
        main is None
        or declaration.unit not in LIGHT
        or any(p.units == declaration.unit for p, _, _ in parameters_of(bench.kind).values())
    ):
        return
    for what in ("ordinary", "decades", "point"):
        inputs = bench.arrays(what)
        base = bench.run(inputs)
        if not base.done:
            continue
        for factor in UNITS:
            other = bench.run({port: inputs[port] * factor})
            hold(
                other.done,
                f"{bench.name} fails if the unit of {port} is {1 / factor:g} times as large: {other.last_line}",
            )
            found, wanted = np.asarray(other.arrays[main], float) / factor, np.asarray(base.arrays[main], float)
            apart = ratio_of(largest_difference(found, wanted), full_scale(wanted))
            within(
                apart,
                2 * UNSTATED["float64"],
                f"{bench.name}: a hidden constant: {main} is off by {apart:.2g} of its largest value on {what} input "
                f"if its unit is "
                f"{1 / factor:g} times as large, but no parameter has that unit",
            )
