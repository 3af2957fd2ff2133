"""Laws on further declarations of a stage: order and sum of its values, added noise, and the digits that are lost in
solving with a matrix.

In:  a ``Bench``.
Out: nothing, or ``LawBroken``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from etendue.archive.read.differing import full_scale
from etendue.contract import wording
from etendue.contract.capabilities import Noisy
from etendue.testing.bench import LARGE, SMALL, Bench
from etendue.testing.checks import bound_of
from etendue.testing.digits import UNSTATED
from etendue.testing.measured import hold, magnified, ratio_of, within
from etendue.testing.seeds import seed_of
from etendue.types.arrays import Array

BRIGHTER = (1 + 1e-6, 1.01, 2.0, 1e3)
SIGMAS = 5.0  # tolerance of a measured variance: exceeded once in two million draws, and every run makes the same draws
SEEDS = 8  # for noise shared by lines, of which a frame has few
LEVELS = (1e-6, 1e-3, 0.1, 0.5)  # shares of full scale
LINEAR = 1e-9
STEP = 0.3  # step of a channel, from which a matrix is derived


def order_kept(bench: Bench) -> None:
    """Check that no value falls if the input rises, at one position or everywhere, apart from rounding."""
    port = frame_read(bench)
    if "order" not in bench.kind.keeps or port is None or not bench.steady:
        return
    for what in ("ordinary", "decades", "point", "zeros"):
        for level in (1e-6, 1.0, 1e3):
            inputs = bench.arrays(what, factor=level)
            base = bench.run(inputs)
            for factor in BRIGHTER:
                for change in (
                    inputs[port] * (factor - 1),
                    spot(inputs[port], (factor - 1) * bench.scale(port) * level),
                ):
                    more = inputs[port] + change
                    more = np.minimum(np.rint(more), 65535) if bench.reads[port].dtype != "float" else more
                    trial = bench.run({**inputs, port: more})
                    if base.done and trial.done:
                        check_order(
                            bench,
                            base.arrays,
                            trial.arrays,
                            f"{port} of {what} input x {level:g} rises by {factor - 1:g}",
                        )


def frame_read(bench: Bench) -> str | None:
    """Return the port of the only frame that a stage reads, apart from inputs without positions."""
    frames = [port for port, declaration in bench.reads.items() if {"y", "x"} <= set(declaration.dims)]
    return frames[0] if len(frames) == 1 and not bench.looks else None


def spot(array: Array, height: float) -> Array:
    found = np.zeros_like(array)
    found[tuple(size // 2 for size in found.shape)] = height
    return found


def check_order(bench: Bench, base: Mapping[str, Array], brighter: Mapping[str, Array], what: str) -> None:
    for variable, declaration in bench.writes.items():
        if not {"y", "x"} <= set(declaration.dims):
            continue
        before, after = (np.asarray(arrays[variable], dtype=float) for arrays in (base, brighter))
        fall = ratio_of(float(np.max(before - after, initial=0.0)), max(full_scale(before), full_scale(after)))
        within(
            fall,
            1e-14,
            f"{bench.name} declares keeps = 'order', but {variable} falls by {fall:.2g} of its maximum when {what}",
        )


def sum_kept(bench: Bench) -> None:
    """Check that the sum over the frame stays the same, for light far from its borders."""
    port = frame_read(bench)
    if "sum" not in bench.kind.keeps or port is None or not bench.steady:
        return
    main = next(iter(bench.writes))
    frame = (33, 35)
    inputs = bench.arrays("ordinary", frame)
    inputs[port] = np.zeros_like(inputs[port])
    inputs[port][..., 16, 17] = bench.scale(port)
    trial = bench.result(inputs, frame=frame)
    before, after = inputs[port].sum(), float(np.asarray(trial.arrays[main], dtype=float).sum())
    off = ratio_of(abs(after - before), before)
    allowed = bound_of(bench, inputs, "float64", 1e-12) * inputs[port].size
    within(
        off,
        allowed,
        f"{bench.name} declares that it keeps the sum, but changes the sum of a point in the middle of the frame by "
        f"{off:.2g}",
    )


def variance_told(bench: Bench) -> None:
    """Check that ``run`` adds the variance that ``Noisy.variance`` states. The input varies a little around each of
    several levels; the added variance is the variance of the output around a straight line over the input.

    Tolerance: five standard errors of a variance, from the fourth moment of the drawn values.
    """
    port = bench.one_array
    stage: Any = bench.stage
    if not isinstance(bench.stage, Noisy) or port is None or not {"y", "x"} <= set(bench.reads[port].dims):
        return
    main = next(variable for variable, d in bench.writes.items() if {"y", "x"} <= set(d.dims))
    for level in LEVELS:
        given, found = [], []
        for seed in range(SEEDS if stage.by_line else 1):
            inputs = bench.arrays("uniform", LARGE, level)
            random = np.random.default_rng([seed, 2])
            inputs[port] = inputs[port] * random.uniform(0.9, 1.1, inputs[port].shape)
            trial = bench.run(inputs, frame=LARGE, seed=seed_of(f"variance {seed}"))
            if not trial.done:
                return
            given.append(inputs[port])
            found.append(np.asarray(trial.arrays[main], dtype=float))
        check_variance(bench, np.array(given), np.array(found), bench.writes[main].unit, bool(stage.by_line))


def check_variance(bench: Bench, given: Array, found: Array, unit: str, by_line: bool) -> None:
    stage: Any = bench.stage
    name, said = next(((own, one.said) for own, one in wording.units().items() if one.noise), (unit, unit))
    slope = float(np.cov(given.ravel(), found.ravel(), ddof=0)[0, 1] / given.var())
    if (
        slope <= 0
        or not math.isfinite(slope)
        or (bench.writes[next(iter(bench.writes))].dtype != "float" and np.unique(found).size < 16)
    ):
        return  # clipped, or a step wider than the variation, for which rounding is not noise
    apart = found - slope * given
    counted = unit in wording.units() and wording.units()[unit].noise
    charge = float((found if counted else given).mean())
    told = float(stage.variance(charge))
    hold(math.isfinite(told) and told >= 0, f"{bench.name}.variance({charge:g}) is {told:g}")
    apart = apart - apart.mean()
    measured = float((apart**2).mean()) / (1.0 if counted else slope**2)
    kurtosis = max(3.0, float((apart**4).mean() / max((apart**2).mean() ** 2, 1e-300)))
    count = apart.size / (min(apart.shape[-2:]) if by_line else 1)
    allowed = SIGMAS * math.sqrt((kurtosis - 1) / count) + 0.01
    silent = told == 0 and measured <= 1e-12 * max(charge, 1e-300) ** 2
    off = 0.0 if silent else ratio_of(abs(measured - told), told)
    within(
        off,
        allowed,
        f"{bench.name}.variance states {told:.4g} {name}2 at {charge:.4g} {said}, but its draws have {measured:.4g}; "
        f"the tolerance is {100 * allowed:.2g} %",
    )


def matrix_told(bench: Bench) -> None:
    """Record the condition numbers of the matrices that a stage writes, and of its linear mapping from colours to
    colours.

    A table that may contain undefined values does not count as a matrix. A linear stage on channels is inverted: it
    must be possible to recover three colours as accurately as the condition number allows.
    """
    trial = bench.run(bench.arrays("ordinary"))
    for variable, d in bench.writes.items() if trial.done else ():
        if len(d.dims) == 2 and not d.nan and not {"y", "x", "frame", "stage"} & set(d.dims):
            magnified(float(np.linalg.cond(np.asarray(trial.arrays[variable], dtype=float))))
    _solved_back(bench)


def _solved_back(bench: Bench) -> None:
    port = next((p for p, d in bench.reads.items() if d.dims == ("channel", "y", "x")), None)
    main = next((v for v, d in bench.writes.items() if d.dims == ("channel", "y", "x")), None)
    if port is None or main is None or not bench.steady or bench.given_grids:
        return
    ordinary = bench.arrays("ordinary", SMALL)
    size = ordinary[port].shape[0]
    base = np.random.default_rng(3).uniform(0.3, 0.7, size)
    colours: list[Any] = [base, base * 0.9, *(base + STEP * unit for unit in np.eye(size))]
    found = []
    for colour in colours:
        one = bench.run(
            {**ordinary, port: np.broadcast_to(colour[:, None, None], ordinary[port].shape).copy()}, frame=SMALL
        )
        if not one.done or one.arrays[main].shape[0] != size:
            return
        found.append(np.asarray(one.arrays[main], dtype=float)[:, 1, 1])
    matrix = np.stack([(own - found[0]) / STEP for own in found[2:]], axis=1)
    scale = np.abs(found[0]).max()
    if not scale or np.abs(found[1] - 0.9 * found[0]).max() > LINEAR * scale or np.linalg.matrix_rank(matrix) < size:
        return  # not linear, or singular: no matrix to invert
    condition = float(np.linalg.cond(matrix))
    magnified(condition)
    back = np.linalg.solve(matrix, found[0])
    off = ratio_of(float(np.abs(back - base).max()), float(np.abs(base).max()))
    allowed = 10 * condition * UNSTATED["float64"]
    within(
        off,
        allowed,
        f"{bench.name}: its colours cannot be recovered: an error of {off:.2g}, more than a condition number of "
        f"{condition:.3g} explains",
    )
