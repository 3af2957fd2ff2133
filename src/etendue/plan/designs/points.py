"""Points of a design in the unit cube, one column per factor, drawn with ``scipy.stats.qmc``.

In:  method, number of points and factors, seed, correlations.
Out: the cumulative probability of each factor, by row. The first rows of a longer design equal the rows of a shorter
     design, except for a Latin hypercube.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache

from etendue.plan.designs.distributions import level_share
from etendue.types.arrays import Array

METHODS = ("sobol", "halton", "random", "lhs", "saltelli", "list")
EXTENDED = tuple(method for method in METHODS if method != "lhs")
TINY = 2.0**-33  # a share of 0 has no quantile


def rows_of(method: str, points: int, factors: int) -> int:
    """Return the number of rows of a design with this number of points; for Saltelli's design, this counts all rows
    that belong to a base point.
    """
    return points * (factors + 2) if method == "saltelli" else points


@lru_cache(8)
def unit_points(method: str, points: int, factors: int, seed: int, correlated: tuple[tuple[float, ...], ...]) -> Array:
    """Return cumulative probabilities, (row, factor); ``correlated``: the matrix of correlations, () for none."""
    import numpy as np

    if method == "saltelli":
        both = _drawn("sobol", points, 2 * factors, seed)
        first, second = both[:, :factors], both[:, factors:]
        mixed = np.repeat(first[:, None], factors, axis=1)
        mixed[:, range(factors), range(factors)] = second
        found = np.concatenate([first[:, None], second[:, None], mixed], axis=1).reshape(-1, factors)
    else:
        found = _drawn(method, points, factors, seed)
    found = np.clip(found, TINY, 1 - TINY)
    if correlated:
        from scipy.special import ndtr, ndtri

        found = ndtr(ndtri(found) @ np.linalg.cholesky(np.array(correlated)).T)
    found.setflags(write=False)
    return np.asarray(found)


def positive(matrix: Sequence[Sequence[float]]) -> bool:
    """Return whether factors can have all these correlations at the same time."""
    import numpy as np

    return float(np.linalg.eigvalsh(np.array(matrix)).min()) > 1e-9


def _drawn(method: str, points: int, factors: int, seed: int) -> Array:
    import numpy as np
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    if method == "random":
        return generator.random((points, factors))
    engines = {"sobol": qmc.Sobol, "halton": qmc.Halton, "lhs": qmc.LatinHypercube}
    with warnings.catch_warnings():  # the plan reports a number that is no power of 2
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(engines[method](factors, scramble=True, seed=generator).random(points))


def discrepancy(shares: Array, levels: Sequence[int]) -> tuple[float, float]:
    """Return the centred discrepancy of points, and the centred discrepancy of the same points after rounding to this
    number of levels per factor (0: not rounded).
    """
    from scipy.stats import qmc

    placed = shares.copy()
    for column, count in enumerate(levels):
        if count:
            placed[:, column] = [level_share(share, count) for share in shares[:, column].tolist()]
    return float(qmc.discrepancy(shares)), float(qmc.discrepancy(placed))
