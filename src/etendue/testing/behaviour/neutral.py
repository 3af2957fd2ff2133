"""Neutral values: a parameter at 0, or a number without a unit at 1, at which a stage should not change its input.

In:  a ``Bench`` whose stage writes the variable that it reads.
Out: nothing, or ``LawBroken``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from etendue.archive.read.differing import full_scale
from etendue.contract.capabilities import is_random
from etendue.contract.stage import parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.testing.bench import SMALL, Bench, largest_difference
from etendue.testing.cases import real_ends, span_of
from etendue.testing.checks import bound_of
from etendue.testing.measured import ratio_of, within

NOTHING = ("none", "off", "identity", "nothing")
NEARLY = 0.05  # a value is meant to have no effect if it has less than this fraction of the effect of other values
EXACT = 1e-9
SIDE = 0.2  # distance of a neighbour, as a fraction of the value, or of the range if the value is 0


def neutral_is_identity(bench: Bench) -> None:
    """Find the values of each parameter at which the stage hardly changes its input, with the other numbers unchanged
    and with all of them at 0. There the change must be within the stated error.
    """
    port = bench.one_array
    if port is None or is_random(bench.kind) or bench.given_grids:
        return
    if bench.reads[port].variable not in bench.writes or bench.reads[port].dtype != "float":
        return
    numbers = {
        name: parameter
        for name, (parameter, kind, _) in parameters_of(bench.kind).items()
        if kind is float and not parameter.fidelity
    }
    for name, (parameter, kind, _) in parameters_of(bench.kind).items():
        if kind is int and not parameter.fidelity and (parameter.allows(0) or parameter.allows(1)):
            _hold_number(bench, name, parameter)
        for word in {*(parameter.choices or ())} & {*NOTHING}:
            _hold_nothing(bench, name, word)
    for name, parameter in numbers.items():
        others = [{}, {other: 0.0 for other, one in numbers.items() if other != name and one.allows(0.0)}]
        _hold_neutral(bench, name, parameter, others)


def _hold_neutral(bench: Bench, name: str, parameter: Parameter, others: list[dict[str, float]]) -> None:
    """Test the neutral value of a parameter, if it has one, with each of ``others``: values of the other parameters."""
    span = span_of(parameter, float, getattr(bench.stage, name))
    far = [getattr(bench.stage, name), *(span or ()), *real_ends(parameter, getattr(bench.stage, name))]
    effect = max((e for value in far if (e := done(bench, {name: value})) is not None and e <= 1.0), default=0.0)
    values = [0.0] if parameter.allows(0.0) else [1.0] if parameter.units in ("", "1") else []
    for value in (one for one in values if one not in parameter.apart):
        found = [(e, more) for more in others if (e := done(bench, {**more, name: value})) is not None]
        bound = 2 * max(bound_of(bench, bench.arrays("ordinary", SMALL), "float64", 0.0, SMALL), EXACT)
        left, more = min(found, key=lambda one: one[0], default=(math.inf, {}))
        if left > NEARLY * effect or bound > NEARLY * effect:
            continue
        sides = (done(bench, {**more, name: side}) for side in beside(value, span))
        if any(less is not None and less <= left for less in sides):
            continue  # on one side the effect is still smaller: the value is not a neutral one
        variable = bench.reads[str(bench.one_array)].variable
        within(
            left,
            bound,
            f"{bench.name}: with {name} = {value:g} it should leave {variable} alone, but changes it by {left:.2g} of "
            f"its largest value, where its effect elsewhere is {effect:.2g}",
        )


def _hold_number(bench: Bench, name: str, parameter: Parameter) -> None:
    """Test a whole number at which the stage hardly changes its input, such as a radius of 0 or a factor of 1."""
    effects = [
        done(bench, {name: value}) for value in (0, 1, 2, 3, getattr(bench.stage, name)) if parameter.allows(value)
    ]
    effect = max((e for e in effects if e is not None and e <= 1.0), default=0.0)
    for value in [0] if parameter.allows(0) and 0 not in parameter.apart else [1] if parameter.allows(1) else []:
        left = done(bench, {name: value})
        if left is not None and left <= NEARLY * effect:
            _hold_left(bench, name, value, left, effect)


def _hold_nothing(bench: Bench, name: str, word: str) -> None:
    """Test a choice that switches the stage off, if it changes the input far less than the other choices do."""
    left = done(bench, {name: word})
    others = [done(bench, {name: one}) for one in parameters_of(bench.kind)[name][0].choices or () if one != word]
    effect = max((e for e in others if e is not None), default=0.0)
    if left is not None and left <= NEARLY * effect:
        _hold_left(bench, name, word, left, effect)


def _hold_left(bench: Bench, name: str, value: object, left: float, effect: float) -> None:
    bound = 2 * max(bound_of(bench, bench.arrays("ordinary", SMALL), "float64", 0.0, SMALL), EXACT)
    within(
        left,
        bound,
        f"{bench.name}: with {name} = {value} it should leave {bench.reads[str(bench.one_array)].variable} alone, but "
        f"changes it by {left:.2g} of its largest value, where its effect elsewhere is {effect:.2g}",
    )


def beside(value: float, span: tuple[float, float] | None) -> list[float]:
    """Return a smaller and a larger value nearby, as far as the range allows."""
    low, high = span or (value, value)
    step = SIDE * (abs(value) or high - low)
    return [side for side in (value - step, value + step) if low <= side <= high]


def done(bench: Bench, values: Mapping[str, object]) -> float | None:
    """Return the largest change of the input that the stage makes with these parameter values, relative to full scale;
    None if it refuses them.
    """
    variable = bench.reads[str(bench.one_array)].variable
    try:
        stage = dataclasses.replace(bench.stage, **values)
        own = Bench(stage, bench.given_grids, bench.scales, bench.coordinates)
        inputs = own.arrays("ordinary", SMALL)
        trial = own.run(inputs, frame=SMALL)
    except ValueError:
        return None
    given = np.asarray(inputs[str(bench.one_array)], float)
    if not trial.done or trial.arrays[variable].shape != given.shape:
        return None
    return ratio_of(largest_difference(np.asarray(trial.arrays[variable], float), given), full_scale(given))
