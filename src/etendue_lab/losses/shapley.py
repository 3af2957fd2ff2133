"""Shares of a joint effect: Shapley values, and interactions of pairs of players.

In:  the value of every coalition of players.
Out: a value for each player; the values sum to the value of all players together. An interaction index for each pair.
Sources: Shapley 1953; Grabisch and Roubens 1999 (interaction index); Castro et al. 2009 (sampled orders).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Value = Callable[[frozenset[str]], float]


@dataclass(frozen=True)
class Shares:
    """Each player's share of ``total``."""

    players: tuple[str, ...]
    values: NDArray[np.float64]  # (player,)
    interactions: NDArray[np.float64]  # (player, player), symmetric; < 0 if one effect hides the other
    errors: NDArray[np.float64]  # (player,) standard errors; 0 if all coalitions were evaluated
    total: float
    coalitions: int  # number evaluated
    orders: int  # number sampled; 0: all coalitions

    @cached_property
    def order(self) -> dict[str, int]:
        return {name: number for number, name in enumerate(self.players)}

    @property
    def gross(self) -> float:
        """Sum of the positive values: the effect before other players reduce it."""
        return float(self.values[self.values > 0].sum())

    def of_pair(self, one: str, other: str) -> float:
        """Return the predicted decrease of the total if two players leave, from Shapley values and interactions.

        The prediction is phi_i + phi_j + half the sum of the interactions of players i and j with all others. It is
        exact if no three players interact.
        """
        i, j = self.order[one], self.order[other]
        others = [k for k in range(len(self.players)) if k not in (i, j)]
        shared = 0.5 * float(self.interactions[i, others].sum() + self.interactions[j, others].sum())
        return float(self.values[i] + self.values[j]) + shared


def shares(value: Value, players: Sequence[str], most: int = 64, seed: int = 0) -> Shares:
    """Return Shapley values, exact if there are at most ``most`` coalitions, else from random orders of the players.

    Parameters
    ----------
    value : callable
        Function that returns the value of a coalition, the empty one included. Called at most once for each coalition.
    players : names, all different
    most : int
        Maximum number of coalitions to evaluate.
    seed : int
        Seed of the random orders; orders are used in pairs of an order and its reverse.

    Raises
    ------
    ValueError
        A name occurs twice, or ``most`` does not allow a single pair of orders.
    """
    names, known = tuple(players), {}
    if len(set(names)) < len(names):
        raise ValueError(f"players are {', '.join(names)}; names must differ")

    def asked(mask: int) -> float:
        if mask not in known:
            known[mask] = float(value(frozenset(n for i, n in enumerate(names) if mask >> i & 1)))
        return known[mask]

    n, everyone = len(names), (1 << len(names)) - 1
    exact = 2**n <= most
    values, interactions, errors, orders = (
        (*_exact(asked, n), np.zeros(n), 0) if exact else _sampled(asked, n, most, seed)
    )
    return Shares(names, values, interactions, errors, asked(everyone) - asked(0), len(known), orders)


def fewest(players: int) -> int:
    """Return the largest number of coalitions that one order and its reverse require, including those for interactions
    of adjacent players.
    """
    return 2 * (2 * players - 1)


def _exact(asked: Callable[[int], float], n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    values, interactions = np.zeros(n), np.zeros((n, n))
    alone = [math.factorial(s) * math.factorial(n - s - 1) / math.factorial(n) for s in range(n)]
    paired = [math.factorial(s) * math.factorial(n - s - 2) / math.factorial(n - 1) for s in range(n - 1)]
    for mask in range(1 << n):
        size = mask.bit_count()
        absent = [i for i in range(n) if not mask >> i & 1]
        for i in absent:
            values[i] += alone[size] * (asked(mask | 1 << i) - asked(mask))
        for i, j in combinations(absent, 2):
            both = asked(mask | 1 << i | 1 << j) - asked(mask | 1 << i) - asked(mask | 1 << j) + asked(mask)
            interactions[i, j] += paired[size] * both
    return values, interactions + interactions.T


def _sampled(
    asked: Callable[[int], float], n: int, most: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Sample orders of the players. Record the value that each player adds to the players before it, and for adjacent
    players also their joint effect.
    """
    each = fewest(n)
    pairs = most // each
    if pairs < 1:
        raise ValueError(f"most is {most}; {n} players need at least {each} coalitions")
    rng, added = np.random.default_rng(seed), np.zeros((pairs, n))
    together, counted = np.zeros((n, n)), np.zeros((n, n))
    for number in range(pairs):
        forward = rng.permutation(n)
        for order in (forward, forward[::-1]):
            mask = 0
            for position, i in enumerate(order):
                gain = asked(mask | 1 << int(i)) - asked(mask)
                added[number, i] += 0.5 * gain
                if position + 1 < n:
                    j = order[position + 1]
                    both = (
                        asked(mask | 1 << int(i) | 1 << int(j))
                        - asked(mask | 1 << int(i))
                        - asked(mask | 1 << int(j))
                        + asked(mask)
                    )
                    for a, b in ((i, j), (j, i)):
                        together[a, b] += both
                        counted[a, b] += 1
                mask |= 1 << int(i)
    interactions = np.divide(together, counted, out=np.zeros_like(together), where=counted > 0)
    error = added.std(axis=0, ddof=1) / math.sqrt(pairs) if pairs > 1 else np.full(n, math.nan)
    return added.mean(axis=0), interactions, error, 2 * pairs
