"""Instances of a stage that cover its declaration: ordinary values, each end of each range, corners, and random
interior points.

In:  a class of stages.
Out: ``Case`` values: a name, and the instance or the text with which it was refused.

Ordinary values are the defaults, or the ``example`` of a parameter that has no default or an expensive one. Ends are
the ends of the ranges that the plan allows (``at_least``, ``held``, ...): a number just inside an open end, an extreme
number where there is no end, zero and infinity if allowed. Knobs, and integers without a near upper end, change cost
rather than physics, so only their cheap end is tested. Interior points are a Sobol sequence, logarithmic over decades,
the same in every run. Mixed instances have many parameters beside their ordinary values at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_origin

from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values.parameter import MISSING, Parameter
from etendue.plan.wiring.parameters import LARGEST, SMALLEST, Unfit, resolve_file
from etendue.testing import mixed

ORDINARY, END, CORNER, FAR, INSIDE, MIXED = "ordinary", "end", "corner", "far", "inside", "mixed"
BEYOND = (
    1e6,
    1e30,
)  # for a range without an end: beyond anything that is built, and the largest number a pipeline may contain
NUDGE = 1e-12  # relative distance of a value just inside an open end
SOME = 0.1  # value of a quantity that is ordinarily 0 and whose ends may both be refused
WORK = 8  # largest multiple of its ordinary value for an integer without a near end
DECADES = 20.0  # if the ends of a range are a larger factor apart, it is sampled logarithmically
WIDE = 100.0  # a range without an end is sampled up to this factor from its ordinary value
POINTS = 4  # number of interior points


@dataclass(frozen=True)
class Case:
    """One instance of a stage."""

    name: str
    where: str  # ordinary, end, corner, far (all at their ultimate ends), inside or mixed
    stage: Stage | None
    refused: str = ""  # if there is no stage, the reason
    broke: bool = False  # whether it failed instead of refusing
    parameter: str = ""  # of an end: the parameter


class Untried(ValueError):
    """A stage cannot be created for testing; the text names the parameter without a value."""


def cases(kind: type[Stage], points: int = POINTS) -> Iterator[Case]:
    """Yield every case of a class of stages, the ordinary one first.

    Raises
    ------
    Untried
        If a parameter has neither a default nor an example.
    """
    base = ordinary(kind)
    yield made("ordinary", ORDINARY, kind, base)
    for name in base:
        for value in ends(*declared(kind, name), base[name]):
            yield made(f"{name} = {shown(value)}", END, kind, {**base, name: value}, name)
    found = [base]
    for number in range(mixed.MIXED):
        found.append(mixed.mixed(kind, base, number))
        if found[-1] not in found[:-1]:
            yield made(f"mixed {number + 1}", MIXED, kind, found[-1])
    ranges = {name: span for name in base if (span := span_of(*declared(kind, name), base[name])) is not None}
    if not ranges:
        return
    for number, share in enumerate(corners(len(ranges))):
        yield made(f"corner {number + 1}", CORNER, kind, {**base, **drawn(kind, ranges, share)})
    for word, far in (("lowest", 0), ("highest", 1)):
        ultimate = {name: end for name in ranges if (end := limits(declared(kind, name)[0])[far]) is not None}
        if len(ultimate) > 1:
            yield made(f"all {word}", FAR, kind, {**base, **ultimate})
    for number, share in enumerate(sobol(len(ranges), points)):
        yield made(f"inside {number + 1}", INSIDE, kind, {**base, **drawn(kind, ranges, share)})


def declared(kind: type[Stage], name: str) -> tuple[Parameter, Any]:
    parameter, form, _ = parameters_of(kind)[name]
    return parameter, form


def ordinary(kind: type[Stage]) -> dict[str, Any]:
    """Return a value for every parameter: its example, else its default."""
    found = {}
    for name, (parameter, _, default) in parameters_of(kind).items():
        value = default if parameter.example is None else parameter.example
        if value is MISSING:
            raise Untried(f"{name} has neither a default nor an example; add param(..., example=...)")
        if isinstance(value, str) and value.startswith("package:"):
            try:
                value = str(resolve_file(value, Path(), parameter.folder))
            except Unfit as error:
                raise Untried(f"the example of {name}: {error}") from None
        found[name] = tuple(value) if isinstance(value, list) else value
    return found


def made(name: str, where: str, kind: type[Stage], values: Mapping[str, Any], parameter: str = "") -> Case:
    """Return the case with an instance, or with the reason why there is none."""
    try:
        return Case(name, where, kind(**values), parameter=parameter)
    except ValueError as error:
        return Case(name, where, None, str(error), parameter=parameter)
    except Exception as error:  # foreign code may raise anything
        return Case(name, where, None, f"{type(error).__name__}: {error}", True, parameter)


def limits(parameter: Parameter) -> tuple[float | None, float | None]:
    """Return the smallest and the largest allowed number, just inside an open end; None where there is no end."""
    low: float | None = parameter.at_least
    high: float | None = parameter.at_most
    if parameter.above is not None:
        low = SMALLEST if parameter.above == 0 else parameter.above + NUDGE * abs(parameter.above)
    if parameter.below is not None:
        high = -SMALLEST if parameter.below == 0 else parameter.below - NUDGE * abs(parameter.below)
    if parameter.held is not None:
        low = parameter.held[0] if low is None else max(low, parameter.held[0])
        high = parameter.held[1] if high is None else min(high, parameter.held[1])
    return low, high


def ends(parameter: Parameter, form: Any, now: Any) -> list[Any]:
    """Return values at the ends of the allowed range, except the ordinary value."""
    if parameter.choices:
        return [choice for choice in parameter.choices if choice != now]
    if form is bool:
        return [not now]
    if get_origin(form) is tuple and get_args(form)[0] is float:
        length = parameter.length or len(now) or 1
        several = [(value,) * length for value in ends(parameter, float, now[0] if now else 0.0)]
        return [value for value in several if value != now]
    if form not in (int, float):
        return []
    if form is int:
        return list(dict.fromkeys(whole_ends(parameter, now)))
    return list(dict.fromkeys(value for value in real_ends(parameter, now) if value != now))


def whole_ends(parameter: Parameter, now: int) -> list[Any]:
    low, high = limits(parameter)
    top = WORK * max(abs(now), 1)
    far = [] if parameter.fidelity else [top if high is None or high > top else high]
    return [int(value) for value in ([] if low is None else [low]) + far if value != now]


def real_ends(parameter: Parameter, now: float) -> list[float]:
    low, high = limits(parameter)
    found: list[float] = [] if low is None else [low]
    if low is None:
        found += [-value for value in BEYOND]
    if high is not None:
        found.append(high)
    elif not parameter.fidelity:
        found += BEYOND
    if low == 0 and not parameter.fidelity:
        found.append(SMALLEST)
    found += (
        [0.0] if parameter.allows(0) and (parameter.held is None or parameter.held[0] <= 0 <= parameter.held[1]) else []
    )
    found += [math.inf] if parameter.infinite else []
    if now == 0 and not parameter.fidelity and parameter.allows(SOME):
        found.append(SOME)
    return [value for value in found if not parameter.fidelity or value >= abs(now)]


def span_of(parameter: Parameter, form: Any, now: Any) -> tuple[float, float] | None:
    """Return the range from which values of a parameter are drawn; None if it is not a float or only changes cost."""
    if form is not float or parameter.fidelity or parameter.choices:
        return None
    low, high = limits(parameter)
    size = abs(now) if now and math.isfinite(now) else 1.0
    wide = size / WIDE, size * WIDE
    low = (
        (-wide[1] if low is None else 0.0 if now == 0 else wide[0])
        if low is None or low <= SMALLEST
        else max(low, wide[0])
    )
    high = wide[1] if high is None else min(high, wide[1]) if high > 0 else high
    return (low, high) if low < high else None


def corners(dims: int) -> list[list[float]]:
    """Return corners of the unit cube: all low, all high, and alternating coordinates."""
    several = [[0.0] * dims, [1.0] * dims]
    return (
        several
        if dims < 2
        else [*several, [float(n % 2) for n in range(dims)], [float((n + 1) % 2) for n in range(dims)]]
    )


def sobol(dims: int, points: int) -> list[list[float]]:
    """Return points of the unit cube, from a scrambled Sobol sequence with a fixed seed."""
    from scipy.stats import qmc

    exponent = max(0, math.ceil(math.log2(points))) if points else 0
    return qmc.Sobol(dims, seed=20260101).random_base2(exponent)[:points].tolist() if points else []


def drawn(kind: type[Stage], ranges: Mapping[str, tuple[float, float]], shares: list[float]) -> dict[str, float]:
    """Return one value per parameter, at a share of its range (logarithmic if it spans decades)."""
    found = {}
    for (name, (low, high)), share in zip(ranges.items(), shares, strict=True):
        if low > 0 and high > DECADES * low:
            value = math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        else:
            value = low + share * (high - low)
        value = min(max(float(f"{value:.6g}"), low), high)
        found[name] = value if declared(kind, name)[0].allows(value) else 0.5 * (low + high)
    return found


def shown(value: Any) -> str:
    if isinstance(value, tuple):
        return f"({', '.join(map(shown, value))})"
    return f"{value:g}" if isinstance(value, float) else str(value)


assert LARGEST == BEYOND[1]
