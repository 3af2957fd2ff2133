"""Steps of a stage that rounds: their width, and the position of each code within its step.

In:  a ``Bench``.
Out: nothing, or ``LawBroken``.
"""

from __future__ import annotations

import numpy as np

from etendue.archive.read.differing import full_scale
from etendue.contract.capabilities import Sampled, is_random
from etendue.testing.bench import Bench, Frame
from etendue.testing.means import mean_of
from etendue.testing.measured import ratio_of, within
from etendue.types.arrays import Array

FRAME: Frame = (96, 128)
FEW = 16  # number of codes below which a straight line cannot be distinguished from steps
STAIRS = 0.2  # share of evenly spread values; a stage rounds if it gives fewer different results
OFFSET = 0.08  # of a code; the mean over 12,288 places has an error of 0.003
STRAIGHT = 0.45  # rms of codes about a line; rounding alone has 0.289
SPANS = ((0.02, 0.9), (1e-4, 0.05), (1e-7, 1e-3), (0.5, 20.0))  # of full scale


def codes_in_the_middle(bench: Bench) -> None:
    """For evenly spread input, compare the step widths with the stated error, and the codes with the stated mean or a
    straight line through whole numbers.
    """
    framed = [p for p, d in bench.reads.items() if {"y", "x"} <= set(d.dims) and d.dtype == "float"]
    main = next((v for v, d in bench.writes.items() if {"y", "x"} <= set(d.dims)), None)
    if not framed or main is None or is_random(bench.kind) or bench.given_grids or bench.looks:
        return
    port = framed[0]
    for low, high in SPANS:
        shares = np.random.default_rng(5).permutation(np.linspace(low, high, FRAME[0] * FRAME[1])).reshape(FRAME)
        codes = codes_of(bench, port, main, shares)
        if codes is None:
            continue
        inside = (codes > codes.min()) & (codes < codes.max())
        levels = np.unique(codes[inside])
        if levels.size < FEW:
            continue
        if levels.size < STAIRS * inside.sum():
            check_width(bench, main, codes, levels)
        whole = bench.writes[main].dtype != "float" and bench.writes[main].unit != "1"
        if whole and bench.one_array and bench.reads[port].dims == ("y", "x"):
            check_place(bench, port, main, shares[inside], codes[inside], inside)


def codes_of(bench: Bench, port: str, main: str, shares: Array) -> Array | None:
    """Return the last plane of the result for the input ``shares``, given as fractions of full scale; None if the stage
    refuses the input or changes the size of the frame.
    """
    inputs = bench.arrays("uniform", FRAME)
    inputs[port] = np.broadcast_to(shares * bench.scale(port), inputs[port].shape).copy()
    try:
        trial = bench.run(inputs, frame=FRAME)
    except ValueError:
        return None
    if not trial.done or trial.arrays[main].shape[-2:] != FRAME:
        return None
    return np.asarray(trial.arrays[main], dtype=float).reshape(-1, *FRAME)[-1]


def check_width(bench: Bench, main: str, codes: Array, levels: Array) -> None:
    stated = bench.own_error(bench.arrays("ordinary", FRAME), "float64", FRAME)
    width = float(np.median(np.diff(levels)))
    even = bench.run(bench.arrays("uniform", FRAME), frame=FRAME)
    full = bench.full_scale(main, codes, FRAME)
    share = ratio_of(width, max(full, full_scale(even.arrays[main])) if even.done else full)
    if stated is not None:
        within(
            share,
            2.2 * stated,
            f"{bench.name}: {main} moves in steps of {width:.4g}, {share:.2g} of full scale, but error() states "
            f"{stated:.2g}: this is smaller than half a step, the error of rounding",
        )


def check_place(bench: Bench, port: str, main: str, shares: Array, codes: Array, inside: Array) -> None:
    if issubclass(bench.kind, Sampled):
        full = np.zeros(FRAME)
        full[inside] = shares * bench.scale(port)
        off = float((codes - np.asarray(mean_of(bench, {port: full}, FRAME)[main], float)[inside]).mean())
        what = "from mean() on average over evenly spread input: round to the nearest code"
    else:
        line = np.polynomial.Polynomial.fit(shares, codes, 1).convert()
        if float((codes - line(shares)).std()) > STRAIGHT:
            return  # no straight line, or steps of several codes
        offset = float(line.coef[0])
        off = offset - round(offset)
        what = (
            "from a whole number where the line through evenly spread input begins: round to the nearest code, or "
            "state the mean (Sampled)"
        )
    within(abs(off), OFFSET, f"{bench.name}: {main} is {off:+.3g} codes {what}")
