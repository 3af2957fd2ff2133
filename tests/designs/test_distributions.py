"""Quantiles, shares and densities of one distribution agree; moments in closed form; levels and correlations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from etendue.contract.values.parameter import Parameter
from etendue.plan.designs.distributions import distribution_of, level_share
from etendue.plan.designs.points import unit_points

WRITTEN = {
    "uniform": ({"from": 2, "to": 6}, 4, 16 / 12),
    "log": ({"from": 1, "to": np.e, "spacing": "log"}, np.e - 1, (np.e**2 - 1) / 2 - (np.e - 1) ** 2),
    "normal": ({"normal": [3, 0.3]}, 3, 0.09),
    "triangular": ({"triangular": [0, 1, 4]}, 5 / 3, (0 + 1 + 16 - 0 - 0 - 4) / 18),
    "half normal": ({"normal": [0, 1], "at_least": 0}, (2 / np.pi) ** 0.5, 1 - 2 / np.pi),
    "cut triangle": ({"triangular": [0, 0, 1], "at_most": 0.5}, None, None),
}


def of(written, parameter=None, kind=float):
    return distribution_of(written, parameter or Parameter(), kind, Path())


@pytest.mark.parametrize("name", WRITTEN)
def test_quantile_share_and_density_are_one_distribution(name):
    one = of(WRITTEN[name][0])
    shares = np.linspace(0.02, 0.98, 25)
    values = [one.quantile(share) for share in shares]
    np.testing.assert_allclose([one.share_below(value) for value in values], shares, atol=1e-9)
    for low, high in ((values[3], values[11]), (values[11], values[20])):
        assert quad(one.density, low, high)[0] == pytest.approx(one.share_below(high) - one.share_below(low), abs=1e-7)


@pytest.mark.parametrize("name", [name for name in WRITTEN if WRITTEN[name][1] is not None])
def test_moments_are_those_of_the_closed_form(name):
    """The middles of 20,000 strata: what is left in the tails is below the tolerance."""
    written, mean, variance = WRITTEN[name]
    values = np.array([of(written).quantile((n + 0.5) / 20_000) for n in range(20_000)])
    assert values.mean() == pytest.approx(mean, rel=2e-4, abs=2e-4)
    assert values.var() == pytest.approx(variance, rel=2e-3)


def test_there_is_one_level_in_every_stratum():
    one = of({"normal": [3, 0.3], "levels": 4})
    found = sorted({one.quantile(share) for share in np.linspace(0, 1, 999)})
    shares = [of({"normal": [3, 0.3]}).share_below(value) for value in found]
    out = 1 / 96  # the outer two are moved outward by 1/24 of a stratum
    np.testing.assert_allclose(shares, [0.125 - out, 0.375, 0.625, 0.875 + out])
    assert [sum(a <= v < b for v in found) for a, b in zip(one.edges(), one.edges()[1:], strict=False)] == [1] * 4
    assert level_share(0.3, 1) == 0.5


@pytest.mark.parametrize("levels", [8, 16, 64])
def test_the_mean_over_levels_is_of_third_order(levels):
    """exp(3 u): the error is the closed form, but for its next order; middles alone would be 5.6 times as far off at 8
    levels and 41 times at 64.
    """
    mean = np.exp([3 * level_share((n + 0.5) / levels, levels) for n in range(levels)]).mean()
    expected = -23 / 1152 * 9 * (1 + np.exp(3)) / levels**3
    assert mean - (np.exp(3) - 1) / 3 == pytest.approx(expected, rel=3 / levels)


def test_whole_numbers_and_choices():
    whole = of({"from": 8, "to": 14}, kind=int)
    assert {whole.quantile(share) for share in np.linspace(0, 1, 99)} <= set(range(8, 15))
    assert whole.most == 7
    three = of(["a", "b", "c"], kind=str)
    assert [three.quantile(share) for share in (0.1, 0.5, 0.9)] == [0, 1, 2]


def test_a_tighter_spread_keeps_the_centre():
    for written in ({"normal": [3, 0.3]}, {"from": 2, "to": 6}, {"triangular": [1, 2, 4]}):
        one = of(written)
        tight = one.tightened(0.1)
        shares = np.array([0.1, 0.3, 0.8])
        own, tighter = ([d.quantile(share) for share in shares] for d in (one, tight))
        np.testing.assert_allclose(np.array(tighter) - one.centre, 0.9 * (np.array(own) - one.centre), rtol=1e-9)


def test_correlated_shares_are_uniform_and_correlated_as_asked():
    matrix = ((1.0, 0.7), (0.7, 1.0))
    shares = unit_points("sobol", 4096, 2, 1, matrix)
    for column in shares.T:
        assert np.abs(np.sort(column) - (np.arange(4096) + 0.5) / 4096).max() < 0.02
    rank = 6 / np.pi * np.arcsin(0.7 / 2)  # of a Gaussian copula
    assert np.corrcoef(shares.T)[0, 1] == pytest.approx(rank, abs=0.01)
