"""The measurements of the laws: bounds, gains, facts and parameter ranges compared with the behaviour of a stage.

In:  a ``Bench`` and its results.
Out: nothing, or ``LawBroken``.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from etendue.archive.read.differing import full_scale
from etendue.contract.arrays.facts import Facts
from etendue.contract.capabilities import is_source
from etendue.contract.stage import Stage, parameters_of
from etendue.contract.values import quantities
from etendue.contract.values.parameter import MISSING, Parameter
from etendue.contract.values.units import UnitError, parse_unit
from etendue.plan.wiring.parameters import Unfit, resolve
from etendue.testing.bench import (
    CLEAR,
    FRAME,
    ROUNDING,
    SMALL,
    Arrays,
    Bench,
    BenchTrial,
    Frame,
    LawBroken,
    facts_of,
    largest_difference,
)
from etendue.testing.measured import hold, magnified, ratio_of, told, within
from etendue.types.arrays import Array


def in_a_fresh_thread(bench: Bench, inputs: Arrays, precision: str) -> BenchTrial:
    found: list[BenchTrial] = []
    thread = threading.Thread(target=lambda: found.append(bench.run(inputs, precision)))
    thread.start()
    thread.join()
    hold(bool(found), f"{bench.name} cannot be computed in a fresh thread")
    return found[0]


def along_ladder(stage: Stage, name: str) -> Iterator[tuple[Any, Stage]]:
    """Yield each setting of a knob, with the stage at this setting, from the cheapest to the reference; refused
    settings are skipped.
    """
    for value in parameters_of(type(stage))[name][0].settings:
        try:
            yield value, dataclasses.replace(stage, **{name: value})
        except ValueError:
            continue


def with_value(array: Array, value: float) -> Array:
    """Return a copy with one value replaced."""
    changed = np.array(array, dtype=float)
    changed.flat[changed.size // 2] = value
    return changed


def levels_of(bench: Bench) -> Iterator[tuple[str, float]]:
    if not bench.reads:
        yield "ordinary", 1.0
        return
    yield from (("ordinary", 1.0), ("decades", 1.0), ("uniform", 1.0), ("ordinary", 1e-3), ("ordinary", 1e2))


def stated_error_of(bench: Bench, precision: str) -> tuple[float | None, str]:
    inputs = bench.arrays("ordinary")
    facts = bench.stage.describe()[0] if is_source(bench.kind) else bench.facts(inputs)  # type: ignore[attr-defined]
    answer = bench.stage.error(facts, bench.input_grids(), precision)
    hold(isinstance(answer, tuple) and len(answer) == 2, f"{bench.name}.error returned {answer!r}, not (bound, basis)")
    return answer


def bound_of(bench: Bench, inputs: Arrays, precision: str, otherwise: float = 0.0, frame: Frame = FRAME) -> float:
    bound = bench.own_error(inputs, precision, frame)
    return max(otherwise, bound or 0.0)


def must_survive(bench: Bench, inputs: Arrays, precision: str, frame: Frame, what: str) -> None:
    try:
        trial = bench.run(inputs, precision, frame)
    except ValueError:
        return  # the grid is refused before anything runs
    if trial.done:
        return
    message = trial.last_line
    name = type(bench.stage).__name__
    wrote = message.startswith((f"{name} wrote ", f"{name} gave ", f"{name} returned "))
    clear = message.startswith(CLEAR) or (trial.report.message == message and not wrote)
    hold(clear, f"{bench.name} on {what} input in {precision}: {message}")


def perturbations_of(shape: tuple[int, ...], worst: Array | None) -> Iterator[Array]:
    random = np.random.default_rng(7)
    yield random.uniform(-1.0, 1.0, shape)
    yield np.ones(shape)
    if worst is not None:
        yield worst
        yield -worst


def worst_signs_of(bench: Bench, port: str, main: str) -> Array | None:
    """Return, on a small frame, the signs of the derivatives of one output value with respect to each input value. The
    output value is the one whose derivatives have the largest sum of magnitudes.
    """
    base = np.full_like(bench.array(port, "uniform", SMALL), 0.5 * bench.scale(port))
    step = 1e-2 * bench.scale(port)
    reference = bench.result({port: base}, frame=SMALL).arrays[main].astype(float)
    columns = []
    for place in range(base.size):
        moved = base.copy()
        moved.flat[place] += step
        columns.append((bench.result({port: moved}, frame=SMALL).arrays[main].astype(float) - reference).ravel())
    derivative = np.array(columns)
    row = int(np.abs(derivative).sum(axis=0).argmax())
    return np.where(derivative[:, row] < 0, -1.0, 1.0).reshape(base.shape)


def check_gain(bench: Bench, port: str, main: str, inputs: Arrays, change: Array, frame: Frame) -> None:
    brightest = full_scale(inputs[port])
    other = inputs[port] + change * brightest
    if bench.reads[port].dtype != "float":
        other = np.clip(np.rint(other), 0, np.iinfo(bench.reads[port].dtype).max)
    elif bench.stage.negative != "keep":
        other = np.maximum(other, 0.0)
    apart_in = largest_difference(inputs[port], other) / brightest
    trials = [bench.run({port: array}, frame=frame) for array in (inputs[port], other, np.full_like(other, brightest))]
    if not all(trial.done for trial in trials):
        return
    first, second, uniform = (trial.arrays[main] for trial in trials)
    scale = max(bench.full_scale(main, first, frame), full_scale(uniform))
    apart = largest_difference(first, second)
    own = 2 * bound_of(bench, inputs, "float64", ROUNDING, frame)
    gain = bench.stage.gain
    assert gain is not None
    if apart_in > 1e-3:  # large enough that the growth is not the stage's own rounding
        magnified(ratio_of(apart, scale * apart_in))
    within(
        ratio_of(apart, scale),
        gain * apart_in * (1 + 1e-9) + own,
        f"{bench.name}: an error of {apart_in:.2g} of full scale in {port} became {ratio_of(apart, scale):.2g} of full "
        f"scale in {main}, "
        f"{ratio_of(apart, scale * apart_in):.3g} times as large, but gain is {gain:g}; declare a larger gain, or None",
    )


def check_facts(bench: Bench, facts: Facts, array: Array, slack: float, where: str) -> None:
    hold(isinstance(facts, Facts), f"{bench.name} returned {facts!r}; expected Facts")
    true = facts_of(array, bench.writes[next(iter(bench.writes))].dims)
    assert true.low is not None
    assert true.high is not None
    room = (slack + ROUNDING) * full_scale(array)
    beyond = max((facts.low or -math.inf) - true.low, true.high - (math.inf if facts.high is None else facts.high), 0.0)
    told(ratio_of(beyond, full_scale(array)), slack + ROUNDING)
    if facts.low is not None:
        hold(
            true.low >= facts.low - room,
            f"{bench.name} states a minimum of {facts.low:g}, but on {where} it writes {true.low:g}",
        )
    if facts.high is not None:
        hold(
            true.high <= facts.high + room,
            f"{bench.name} states a maximum of {facts.high:g}, but on {where} it writes {true.high:g}",
        )
    if facts.uniform:
        spread = np.ptp(np.asarray(array, dtype=float), axis=(-2, -1)).max() if np.ndim(array) >= 2 else 0.0
        hold(spread <= 2 * room, f"{bench.name} states uniform, but on {where} it writes values {spread:g} apart")
    if facts.contrast is not None and true.contrast is not None:
        hold(
            true.contrast <= facts.contrast * (1 + 1e-9 + 4 * slack),
            f"{bench.name} states a contrast of {facts.contrast:g}, but on {where} it writes {true.contrast:g}",
        )


def check_parameter(place: str, name: str, parameter: Parameter, kind: Any, default: Any, stage: Stage) -> None:
    field = next(f for f in dataclasses.fields(stage) if f.name == name)
    hold("parameter" in field.metadata, f"{place} is declared without param() or quantity(): no unit, no range")
    try:
        parse_unit(parameter.units or "1")
    except UnitError as error:
        raise LawBroken(f"{place}: {error}") from None
    hold(not parameter.fidelity or bool(parameter.reference), f"{place} is a fidelity parameter without a reference")
    for value in parameter.settings:
        try:
            resolve(value, parameter, kind, Path.cwd())
        except Unfit as error:
            raise LawBroken(f"{place}: its own setting {value!r} is refused: {error}") from None
    if parameter.shared and name in quantities.names():
        shared = quantities.quantity(name).metadata["parameter"]
        hold(
            shared.units == parameter.units,
            f"{place} is in {parameter.units}, the shared {name} in {shared.units}; use quantity()",
        )
    folder = Path.cwd()
    if default is not MISSING and not parameter.file and default != "":
        try:
            same = resolve(list(default) if isinstance(default, tuple) else default, parameter, kind, folder)
        except Unfit as error:
            raise LawBroken(f"{place}: its own default is refused: {error}") from None
        hold(same == default, f"{place}: its default {default!r} is read as {same!r}")
    for value in values_outside(parameter, kind):
        try:
            resolve(value, parameter, kind, folder)
        except Unfit:
            continue
        raise LawBroken(f"{place} accepts {value!r}, which is outside its range ({parameter.range_text()})")


def values_outside(parameter: Parameter, kind: Any) -> Iterator[Any]:
    """Yield values that must be refused."""
    numbers: list[Any] = []
    if parameter.above is not None:
        numbers.append(parameter.above)
    if parameter.below is not None:
        numbers.append(parameter.below)
    if parameter.at_least is not None:
        numbers.append(parameter.at_least - max(1.0, 1e-6 * abs(parameter.at_least)))
    if parameter.at_most is not None:
        numbers.append(parameter.at_most + max(1.0, 1e-6 * abs(parameter.at_most)))
    if parameter.choices:
        yield "no such choice"
    elif kind in (int, float):
        yield from (math.nan, "3 furlong", "text", True)
        if not parameter.infinite:
            yield math.inf
        yield from numbers
    elif parameter.length is not None:
        yield from ([number] * parameter.length for number in numbers)
        yield [0.5] * (parameter.length + 1)
