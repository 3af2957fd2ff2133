"""Continuity over whole ranges: of the brightness of all places, of one channel, of one place, and of every parameter.

In:  a ``Bench``.
Out: nothing, or ``LawBroken`` with the place and size of a jump.

A jump may be as large as the sum of the errors that the stage states on both sides of it. Stages that ``decide`` or
write whole numbers always jump; ``steps`` measures their steps. A stage that treats each place independently gets a
whole path in one frame. ``jumps_along`` describes how jumps are found.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from etendue.contract.capabilities import decides, is_transfer
from etendue.contract.stage import Stage, parameters_of
from etendue.plan.wiring.parameters import SMALLEST
from etendue.testing import mixed
from etendue.testing.behaviour.walking import LEAST, RANK, Results, Walk, jumps_along
from etendue.testing.bench import SMALL, Arrays, Bench, BenchTrial, Frame
from etendue.testing.cases import span_of
from etendue.testing.measured import ratio_of, untried, within
from etendue.types.arrays import Array


def levels(top: float, from_: float, count: int) -> Array:
    return np.concatenate([[0.0], np.geomspace(from_, top, count)])


LIGHT = levels(1e4, 1e-9, 131)  # of full scale: ten levels per decade, each in a separate run
FADING = levels(4.0, 1e-12, 31)
FINE, FINE_FADING = levels(1e4, 1e-9, 1301), levels(4.0, 1e-12, 601)  # in one frame
WORTH, FINE_WORTH = 4, 8  # steps of a path that are subdivided
POINTS = 49  # values of a parameter at equal distances, and as many at equal ratios
# Number of values of a parameter; number of steps subdivided for each number of a summary; rank.
OFTEN = (POINTS, 2, RANK)
DEAR = (9, 0, 40.0)  # the same for a stage that prepares tables or is a transfer function: one step in all
VAGUE = 0.05  # stated error above which a jump along a parameter cannot be distinguished from that error
NICE = (2.0, 0.5, 1.0, 3.0, 1.5, 4.0, 5.0, 2.5, 6.0, 8.0)  # values for which a stage may use a separate formula
BESIDE = 1e-9
PROOF: Frame = (6, 8)  # frame for testing whether places influence each other
BY_ITSELF = 1e-12  # relative; vector instructions round differently depending on the place in the array
Path = tuple[str, Array, Walk, int]


def stated(bench: Bench, inputs: Arrays, frame: Frame = SMALL) -> float:
    """Return the error that a stage states; 0 if it states none."""
    return bench.own_error(inputs, "float64", frame) or 0.0


def by_place(bench: Bench) -> list[str]:
    """Return the written variables that have positions; other variables may be counts."""
    return [name for name, d in bench.writes.items() if {"y", "x"} <= set(d.dims)]


def continuous_in_light(bench: Bench) -> None:
    """Search for jumps of the result with uniform light over thirteen decades, an ordinary picture of varying level,
    one channel that fades, and one bright place.
    """
    if not bench.reads or bench.looks or bench.given_grids or is_transfer(bench.kind) or not may_be_walked(bench):
        return
    for port, declaration in bench.reads.items():
        if declaration.dtype == "uint16" and bench.one_array == port and treats_places_alone(bench):
            of_codes(bench, port)
        if declaration.dtype != "float" or not declaration.dims:
            continue
        if not {"y", "x"} <= set(declaration.dims):
            along_entries(bench, port)
            continue
        error = 2 * stated(bench, bench.arrays("ordinary", SMALL))
        for word, places, walk, worth in frames(bench, port) if treats_places_alone(bench) else paths(bench, port):
            allowed = error + LEAST
            for variable, (off, low, _) in jumps_along(walk, places, by_place(bench), allowed, worth).items():
                judge(bench, variable, off, allowed, f"{port}, {word}, {low:.9g}")


def judge(bench: Bench, variable: str, off: float, allowed: float, where: str) -> None:
    within(
        off,
        allowed,
        f"{bench.name}: {variable} jumps by {off:.3g} of its largest value where {where}; allowed: {allowed:.2g}; "
        "declare decides = True if the stage rounds, counts or chooses",
    )


def may_be_walked(bench: Bench) -> bool:
    return bench.steady and not decides(bench.stage) and all(d.dtype == "float" for d in bench.writes.values())


def treats_places_alone(bench: Bench) -> bool:
    """Return whether each output value depends on the input at the same place only: it stays the same if places are
    permuted or neighbours change.
    """
    framed = [port for port, d in bench.reads.items() if d.dims[-2:] == ("y", "x")]
    if any(d.dims[-2:] != ("y", "x") for d in bench.writes.values() if {"y", "x"} & set(d.dims)):
        return False
    inputs = bench.arrays("decades", PROOF)
    order = np.random.default_rng(11).permutation(PROOF[0] * PROOF[1])

    def moved(array: Array) -> Array:
        return array.reshape(*array.shape[:-2], -1)[..., order].reshape(array.shape)

    other = {port: moved(array) if port in framed else array for port, array in inputs.items()}
    half = {port: array.copy() for port, array in inputs.items()}
    for port in framed:
        half[port][..., PROOF[0] // 2 :, :] *= 50.0
    first, second, third = (tried(bench, one, PROOF) for one in (inputs, other, half))
    if first is None or second is None or third is None:
        return False
    for variable in by_place(bench):
        own, turned, beside = (np.asarray(one.arrays[variable], float) for one in (first, second, third))
        if own.shape[-2:] != PROOF:
            return False
        top = BY_ITSELF * np.abs(own).max(axis=tuple(range(own.ndim - 2)), initial=0.0)
        upper = slice(0, PROOF[0] // 2)
        if (np.abs(moved(own) - turned) > moved(top)).any():
            return False
        if (np.abs(own - beside)[..., upper, :] > top[..., upper, :]).any():
            return False
    return True


def frames(bench: Bench, port: str) -> Iterator[Path]:
    """Yield paths of a stage that treats each place independently: a frame of one row holds many points of a path."""
    names, depth = by_place(bench), bench.reads[port].dims[:-2]
    one = bench.arrays("ordinary", (1, 1))[port]

    def walked(lit: Callable[[Array], Array]) -> Walk:
        def walk(places: Array) -> Sequence[Results | None]:
            frame = (1, len(places))
            inputs = bench.arrays("uniform", frame)
            trial = tried(bench, {**inputs, port: lit(places)}, frame)
            if trial is None:
                return [None] * len(places)
            found = [np.moveaxis(np.asarray(trial.arrays[name], float)[..., 0, :], -1, 0) for name in names]
            return [dict(zip(names, values, strict=True)) for values in zip(*found, strict=True)]

        return walk

    even = np.full_like(one, bench.scale(port))
    yield "uniform, times", FINE, walked(lambda t: even * t), FINE_WORTH
    if not depth:
        return
    yield "of an ordinary colour, times", FINE, walked(lambda t: one * t), FINE_WORTH
    for plane in range(min(one.shape[0], 3)):
        alone = np.zeros_like(one)
        alone[plane] = one[plane]
        yield (
            f"plane {plane} alone, times",
            FINE_FADING,
            walked(lambda t, alone=alone: one - alone + alone * t),  # type: ignore[misc]
            FINE_WORTH,
        )


def paths(bench: Bench, port: str) -> Iterator[Path]:
    """Yield paths of any stage, with one run for each point of a path."""
    even, ordinary = bench.arrays("uniform", SMALL), bench.arrays("ordinary", SMALL)

    def walked(lit: Callable[[float], Arrays]) -> Walk:
        return lambda places: [results(tried(bench, lit(float(t)), SMALL)) for t in places]

    yield "uniform, times", LIGHT, walked(lambda t: {**even, port: even[port] * t}), WORTH
    yield "of an ordinary picture, times", LIGHT, walked(lambda t: {**ordinary, port: ordinary[port] * t}), WORTH

    def shining(t: float) -> Arrays:
        array = np.array(ordinary[port])
        array[..., 2, 2] = t * bench.scale(port)
        return {**ordinary, port: array}

    yield "one place, in full scales,", LIGHT, walked(shining), WORTH
    for plane in range(min(even[port].shape[0], 3)) if even[port].ndim == 3 else ():

        def fading(t: float, plane: int = plane) -> Arrays:
            array = np.array(ordinary[port])
            array[plane] *= t
            return {**ordinary, port: array}

        yield f"plane {plane} alone, times", FADING, walked(fading), WORTH


def of_codes(bench: Bench, port: str) -> None:
    """Check that the step from each code to the next lies between the steps before and after it, so that no code is
    lost or doubled.
    """
    side = 256
    codes = np.broadcast_to(np.arange(side * side).reshape(side, side), bench.array(port, "zeros", (side, side)).shape)
    trial = tried(bench, {port: codes}, (side, side))
    error = 2 * stated(bench, {port: codes}, (side, side)) + LEAST
    for variable in by_place(bench) if trial else ():
        assert trial is not None
        for values in np.asarray(trial.arrays[variable], float).reshape(-1, side * side):
            step = np.diff(values)
            low, high = np.minimum(step[:-2], step[2:]), np.maximum(step[:-2], step[2:])
            scale = np.maximum(np.abs(values[1:-2]), 1e-3 * np.abs(values).max()) + SMALLEST
            off = np.maximum(low - step[1:-1], step[1:-1] - high) / scale
            worst = int(off.argmax())
            judge(
                bench, variable, max(float(off[worst]), 0.0), error, f"{port} steps from code {worst + 1} to the next"
            )


def along_entries(bench: Bench, port: str) -> None:
    """Search for jumps while one of the first three numbers of an input without positions fades, such as the white
    level of a channel.
    """
    ordinary = bench.arrays("ordinary", SMALL)
    allowed = 2 * stated(bench, ordinary) + LEAST
    for entry in range(min(ordinary[port].size, 3)):

        def faded(t: float, entry: int = entry) -> Arrays:
            array = np.array(ordinary[port])
            array.flat[entry] *= t
            return {**ordinary, port: array}

        def walk(places: Array, faded: Callable[[float], Arrays] = faded) -> Sequence[Results | None]:
            return [results(tried(bench, faded(float(t)), SMALL)) for t in places]

        for variable, (off, low, _) in jumps_along(walk, FADING, by_place(bench), allowed, WORTH).items():
            judge(bench, variable, off, allowed, f"{port}, entry {entry} alone, times {low:.9g}")


def continuous_in_parameters(bench: Bench) -> None:
    """Search for jumps over the whole range of every numeric parameter, except at values declared as ``apart``. Other
    parameters that are ordinarily 0 get small values, since a 0 might switch off the effect under test.
    """
    if not bench.reads or bench.looks or bench.given_grids or not may_be_walked(bench):
        return
    inputs = bench.arrays("ordinary", SMALL)
    dear = is_transfer(bench.kind) or bench.kind.prepare is not Stage.prepare
    ordinary, bench = bench.stage, awake(cheaper(bench) if dear else bench)
    if stated(bench, inputs) > VAGUE:
        untried(f"no parameter was varied: a jump could not be distinguished from the stated error, {VAGUE:g} or more")
        return
    for name, (parameter, kind, _) in parameters_of(bench.kind).items():
        span, own = span_of(parameter, kind, getattr(ordinary, name)), getattr(ordinary, name)
        if span is not None and dear and not math.isfinite(own):
            untried(f"{name} was not varied: its ordinary value is {own:g}")
        elif span is not None:
            continuous_in(bench, name, nearer(span, own) if dear else span, inputs, dear)


def continuous_in(bench: Bench, name: str, span: tuple[float, float], inputs: Arrays, dear: bool) -> None:
    """Search for jumps over a range of one numeric parameter, with fewer values for slow stages."""
    points, worth, rank = DEAR if dear else OFTEN
    (low, high), apart = span, parameters_of(bench.kind)[name][0].apart
    ways = [np.linspace(low, high, points)]
    if low > 0 and high > 20 * low:
        ways = [*([] if dear else ways), np.geomspace(low, high, points)]

    def at(value: float) -> Bench:
        stage = dataclasses.replace(bench.stage, **{name: float(value)})
        return Bench(stage, bench.given_grids or bench.input_grids(SMALL), bench.scales)

    def walk(places: Array) -> Sequence[Results | None]:
        return [at_value(at, float(t), inputs) for t in places]

    def error(value: float) -> float:
        try:
            return stated(at(value), inputs)
        except ValueError:  # refused
            return 0.0

    for values in ways:
        beside = np.unique(values[~np.isin(values, apart)])
        least = min(error(float(values[0])), error(float(values[-1]))) + LEAST
        for variable, (off, first, last) in jumps_along(walk, beside, by_place(bench), least, worth, rank).items():
            judge(bench, variable, off, error(first) + error(last) + LEAST, f"{name} = {first:.9g}")
    for value in NICE[: 1 if bench.kind.prepare is not Stage.prepare else None]:
        if low < value < high and value not in apart:
            beside_a_whole_number(bench, walk, value, name, error)


def cheaper(bench: Bench) -> Bench:
    """Return the bench of the stage with each knob at the cheapest setting that does not increase the stated error."""
    stage, inputs = bench.stage, bench.arrays("ordinary", SMALL)
    for name, (parameter, _, _) in parameters_of(bench.kind).items():
        for value in parameter.settings[:1] if parameter.fidelity else ():
            try:
                other = dataclasses.replace(stage, **{name: value})
                if stated(Bench(other, bench.given_grids, bench.scales), inputs) <= max(stated(bench, inputs), LEAST):
                    stage = other
            except ValueError:  # it refuses the setting
                continue
    return Bench(stage, bench.given_grids, bench.scales, bench.coordinates)


def awake(bench: Bench) -> Bench:
    """Return a bench in which numbers that are ordinarily 0 have small values instead, as many of them as the stage
    accepts together. Numbers whose 0 has a special meaning are not changed.
    """
    now = {name: getattr(bench.stage, name) for name in parameters_of(bench.kind)}
    wanted = {
        name: mixed.numbers(parameter, 0.0, 1, place)
        for place, (name, (parameter, kind, _)) in enumerate(parameters_of(bench.kind).items())
        if kind is float and now[name] == 0 and 0 not in parameter.apart and not parameter.fidelity
    }
    wanted = {name: found for name, found in wanted.items() if found}
    found = mixed.as_many(bench.kind, now, wanted, mixed.computes)
    return Bench(bench.kind(**found), bench.given_grids, bench.scales, bench.coordinates)


def nearer(span: tuple[float, float], now: float) -> tuple[float, float]:
    """Return the part of a range up to ten times the ordinary value; if this is 0, up to a hundredth of the range."""
    low, high = span
    size = 10 * abs(now) or 0.01 * max(abs(low), abs(high))
    return (max(low, size / 100 if low > 0 else -size), min(high, size)) if low < size and high > -size else span


def at_value(at: Callable[[float], Bench], value: float, inputs: Arrays) -> Results | None:
    try:
        return results(tried(at(value), inputs, SMALL))
    except ValueError:
        return None


def beside_a_whole_number(bench: Bench, walk: Walk, value: float, name: str, error: Callable[[float], float]) -> None:
    """Compare the results at a value for which the stage may use a special formula and at a value close to it."""
    own, near = walk(np.array([value, value * (1 + BESIDE)]))
    for variable in by_place(bench) if own and near else ():
        assert own is not None
        assert near is not None
        if own[variable].shape != near[variable].shape:
            continue
        one, other = (np.asarray(trial[variable], dtype=float) for trial in (own, near))
        off = ratio_of(float(np.abs(one - other).max(initial=0.0)), float(np.abs(one).max(initial=0.0)))
        within(
            off,
            error(value) + error(value * (1 + BESIDE)) + LEAST,
            f"{bench.name}: {variable} with {name} = {value:g} is {off:.3g} of its largest value from the result with "
            f"{value * (1 + BESIDE):.12g}: the special formula for this value does not agree with the general formula",
        )


def tried(bench: Bench, inputs: Arrays, frame: Frame) -> BenchTrial | None:
    try:
        trial = bench.run(inputs, frame=frame)
    except ValueError:
        return None
    return trial if trial.done else None


def results(trial: BenchTrial | None) -> Mapping[str, Array] | None:
    return None if trial is None else trial.arrays
