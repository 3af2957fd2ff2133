"""Instances of a stage with many parameters away from their ordinary values at once.

In:  a class of stages and its ordinary values.
Out: values that it accepts together.

Many numbers are ordinarily 0, and then hide the effect of other parameters: an off-axis aberration without a field, a
phase without an amplitude, the decay of a tail without light. Each number is moved to a value beside its ordinary one
(to a small number if this is 0) or, in every second instance, to a value inside its range if the range has two ends.
Choices, settings of knobs and other texts are varied in turn. A parameter keeps its ordinary value if the stage refuses
the changed one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, get_args, get_origin

from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values.parameter import Parameter
from etendue.testing.bench import SMALL, Bench

MIXED = 4  # instances
SHARES = (0.37, -0.29, 0.23, -0.41, 0.31, -0.17, 0.43)  # relative changes of a number
SOME = 0.1  # value of a number that is ordinarily 0
WIDE = 20.0  # if the ends of a range are a larger factor apart, its inside is taken logarithmically
ENTRIES = 6  # entries of a list of any length: Zernike terms up to astigmatism, some waves
Wanted = Mapping[str, list[Any]]
Accepts = Callable[[type[Stage], Mapping[str, Any]], bool]


def mixed(kind: type[Stage], base: Mapping[str, Any], number: int) -> dict[str, Any]:
    """Return values of one instance: all wanted values, or as many as the stage accepts."""
    wanted = {
        name: found
        for place, (name, (parameter, form, _)) in enumerate(parameters_of(kind).items())
        if (found := candidates(parameter, form, base[name], number, place))
    }
    if number % 4 > 1:  # if two changes exclude each other, prefer the other one
        wanted = dict(reversed(wanted.items()))
    constructed = as_many(kind, dict(base), wanted, constructs)
    return constructed if computes(kind, constructed) else as_many(kind, dict(base), wanted, computes)


def as_many(kind: type[Stage], values: dict[str, Any], wanted: Wanted, accepts: Accepts) -> dict[str, Any]:
    """Return the values with all wanted changes if the stage accepts them together; otherwise split the changes into
    halves and return the values with the accepted changes of each half.
    """
    if accepts(kind, whole := {**values, **{name: found[0] for name, found in wanted.items()}}):
        return whole
    if not wanted:
        return values
    if len(wanted) == 1:
        ((name, found),) = wanted.items()
        return next((one for value in found[1:] if accepts(kind, one := {**values, name: value})), values)
    names = list(wanted)
    for half in (names[: len(names) // 2], names[len(names) // 2 :]):
        values = as_many(kind, values, {name: wanted[name] for name in half}, accepts)
    return values


def constructs(kind: type[Stage], values: Mapping[str, Any]) -> bool:
    """Return whether the stage can be created with these values and accepts the grids of a bench."""
    with suppress(Exception):  # foreign code may raise anything; other cases report it
        Bench(kind(**values)).job()
        return True
    return False


def computes(kind: type[Stage], values: Mapping[str, Any]) -> bool:
    """Return whether the stage can be created with these values and computes a small frame."""
    with suppress(Exception):
        bench = Bench(kind(**values))
        return bench.run(bench.arrays("ordinary", SMALL), frame=SMALL).done
    return False


def candidates(parameter: Parameter, form: Any, now: Any, number: int, place: int) -> list[Any]:
    """Return the values to try for a parameter, the preferred one first; empty if the parameter is not changed."""
    if parameter.settings and parameter.fidelity:
        return beside_setting(parameter, now, number)
    if parameter.fidelity:
        return []
    if parameter.choices or parameter.tried:
        every = [value for value in (now, *(parameter.choices or parameter.tried)) if value != ""]
        return [every[(every.index(now) + number + place) % len(every)]] if now in every else []
    if form is bool:
        return [bool(now) ^ bool((number + place) % 2)]
    if form is int:
        return [value for value in (now + 1, now - 1) if number % 2 and allowed(parameter, value)]
    return numeric_candidates(parameter, form, now, number, place)


def numeric_candidates(parameter: Parameter, form: Any, now: Any, number: int, place: int) -> list[Any]:
    """Return the values to try for a number or a tuple of numbers; none for other types."""
    if form is float:
        return numbers(parameter, float(now), number, place)
    if get_origin(form) is tuple and get_args(form)[0] is float:
        length = parameter.length or len(now) or ENTRIES
        several = [
            numbers(parameter, float(value), number, place + entry)
            for entry, value in enumerate(now or (0.0,) * length)
        ]
        return [tuple(found[0] for found in several)] if all(several) else []
    return []


def beside_setting(parameter: Parameter, now: Any, number: int) -> list[Any]:
    """Return the next cheaper or the next finer setting of a knob."""
    place = next((n for n, value in enumerate(parameter.settings) if value == now), None)
    if place is None:
        return []
    other = place - 1 if number % 2 or parameter.dear or place + 1 == len(parameter.settings) else place + 1
    return [parameter.settings[max(other, 0)]]


def numbers(parameter: Parameter, now: float, number: int, place: int) -> list[float]:
    """Return the numbers to try: one next to the ordinary value and, if the range has two ends, one inside the range.
    The latter is preferred for every second instance.
    """
    if not math.isfinite(now):
        return []
    share = SHARES[(place + 3 * number) % len(SHARES)]
    near = [now * (1 + share)] if now else [math.copysign(SOME * (1 + share), share), SOME * (1 + share)]
    low = parameter.above if parameter.at_least is None else parameter.at_least
    high = parameter.below if parameter.at_most is None else parameter.at_most
    if low is not None and high is not None:
        part = 0.5 + 0.5 * share
        inside = low * (high / low) ** part if low > 0 and high > WIDE * low else low + part * (high - low)
        near = [inside, *near] if number % 2 == 0 else [*near, inside]
    return [value for value in (float(f"{value:.6g}") for value in near) if allowed(parameter, value) and value != now]


def allowed(parameter: Parameter, value: float) -> bool:
    held = parameter.held is None or parameter.held[0] <= value <= parameter.held[1]
    return held and parameter.allows(value)
