"""Shapley values: the axioms that make them the only ones, and pairs that they predict."""

import itertools
import math

import numpy as np
import pytest

from etendue_lab.losses.games import Game
from etendue_lab.losses.shapley import shares
from etendue_lab.losses.study import LossReport

NAMES = ("a", "b", "c", "d", "e")


def random_game(seed, most=5):
    rng = np.random.default_rng(seed)
    parts = {frozenset(c): rng.normal() for n in range(1, most + 1) for c in itertools.combinations(NAMES, n)}
    return lambda present: 3.0 + sum(v for names, v in parts.items() if names <= present)


@pytest.mark.parametrize("seed", range(4))
def test_values_sum_to_what_all_bring_and_are_the_mean_over_orders(seed):
    game = random_game(seed)
    found = shares(game, NAMES)
    assert found.values.sum() == pytest.approx(found.total)
    assert (found.coalitions, found.orders) == (32, 0)
    mean = dict.fromkeys(NAMES, 0.0)
    for order in itertools.permutations(NAMES):
        for i, name in enumerate(order):
            mean[name] += (game(frozenset(order[: i + 1])) - game(frozenset(order[:i]))) / math.factorial(5)
    np.testing.assert_allclose(found.values, [mean[n] for n in NAMES], atol=1e-12)


def test_who_brings_nothing_is_owed_nothing_and_equals_are_owed_the_same():
    found = shares(lambda present: float(len(present - {"e"}) ** 2), NAMES)
    assert found.values[4] == 0
    assert np.ptp(found.values[:4]) < 1e-12
    assert not found.interactions[4].any()


@pytest.mark.parametrize("seed", range(4))
def test_pairs_are_predicted_exactly_where_no_three_work_together(seed):
    game = random_game(seed, most=2)
    found, every = shares(game, NAMES), frozenset(NAMES)
    for one, other in itertools.combinations(NAMES, 2):
        assert found.of_pair(one, other) == pytest.approx(game(every) - game(every - {one, other}))


def test_random_orders_find_values_within_their_standard_errors():
    """600 pairs of orders; five errors of 600 draws are exceeded once in a million."""
    game = random_game(9)
    exact, sampled = shares(game, NAMES), shares(game, NAMES, most=31)
    assert sampled.orders == 2
    assert sampled.coalitions <= 31
    assert sampled.values.sum() == pytest.approx(exact.total)
    names = tuple("abcdefghijkl")
    weights = np.arange(1.0, 13.0)
    curved = shares(lambda p: math.sqrt(sum(weights[names.index(n)] for n in p)), names, most=2000)
    assert curved.values.sum() == pytest.approx(math.sqrt(78))
    whole = shares(lambda p: math.sqrt(sum(weights[names.index(n)] for n in p)), names, most=4096)
    assert np.all(np.abs(curved.values - whole.values) < 5 * curved.errors)


def test_nobody_and_too_few_coalitions():
    assert shares(lambda present: 1.0, ()).total == 0
    with pytest.raises(ValueError, match="at least"):
        shares(lambda present: 1.0, NAMES, most=4)
    with pytest.raises(ValueError, match="differ"):
        shares(lambda present: 1.0, ("a", "a"))


def test_shares_of_all_that_is_lost_sum_to_one_whatever_others_bring_back():
    """A stage that betters the picture, such as a sharpening, has a negative share of the others' loss."""
    worth = {"lens": 3.0, "pixel": 1.0, "sharpen": -2.0}
    found = shares(lambda present: sum(worth[name] for name in present), tuple(worth))
    game = Game("contrast", "dB", "mean contrast", found, 1.0, 0.8, {}, {})
    rows = {row["stage"]: row["share"] for row in LossReport("camera", 0.18, [game]).document()["losses"][0]["stages"]}
    assert rows == {"lens": pytest.approx(0.75), "pixel": pytest.approx(0.25), "sharpen": pytest.approx(-0.5)}
