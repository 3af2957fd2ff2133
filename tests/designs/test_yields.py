"""The yield of units whose yield is known in closed form, and what a tighter spread gains."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import pytest

from etendue.errors import RequestError
from etendue_lab.designs.yields import required, weights_of, wilson, yields
from tests.designs.given import samples

NORMAL = NormalDist()
SPREADS = {"a": {"normal": [10, 2]}, "b": {"normal": [5, 1]}}


def units(method="random", points=400, seed=0, factors=SPREADS, correlated=()):
    return samples(lambda a, b: {"sum": a + b, "a_alone": a}, method, points, seed, factors, correlated)


def truth(limit, tighter=0.0, correlation=0.0):
    """P(a + b >= limit) with the spread of a smaller by a share."""
    s = 2 * (1 - tighter)
    return 1 - NORMAL.cdf((limit - 15) / (s**2 + 1 + 2 * correlation * s) ** 0.5)


def place(made, *requirements):
    return yields(made, required(requirements))["places"][0]


def test_the_interval_holds_the_yield():
    """Of 200 seeds at 95 %, fewer than 184 hold it with probability 2 %."""
    held = 0
    for seed in range(200):
        own = place(units(seed=seed), "sum >= 13")["yield"]
        held += own["low"] <= truth(13) <= own["high"]
    assert held >= 184


@pytest.mark.parametrize("correlation", [0.0, 0.6])
@pytest.mark.parametrize("levels", [0, 32])
def test_a_tighter_spread_gains_what_its_closed_form_says(levels, correlation):
    factors = {"a": {"normal": [10, 2], **({"levels": levels} if levels else {})}, "b": {"normal": [5, 1]}}
    correlated = ((1.0, correlation), (correlation, 1.0)) if correlation else ()
    if levels and correlation:
        pytest.skip("levels move the values of one factor alone, so that its correlation is of strata")
    made = units("sobol", 4096, 1, factors, correlated)
    found = {one["factor"]: one for one in place(made, "sum >= 13")["tighter"]}["a"]
    gain = truth(13, 0.1, correlation) - truth(13, 0, correlation)
    assert found["gain"]["low"] <= gain <= found["gain"]["high"]
    assert 0 < found["effective"] <= 4096 + 1e-6


def test_weights_are_one_on_average_and_all_one_without_a_change():
    made = units("sobol", 4096)
    for factor in made.factors:
        assert weights_of(made, factor).mean() == pytest.approx(1, abs=0.01)  # an integral over 4096 points
        np.testing.assert_allclose(weights_of(made, factor, 0.0), 1)


def test_what_fails_first_is_named():
    found = place(units(), "sum >= 13", "a_alone >= 1")
    assert [one["requirement"] for one in found["fails"]] == ["sum >= 13", "a_alone >= 1"]
    assert found["fails"][1]["failed"] == 0
    assert found["fails"][0]["alone"] == found["fails"][0]["failed"] == pytest.approx(1 - found["yield"]["value"])


def test_a_share_of_none_and_all():
    low, high = wilson(0, 100)
    assert low == 0 < high < 0.05
    assert wilson(100, 100) == (1 - high, 1)


def test_rows_of_saltelli_are_counted_once():
    made = units("saltelli", 64)
    assert place(made, "sum >= 13")["units"] == 128


@pytest.mark.parametrize("text", ["sum", "sum = 3", ">= 3", "sum >= 3 um", "none >= 3"])
def test_a_requirement_that_is_none(text):
    with pytest.raises(RequestError):
        place(units(), text)
