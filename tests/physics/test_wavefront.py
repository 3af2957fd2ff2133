"""Laws of aberrated wavefronts: orthonormality, symmetry, the Strehl ratio, defocus."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats, integers
from numpy.testing import assert_allclose

from etendue_camera.optics import pupil, wavefront
from etendue_camera.optics.wavefront import (
    Seidel,
    ansi_order,
    defocus,
    noll_order,
    rms,
    zernike,
    zernike_orders,
)


def disc(radial=32, angular=64):
    """Nodes and weights that average polynomials up to order 63 over the unit disc exactly."""
    nodes, weights = np.polynomial.legendre.leggauss(radial)
    rho = np.sqrt(0.5 * (1 + nodes))[:, None]
    angle = 2 * np.pi * np.arange(angular) / angular
    return (
        rho * np.sin(angle),
        rho * np.cos(angle),
        np.broadcast_to(0.5 * weights[:, None] / angular, (radial, angular)),
    )


@pytest.mark.parametrize("index", ["noll", "ansi"])
def test_zernike_terms_to_order_20_are_orthonormal_over_the_disc(index):
    y, x, weights = disc()
    terms = np.array([zernike(n, m, y, x) for n, m in zernike_orders(231, index)])
    gram = np.einsum("arc,brc,rc->ab", terms, terms, weights)
    # products of polynomials of order 40, exact but for rounding of values up to 9
    assert_allclose(gram, np.eye(231), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("n", "m", "written_out"),
    [
        (2, 0, lambda y, x: math.sqrt(3) * (2 * (x * x + y * y) - 1)),
        (2, 2, lambda y, x: math.sqrt(6) * (x * x - y * y)),
        (2, -2, lambda y, x: math.sqrt(6) * 2 * x * y),
        (3, 1, lambda y, x: math.sqrt(8) * (3 * (x * x + y * y) - 2) * x),
        (3, -3, lambda y, x: math.sqrt(8) * (3 * x * x * y - y**3)),
        (4, 0, lambda y, x: math.sqrt(5) * (6 * (x * x + y * y) ** 2 - 6 * (x * x + y * y) + 1)),
    ],
)
def test_low_terms_are_those_of_the_books(n, m, written_out):
    y, x, _ = disc(8, 16)
    assert_allclose(zernike(n, m, y, x), written_out(y, x), rtol=0, atol=1e-14)


@given(n=integers(0, 60), y=floats(-0.7, 0.7), x=floats(-0.7, 0.7))
def test_high_orders_stay_bounded_by_their_value_at_the_edge(n, y, x):
    # |R_n^m| <= 1 inside the disc: the sum of factorials would have left that by order 40
    m = n % 2
    assert abs(zernike(n, m, np.array(y), np.array(x))) <= math.sqrt((n + 1) * (2 if m else 1)) * (1 + 1e-12)


def test_indices_run_through_every_term_once_and_start_as_published():
    # Noll 1976 table I, and ANSI Z80.28
    assert [noll_order(j) for j in range(1, 12)] == [
        (0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2), (3, -1), (3, 1), (3, -3), (3, 3), (4, 0),
    ]  # fmt: skip
    assert [ansi_order(j) for j in range(7)] == [(0, 0), (1, -1), (1, 1), (2, -2), (2, 0), (2, 2), (3, -3)]
    every = {(n, m) for n in range(21) for m in range(-n, n + 1, 2)}
    assert set(zernike_orders(231, "noll")) == set(zernike_orders(231, "ansi")) == every


def zernike_sum(coefficients, y, x):
    orders = zernike_orders(len(coefficients))
    return sum(value * zernike(n, m, y, x) for value, (n, m) in zip(coefficients, orders, strict=True))


def strehl_ratio(amplitude, path, wavelength):
    return abs(np.sum(amplitude * np.exp(2j * np.pi / wavelength * path)) / amplitude.sum()) ** 2


def test_the_rms_of_a_sum_is_the_root_of_the_sum_of_squares():
    y, x, weights = disc()
    coefficients = (0.4, 0.0, 0.03, -0.05, 0.02, 0.0, 0.01, 0.04)
    path = zernike_sum(coefficients, y, x)
    expected = math.sqrt(sum(c * c for c in coefficients[1:]))  # piston does not count
    assert_allclose(rms(weights, path), expected, rtol=1e-13)


@given(angle=floats(0, 2 * math.pi), y=floats(-1, 1), x=floats(-1, 1))
def test_seidel_terms_turn_with_the_image_point(angle, y, x):
    terms = Seidel(0.3, 0.2, -0.4, 0.1)
    c, s = math.cos(angle), math.sin(angle)
    turned = terms.at(s * x + c * y, c * x - s * y, 0.8 * c, -0.8 * s)
    # a few roundings of terms of order 1
    assert_allclose(turned, terms.at(y, x, 0.8, 0.0), rtol=0, atol=1e-14)


def test_seidel_terms_are_the_zernike_terms_that_the_textbook_says():
    y, x, _ = disc(8, 16)
    # rho^4 = 1/3 + Z4/(2 sqrt 3) + Z11/(6 sqrt 5); rho^3 cos = Z8/(3 sqrt 8) + 2/3 Z2/2
    spherical = zernike_sum((1 / 3, 0, 0, 1 / (2 * math.sqrt(3)), 0, 0, 0, 0, 0, 0, 1 / (6 * math.sqrt(5))), y, x)
    assert_allclose(Seidel(w040=1.0).at(y, x, 0, 0), spherical, rtol=0, atol=1e-14)
    coma = zernike_sum((0, 1 / 3, 0, 0, 0, 0, 0, 1 / (3 * math.sqrt(8))), y, x)
    assert_allclose(Seidel(w131=1.0).at(y, x, 0, 1), coma, rtol=0, atol=1e-14)


@given(f_number=floats(1.0, 64.0), shift=floats(-500, 500))
def test_defocus_tends_to_its_paraxial_coefficient_in_the_middle_of_the_pupil(f_number, shift):
    rho = 1e-3
    path = defocus(shift, f_number, np.array(rho), np.array(0.0))
    # the next term is rho^2/(16 N^2) relative
    assert_allclose(path, shift / (8 * f_number**2) * rho * rho, rtol=rho * rho / 15, atol=1e-300)


def test_the_paraxial_defocus_is_short_by_three_per_cent_at_the_edge_at_f_1_4():
    exact = float(defocus(1.0, 1.4, np.array(1.0), np.array(0.0)))
    # (1 - cos t)/(sin^2 t / 2) - 1 = (1 - cos t)/(1 + cos t), the leading term 1/(16 N^2) = 3.19 %
    cosine = math.sqrt(1 - 1 / 2.8**2)
    assert_allclose(exact * 8 * 1.4**2 - 1, (1 - cosine) / (1 + cosine), rtol=1e-13)
    assert 0.032 < exact * 8 * 1.4**2 - 1 < 0.035


def test_defocus_keeps_its_digits_at_slow_apertures():
    # 1 - cos t would hold 4 digits here
    assert_allclose(defocus(1.0, 1e6, np.array(1.0), np.array(0.0)), 1 / 8e12, rtol=1e-13)


@pytest.mark.parametrize("term", [(2, 0), (2, 2), (3, 1), (4, 0), (5, -3)])
def test_strehl_ratio_falls_as_maréchal_says_to_the_fourth_power_of_the_rms(term):
    y, x, weights = disc()
    mode = zernike(*term, y, x)
    gaps = []
    for sigma in (0.02, 0.04):
        ratio = strehl_ratio(weights, sigma * mode, 1.0)
        gaps.append(abs(ratio - math.exp(-((2 * math.pi * sigma) ** 2))))
        # third and fourth moments of a polynomial of rms 1: at most a few times the sigma to that power
        assert gaps[-1] < 10 * (2 * math.pi * sigma) ** 4
    # an odd third moment is of fourth order in the ratio too: doubling sigma costs a factor of 16, or more where
    # moments cancel
    assert gaps[1] / gaps[0] > 10


def test_strehl_ratio_of_defocus_is_its_closed_form():
    rho, weights = np.polynomial.legendre.leggauss(40)
    square = 0.5 * (1 + rho)
    for waves in (0.25, 0.5, 1.0):
        # integral of exp(2 pi i W rho^2) over the disc: sinc^2(W), dark at one wave
        ratio = strehl_ratio(0.5 * weights, waves * square, 1.0)
        assert_allclose(ratio, np.sinc(waves) ** 2, rtol=0, atol=1e-14)


def test_strehl_ratio_does_not_mind_piston():
    cells = pupil.amplitude(pupil.Aperture("polygonal", blades=5), 40)
    path = np.random.default_rng(1).normal(0, 0.05, cells.shape)
    assert_allclose(strehl_ratio(cells, path + 17.3, 0.55), strehl_ratio(cells, path, 0.55), rtol=1e-12)
    assert_allclose(rms(cells, path + 17.3), rms(cells, path), rtol=1e-12)


def test_nonsense_is_refused_by_name():
    with pytest.raises(ValueError, match="n is 3 and m is 2"):
        zernike(3, 2, 0.0, 0.0)
    with pytest.raises(ValueError, match="j is 0"):
        noll_order(0)
    with pytest.raises(ValueError, match="index is 'fringe'"):
        zernike_orders(3, "fringe")
    with pytest.raises(ValueError, match="shift is inf"):
        defocus(math.inf, 2.8, 0.0, 0.0)
    with pytest.raises(ValueError, match="f_number is 0.5"):
        defocus(1.0, 0.5, np.array(1.2), np.array(0.0))
    with pytest.raises(ValueError, match="amplitude sums to 0"):
        wavefront.rms(np.zeros((2, 2)), np.zeros((2, 2)))
