"""Random draws compared with the declaration of a stage: mean, variance, and independence of places and of draws.

In:  a ``Bench``.
Out: nothing, or ``LawBroken``.

``P`` is the probability that one call rejects a correct stage, one in a million; it is divided among the comparisons of
the call. A million draws reveal a mean that is wrong by a hundredth of the standard deviation, and a variance that is
wrong by one percent.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from etendue.contract import wording
from etendue.contract.capabilities import Noisy, Sampled, draws_anew, is_random, rounds
from etendue.contract.stage import patterns_of
from etendue.testing.bench import Bench, Frame
from etendue.testing.checks import bound_of
from etendue.testing.means import mean_of, missed
from etendue.testing.measured import hold, ratio_of, within
from etendue.testing.seeds import seed_of
from etendue.types.arrays import Array

P = 1e-6
FRAME: Frame = (448, 512)
DRAWS = 4  # frames at one level; two if a frame has several planes
PLANES = 3
LEVELS = (0.0, 1e-5, 3e-4, 2.5e-3, 3.3e-3, 0.1, 0.5)  # of full scale
ROUNDED = 1e-13  # relative spread that rounding explains
RARE = 30.0  # kurtosis above which a few events dominate the sums, which are then not normally distributed
NEAR: tuple[Frame, ...] = ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))


def z_of(p: float) -> float:
    """Return how many standard deviations a normal variable exceeds, on either side, with probability ``p``."""
    from scipy.stats import norm

    return float(norm.isf(p / 2))


def drawn_as_declared(bench: Bench) -> None:
    """Draw frames at several levels, compare mean and variance of each level with the declaration, and test whether
    places or draws are correlated.
    """
    port = next((p for p, d in bench.reads.items() if d.dims[-2:] == ("y", "x")), None)
    if port is None or not is_random(bench.kind) or bench.given_grids or bench.looks:
        return
    main = next((v for v, d in bench.writes.items() if d.dims[-2:] == ("y", "x") and d.unit != "1"), None) or next(
        (v for v, d in bench.writes.items() if d.dims[-2:] == ("y", "x") and d.dtype == "float"), None
    )
    if main is None:
        return
    inputs = even(bench, port, FRAME, LEVELS[-1])  # a large frame: in a small one, rare events may just not occur
    first, second = (draw(bench, inputs, number) for number in range(2))
    if first is None or second is None or np.array_equal(first[main], second[main]):
        return
    by_line = bool(getattr(bench.kind, "by_line", False))
    for level in LEVELS:
        check_level(bench, port, main, level, by_line)


def even(bench: Bench, port: str, frame: Frame, level: float) -> dict[str, Array]:
    """Return uniform inputs; the input ``port`` is ``level`` times full scale, rounded if it holds codes."""
    array = bench.array(port, "uniform", frame) * level
    whole = bench.reads[port].dtype != "float"
    return {**bench.arrays("uniform", frame), port: np.rint(array) if whole else array}


def check_level(bench: Bench, port: str, main: str, level: float, by_line: bool) -> None:
    """Check the draws of each plane, and the correlation of successive planes, at one level."""
    inputs = even(bench, port, FRAME, level)
    value = float(np.asarray(inputs[port]).flat[0])
    expected: dict[str, Array] | None = None
    if issubclass(bench.kind, Sampled):
        expected = mean_of(bench, even(bench, port, (2, 3), level), (2, 3))
    frames = []
    for number in range(DRAWS if len(bench.reads[port].dims) == 2 else 2):
        trial = draw(bench, inputs, number)
        if trial is None or trial[main].shape[-2:] != FRAME:
            return
        frames.append(trial[main])
    every = np.array(frames, dtype=float)
    planes = every.reshape(len(frames), -1, *FRAME).swapaxes(0, 1)
    said = None if expected is None or main not in expected else np.asarray(expected[main], float).reshape(-1, 2, 3)
    for number, found in enumerate(planes[:PLANES]):
        check_plane(bench, port, main, value, found, None if said is None else float(said[number].mean()), by_line)
        if number:
            check_planes(bench, main, value, planes[number - 1], found)


def check_planes(bench: Bench, main: str, value: float, one: Array, other: Array) -> None:
    """Check that successive planes are uncorrelated."""
    one, other = one - one.mean(), other - other.mean()
    scale = float(one.std() * other.std())
    off = abs(ratio_of(float((one * other).mean()), scale)) if scale else 0.0
    within(
        off,
        z_of(P / len(LEVELS) / PLANES) / math.sqrt(one.size),
        f"{bench.name}: {main} at {value:g} has a correlation of {off:.3g} between two planes: draw numbers for each",
    )


def check_plane(
    bench: Bench, port: str, main: str, value: float, found: Array, said: float | None, by_line: bool
) -> None:
    inputs = bench.arrays("uniform", (2, 3))
    spread = float(found.std())
    if spread <= ROUNDED * max(value, float(np.abs(found).max())):
        return  # nothing is drawn at this level
    tests = len(LEVELS) * (len(NEAR) + 6)
    z = z_of(P / tests)
    share = bound_of(bench, inputs, "float64")  # the mean and the variance that the stage states
    if said is not None:
        check_means(bench, found, said, main, value, z, share, by_line)
    if isinstance(bench.stage, Noisy):
        check_variances(bench, found, port, main, value, z, share, by_line)
    rare = float((((found - found.mean()) / spread) ** 4).mean()) > RARE
    if not by_line and not rare:
        check_independence(bench, found, main, value, z)


def draw(bench: Bench, inputs: Any, number: int) -> dict[str, Array] | None:
    """Return the outputs for seed ``number``; fixed patterns also differ between seeds. None if the stage refuses the
    inputs.
    """
    trial = bench.run(inputs, "float64", FRAME, seed=seed_of(f"statistics {number}"))
    return trial.arrays if trial.done else None


def check_means(
    bench: Bench, found: Array, said: float, main: str, value: float, z: float, share: float, by_line: bool
) -> None:
    count = found.size / (min(found.shape[-2:]) if by_line else 1)
    error = found.std() / math.sqrt(count)
    rounded = 0.5 if rounds(bench.kind) else 0.0  # codes at one level
    room = z * error + share * abs(found.std()) + 1e-12 * abs(said) + rounded + missed(found, P / len(LEVELS))
    off = abs(float(found.mean()) - said)
    within(
        ratio_of(off, float(found.std())),
        ratio_of(room, float(found.std())),
        f"{bench.name} gives {main} = {found.mean():.7g} on average over {found.size} draws at {value:g}, but mean() "
        f"is {said:.7g}, {off / error:.3g} standard errors from it",
    )


def check_variances(
    bench: Bench, found: Array, port: str, main: str, value: float, z: float, share: float, by_line: bool
) -> None:
    """Compare the measured variance with the stated one if input and output have the same unit; another law tests the
    other stages.
    """
    stage: Any = bench.stage
    if bench.writes[main].unit != bench.reads[port].unit:
        units = wording.units()
        if not (bench.writes[main].unit in units and units[bench.writes[main].unit].noise):
            return
    charge = float(found.mean())
    told = float(stage.variance(charge))
    apart = found - found.mean()
    measured = float((apart**2).mean())
    kurtosis = max(1.5, float((apart**4).mean()) / measured**2)
    count = found.size / (max(found.shape[-2:]) * DRAWS if by_line else 1)
    room = z * math.sqrt((kurtosis - 1) / count) + 2 * share + (1.0 if by_line else 0.0)
    off = ratio_of(abs(measured - told), told)
    within(
        off,
        room,
        f"{bench.name}.variance states {told:.6g} at {value:g}, but {found.size} draws have {measured:.6g}, "
        f"{100 * off:.2g} % from it; the tolerance is {100 * room:.2g} %",
    )


def check_independence(bench: Bench, found: Array, main: str, value: float, z: float) -> None:
    """Check that there is no correlation between places at any displacement, along rows or columns, or between
    successive draws.
    """
    apart = found - found.mean()
    variance = float((apart**2).mean())
    for down, right in NEAR:
        one = apart[:, : apart.shape[1] - down, max(0, -right) : apart.shape[2] - max(0, right)]
        other = apart[:, down:, max(0, right) : apart.shape[2] + min(0, right)]
        off = float((one * other).mean()) / variance
        within(
            abs(off),
            z / math.sqrt(one.size),
            f"{bench.name}: {main} at {value:g} has a correlation of {off:.3g} between places {down} rows and {right} "
            "columns apart; declare by_line = True if lines share it, or draw a number for each place",
        )
    for axis, word in ((2, "rows"), (1, "columns")):
        lines = apart.mean(axis=axis)
        ratio = float((lines**2).mean()) * apart.shape[axis] / variance - 1
        within(
            abs(ratio),
            z * math.sqrt(2 / lines.size) * 1.2,
            f"{bench.name}: the means of {word} of {main} at {value:g} vary {ratio:+.2g} times more than independent "
            "draws; declare by_line = True if lines share the noise",
        )
    plane = apart[0]
    power = np.abs(np.fft.rfft2(plane)) ** 2
    every = np.fft.irfft2(power, plane.shape) / (plane.size * float((plane**2).mean()))
    every[0, 0] = 0.0
    largest = float(np.abs(every).max())
    place = np.unravel_index(int(np.abs(every).argmax()), every.shape)
    within(
        largest,
        z_of(P / (plane.size * len(LEVELS))) / math.sqrt(plane.size / 2),
        f"{bench.name}: {main} at {value:g} repeats its draws {place[0]} rows and {place[1]} columns further: a "
        f"correlation of {largest:.3g}",
    )
    if draws_anew(bench.kind):
        across = float((apart[0] * apart[1]).mean()) / variance
        patterned = bool(patterns_of(bench.kind))
        hold(
            patterned or abs(across) <= z / math.sqrt(apart[0].size),
            f"{bench.name}: {main} at {value:g} of two draws has a correlation of {across:.3g}",
        )
