"""The place where a function changes its sign.

In:  a function of one number, two places where its signs differ.
Out: a root between them.
Source: Chandrupatla 1997, Advances in Engineering Software 28, 145: inverse quadratic interpolation where it is safe,
otherwise bisection.

``scipy.optimize.brentq`` finds the same roots. Its import takes 0.2 s, longer than the stage ``resolution`` takes for
one camera.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from etendue import require

EXACT = 4 * 2.0**-52  # relative width within which rounding hides the root
MOST = 200  # evaluations; bisection alone needs 60 for all digits


def between(f: Callable[[float], float], low: float, high: float, within: float) -> float:
    """Return a root of ``f`` between two places.

    Parameters
    ----------
    f : callable
        Its signs at ``low`` and ``high`` differ, or it is 0 at one of them.
    low, high : float
    within : float
        Allowed error of the root; at least 4 units in its last place are allowed in any case.

    Raises
    ------
    ValueError
        If the signs are equal.
    """
    a, b = high, low
    fa, fb = f(a), f(b)
    require.that(
        fa * fb <= 0 and math.isfinite(fa + fb),
        f"values at {low:g} and {high:g} must differ in sign; they are {fb:g} and {fa:g}",
    )
    c, fc, share = a, fa, 0.5
    for _ in range(MOST):
        best, least = (a, fa) if abs(fa) < abs(fb) else (b, fb)
        reach = 0.5 * within + EXACT * abs(best)
        if least == 0 or abs(b - a) <= 2 * reach:
            return best
        edge = reach / abs(b - a)
        x = a + min(max(share, edge), 1 - edge) * (b - a)
        fx = f(x)
        if (fx > 0) == (fa > 0):
            c, fc = a, fa
        else:
            c, b, fc, fb = b, a, fb, fa
        a, fa = x, fx
        share = _next(a, b, c, fa, fb, fc)
    return best


def _next(a: float, b: float, c: float, fa: float, fb: float, fc: float) -> float:
    """Return the next place to evaluate, as a fraction of the way from ``a`` to ``b``."""
    if fb == fc or fa == fb or fa == fc:
        return 0.5
    place, level = (a - b) / (c - b), (fa - fb) / (fc - fb)
    if not (level * level < place and (1 - level) ** 2 < 1 - place):
        return 0.5
    return fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
