"""Splines and roots, which metrics of resolution are read with, against scipy's."""

import numpy as np
import pytest
import scipy.interpolate
import scipy.optimize
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.resolution import roots
from etendue_camera.resolution.contrast import search_nodes
from etendue_camera.resolution.spline import through


@pytest.mark.parametrize("nodes", [2, 3, 4, 48, 512, 4096])
def test_a_spline_is_that_of_scipy_and_so_is_its_integral(nodes):
    places = search_nodes(4.0, nodes)
    curves = np.stack([np.exp(-3 * places**2), np.abs(np.sinc(3 * places)), np.sinc(5 * places) ** 2], axis=1)
    other, x = scipy.interpolate.CubicSpline(places, curves), np.linspace(0, 4, 3001)
    for i, own in enumerate(through(places, curves)):
        assert_allclose(own(x), other(x)[:, i], rtol=0, atol=1e-13)
        for low, high in ((0.0, 4.0), (0.3, 0.31), (1.7, 4.0)):
            assert_allclose(own.integral(low, high), other.integrate(low, high)[i], rtol=0, atol=1e-13)


def test_a_spline_through_two_places_is_refused():
    with pytest.raises(ValueError, match="at least 3 places"):
        through(np.array([0.0, 1.0]), np.zeros((2, 1)))


@given(root=st.floats(-3, 3), power=st.sampled_from([1, 3, 5]), bend=st.floats(-1.5, 1.5), within=st.floats(1e-14, 0.1))
def test_a_root_is_no_farther_away_than_asked(root, power, bend, within):
    """Rising through the root with any power and bend, in at most three times the evaluations of bisection."""
    seen = []

    def rising(x):
        seen.append(x)
        return (x - root) ** power * np.exp(bend * x)

    found = roots.between(rising, -5.0, 4.0, within)
    assert abs(found - root) <= within + 1e-14
    assert len(seen) <= 3 * np.log2(9 / within) + 20


def test_a_root_is_that_of_brentq():
    for low, high in ((2.0, 3.0), (5.0, 6.0), (8.5, 9.0)):
        own = roots.between(scipy.special.j0, low, high, 1e-13)
        assert_allclose(own, scipy.optimize.brentq(scipy.special.j0, low, high), rtol=1e-13)


def test_equal_signs_are_refused():
    with pytest.raises(ValueError, match="must differ in sign"):
        roots.between(lambda x: 1.0, 0.0, 1.0, 1e-3)
