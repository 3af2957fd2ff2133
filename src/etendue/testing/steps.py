"""Codes: where they stand in their steps, and how wide the steps are.

In:  a ``Bench`` whose stage writes whole numbers.
Out: nothing, or ``LawBroken``.
"""

from __future__ import annotations

import numpy as np

from etendue.contract.capabilities import Sampled, is_random
from etendue.testing.bench import Bench, Frame
from etendue.testing.laws.knob_laws import mean_of
from etendue.testing.measured import ratio_of, within

FRAME: Frame = (96, 128)
FEW = 16  # codes below which a line cannot be told from steps
OFFSET = 0.08  # of a code; the mean over 12,288 places has an error of 0.003
STRAIGHT = 0.45  # rms of codes about a line; rounding alone has 0.289
SPANS = ((0.02, 0.9), (1e-4, 0.05), (1e-7, 1e-3), (0.5, 20.0))  # of full scale


def codes_in_the_middle(bench: Bench) -> None:
    """Compare codes of evenly spread input with the stated mean, or with a straight line through whole numbers."""
    port = bench.one_array
    main = next((v for v, d in bench.writes.items() if d.dtype != "float" and d.unit != "1"), None)
    if port is None or main is None or bench.reads[port].dims != ("y", "x") or is_random(bench.kind):
        return
    if bench.reads[port].dtype != "float":
        return
    stated = bench.own_error(bench.arrays("ordinary", FRAME), "float64", FRAME)
    for low, high in SPANS:
        shares = np.random.default_rng(5).permutation(np.linspace(low, high, FRAME[0] * FRAME[1])).reshape(FRAME)
        inputs = {port: shares * bench.scale(port)}
        trial = bench.run(inputs, frame=FRAME)
        if not trial.done:
            continue
        codes = np.asarray(trial.arrays[main], dtype=float)
        if codes.shape != FRAME:
            return
        inside = (codes > codes.min()) & (codes < codes.max())
        levels = np.unique(codes[inside])
        if levels.size < FEW:
            continue
        dense = np.diff(levels).max() if np.diff(levels).max() < 0.1 * np.ptp(levels) else 0.0
        if stated is not None and levels.size < 0.2 * inside.sum():
            share = ratio_of(float(dense), bench.full_scale(main, codes, FRAME))
            within(
                share,
                2 * stated * 1.1,
                f"{bench.name}: {main} moves in steps of {dense:g}, {share:.2g} of full scale, but error() states "
                f"{stated:.2g}, less than half of a step",
            )
        if issubclass(bench.kind, Sampled):
            away = (codes - np.asarray(mean_of(bench, inputs, FRAME)[main], float))[inside]
            off = float(away.mean())
            within(
                abs(off),
                OFFSET,
                f"{bench.name}: {main} is {off:+.3g} codes from mean() on average over evenly spread input: round to "
                "the nearest code",
            )
            continue
        line = np.polynomial.Polynomial.fit(shares[inside], codes[inside], 1).convert()
        if float((codes[inside] - line(shares[inside])).std()) > STRAIGHT:
            continue  # no straight line
        offset = float(line.coef[0])
        off = offset - round(offset)
        within(
            abs(off),
            OFFSET,
            f"{bench.name}: {main} of evenly spread input lies on a line that begins {off:+.3g} codes from a whole "
            "number: round to the nearest code, or state the mean (Sampled)",
        )
