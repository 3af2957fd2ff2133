"""Continuity over the whole of a range: along paths of brightness, of one channel, of one place, of every parameter.

In:  a ``Bench``.
Out: nothing, or ``LawBroken`` that says where a result jumps, and by how much.

A path is walked in steps; the steps that stand out from their neighbours are divided again and again. What is left of
the change when a step is a billionth of its place is a jump. It may be the errors that a stage states on
both sides. Stages that ``decide`` or write whole numbers jump by nature; ``steps`` measures theirs.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator

import numpy as np

from etendue.contract.capabilities import is_transfer
from etendue.contract.stage import Stage, parameters_of
from etendue.testing.bench import SMALL, Arrays, Bench, BenchTrial
from etendue.testing.cases import span_of
from etendue.testing.measured import ratio_of, within
from etendue.testing.small_changes import jumps
from etendue.types.arrays import Array

LIGHT = np.concatenate([[0.0], np.geomspace(1e-9, 1e4, 261)])  # of full scale
FADING = np.concatenate([[0.0], np.geomspace(1e-12, 4.0, 61)])
PARTS = 8  # into which a step is divided
DEPTH = 11  # divisions: 8^11 = 9e9
FALLS = 4  # divisions over which the change at a jump stays as large, and that of a root does not
WORTH = 4  # steps of a path that are looked into
LEAST = 1e-6  # of full scale; what a smooth stage with a condition number of 1,000 changes over a billionth
POINTS = 33  # values of a parameter, evenly spread, and as many by equal factors
RANK = 4.0  # how many times more than its neighbours a step must bend to be looked into
DEAR = (9, 1, 40.0)  # the same, steps and rank for a stage that prepares tables or is a transfer function
NICE = (2.0, 0.5, 1.0, 3.0, 1.5, 4.0, 5.0, 2.5, 6.0, 8.0)  # values for which code may have a formula of its own
BESIDE = 1e-9
Walk = Callable[[float], BenchTrial | None]
Errors = Callable[[float], float]  # what a stage states at a place of a path


def stated(bench: Bench, inputs: Arrays) -> float:
    """Return the error that a stage states; 0 if it states none."""
    return bench.own_error(inputs, "float64", SMALL) or 0.0


def continuous_in_light(bench: Bench) -> None:
    """Uniform light over thirteen decades; an ordinary picture; one channel that fades; one place that shines."""
    if (
        not bench.reads
        or bench.looks
        or bench.given_grids
        or jumps(bench)
        or is_transfer(bench.kind)
        or not bench.steady
    ):
        return
    for port, declaration in bench.reads.items():
        if declaration.dtype != "float" or not {"y", "x"} <= set(declaration.dims):
            continue
        for word, places, walk, base in paths(bench, port):
            error = stated(bench, base)
            follow(bench, walk, places, f"{port}, {word},", lambda t, error=error: error)  # type: ignore[misc]


def paths(bench: Bench, port: str) -> Iterator[tuple[str, Array, Walk, Arrays]]:
    even, ordinary = bench.arrays("uniform", SMALL), bench.arrays("ordinary", SMALL)
    scale = bench.scale(port)

    def scaled(base: Arrays) -> Walk:
        return lambda t: tried(bench, {**base, port: base[port] * t})

    yield "uniform, times", LIGHT, scaled(even), even
    yield "of an ordinary picture, times", LIGHT, scaled(ordinary), ordinary

    def shining(t: float) -> BenchTrial | None:
        array = np.array(ordinary[port])
        array[..., 2, 2] = t * scale
        return tried(bench, {**ordinary, port: array})

    yield "one place, in full scales,", LIGHT, shining, ordinary
    for plane in range(min(even[port].shape[0], 3)) if even[port].ndim == 3 else ():

        def fading(t: float, plane: int = plane) -> BenchTrial | None:
            array = np.array(ordinary[port])
            array[plane] *= t
            return tried(bench, {**ordinary, port: array})

        yield f"plane {plane} alone, times", FADING, fading, ordinary


def continuous_in_parameters(bench: Bench) -> None:
    """Every number of a stage over the whole of its range, but for values that are declared to stand ``apart``."""
    if not bench.reads or bench.looks or bench.given_grids or jumps(bench) or not bench.steady:
        return
    inputs = bench.arrays("ordinary", SMALL)
    dear = is_transfer(bench.kind) or bench.kind.prepare is not Stage.prepare
    points, worth, rank = DEAR if dear else (POINTS, 2, RANK)
    for name, (parameter, kind, _) in parameters_of(bench.kind).items():
        span = span_of(parameter, kind, getattr(bench.stage, name))
        if span is None:
            continue
        low, high = span
        ways = [np.linspace(low, high, points)]
        if low > 0 and high > 20 * low:
            ways.append(np.geomspace(low, high, points))

        def at(value: float, name: str = name) -> Bench:
            stage = dataclasses.replace(bench.stage, **{name: float(value)})
            return Bench(stage, bench.given_grids or bench.input_grids(SMALL), bench.scales)

        def walk(value: float, at: Callable[[float], Bench] = at) -> BenchTrial | None:
            try:
                return tried(at(value), inputs)
            except ValueError:
                return None

        def error(value: float, at: Callable[[float], Bench] = at) -> float:
            return stated(at(value), inputs)

        for values in ways:
            beside = values[~np.isin(values, parameter.apart)]
            follow(bench, walk, beside, f"{name} =", error, worth, rank)
        for value in NICE[:: 3 if dear else 1]:
            if low < value < high and value not in parameter.apart:
                beside_a_whole_number(bench, walk, value, name, error)


def beside_a_whole_number(bench: Bench, walk: Walk, value: float, name: str, error: Errors) -> None:
    """Compare a number for which there may be a formula of its own with the next ones."""
    own, near = walk(value), walk(value * (1 + BESIDE))
    for variable, d in bench.writes.items() if own and near else ():
        if not {"y", "x"} <= set(d.dims) or own.arrays[variable].shape != near.arrays[variable].shape:  # type: ignore[union-attr]
            continue
        one, other = (np.asarray(trial.arrays[variable], dtype=float) for trial in (own, near))  # type: ignore[union-attr]
        off = ratio_of(float(np.abs(one - other).max(initial=0.0)), float(np.abs(one).max(initial=0.0)))
        within(
            off,
            error(value) + error(value * (1 + BESIDE)) + LEAST,
            f"{bench.name}: {variable} with {name} = {value:g} is {off:.3g} of its largest value from that with "
            f"{value * (1 + BESIDE):.12g}: a formula for this value alone that does not agree with the general one",
        )


def tried(bench: Bench, inputs: Arrays) -> BenchTrial | None:
    try:
        trial = bench.run(inputs, frame=SMALL)
    except ValueError:
        return None
    return trial if trial.done else None


def follow(
    bench: Bench, walk: Walk, places: Array, word: str, error: Errors, worth: int = WORTH, rank: float = RANK
) -> None:
    """Walk a path, and look into the steps that stand out. A jump may be the sum of the errors stated on both sides."""
    places = np.unique(places)
    trials = [walk(float(t)) for t in places]
    for variable in (name for name, d in bench.writes.items() if {"y", "x"} <= set(d.dims)):  # others may be counts
        values = [None if one is None or variable not in one.arrays else one.arrays[variable] for one in trials]
        for step in outstanding(places, values, worth, rank):
            jump, (low, high) = narrowed(walk, variable, float(places[step]), float(places[step + 1]))
            off = ratio_of(*jump)
            allowed = error(low) + error(high) + LEAST
            within(
                off,
                allowed,
                f"{bench.name}: {variable} jumps by {off:.3g} of its largest value where {word} {low:.9g}; allowed: "
                f"{allowed:.2g}; declare decides = True if that is its nature",
            )


def outstanding(places: Array, values: list[Array | None], worth: int, rank_at_least: float) -> list[int]:
    """Return the steps whose change stands out from a cubic through those beside it."""
    table = np.array([summary(value) for value in values])
    valid = np.isfinite(table).all(axis=1)
    usable = valid[:-1] & valid[1:]
    found = [0] if places[0] == 0 and usable[:1].all() else []
    for column in range(table.shape[1]):
        change = np.where(usable, np.diff(table[:, column]), 0.0)
        wide = np.pad(change, 3, mode="edge")
        third = np.abs(wide[3:] - 3 * wide[2:-1] + 3 * wide[1:-2] - wide[:-3])  # of four neighbouring steps
        bent = np.minimum(third[1:-2], third[2:-1])  # both that have the step in their middle
        bent = bent[: change.size]
        around = np.pad(bent, 6, mode="reflect" if bent.size > 6 else "edge")
        quiet = np.array([np.median(around[n : n + 13]) for n in range(bent.size)])
        rank = np.where(usable, bent / (quiet + 1e-10), -1.0)
        found += [int(n) for n in np.argsort(-rank)[:worth] if rank[n] > rank_at_least]
    return list(dict.fromkeys(found))


def summary(value: Array | None) -> tuple[float, float, float]:
    """Return three numbers that jump where an array does: its largest value, and two weighted sums relative to it."""
    if value is None or not np.size(value):
        return (np.nan, np.nan, np.nan)
    array = np.asarray(value, dtype=float)
    top = float(np.abs(array).max())
    weights = np.cos(np.arange(array.size)).reshape(array.shape)
    shape = float((array * weights).sum()) / (top or 1.0)
    return (float(np.log(top)) if top > 0 else -700.0, shape, float(array.sum()) / (top or 1.0) / array.size)


def narrowed(walk: Walk, variable: str, low: float, high: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Divide a step, always keeping the part whose change differs most from that of the others."""
    jump, sizes = (0.0, 1.0), list[float]()
    known: dict[float, Array | None] = {}

    def at(t: float) -> Array | None:
        if t not in known:
            one = walk(t)
            known[t] = None if one is None else np.asarray(one.arrays[variable], dtype=float)
        return known[t]

    for _ in range(DEPTH):
        places = np.linspace(low, high, PARTS + 1)
        if np.unique(places).size < PARTS + 1:
            break
        values = []
        for t in places:
            value = at(float(t))
            if value is None:
                return (0.0, 1.0), (low, high)  # refused in between
            values.append(value)
        if any(value.shape != values[0].shape for value in values):
            return (0.0, 1.0), (low, high)
        changes = np.array([(after - before).ravel() for before, after in itertools.pairwise(values)])
        if not np.isfinite(changes).all():
            return (0.0, 1.0), (low, high)
        off = np.abs(changes - np.median(changes, axis=0)).max(axis=1, initial=0.0)
        part = int(off.argmax()) if off.max() > 0 else PARTS - 1
        low, high = float(places[part]), float(places[part + 1])
        scale = max(float(np.abs(values[part]).max(initial=0.0)), float(np.abs(values[part + 1]).max(initial=0.0)))
        jump = (float(np.abs(changes[part]).max(initial=0.0)), scale)
        sizes.append(jump[0])
        if ratio_of(*jump) < LEAST / 10:
            break
    if len(sizes) > FALLS and sizes[-1] < 0.5 * sizes[-1 - FALLS]:
        return (0.0, 1.0), (low, high)  # steep, as a root at 0, but smaller with every division
    return jump, (low, high)
