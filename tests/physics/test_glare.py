"""Laws of veiling glare: light is kept, the tail is its own transform, the veil is the mean."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.strategies import floats
from numpy.testing import assert_allclose
from scipy.special import j0

from etendue_camera.optics.glare import glare_otf, tail_otf, tail_within

powers = floats(2.05, 10.0)


def tail_psf(radius, r0, power=3.0):
    return (power - 2) / (2 * np.pi * r0**2) * (1 + (radius / r0) ** 2) ** (-0.5 * power)


@pytest.mark.parametrize("power", [2.5, 3.0, 3.7, 5.0, 8.0])
def test_the_transfer_function_is_the_hankel_transform_of_the_tail(power):
    # integral of j0(k r) psf(r) 2 pi r dr over a core, in r = r0 sinh-spaced panels; the rest is an alternating series
    # that k r = 2000 leaves below its first term
    r0, nodes, weights = 1.7, *np.polynomial.legendre.leggauss(20)
    for frequency in (0.01, 0.05, 0.2):
        k = 2 * np.pi * frequency
        edges = np.linspace(0.0, 2000.0 / k, 4001)
        r = (edges[:-1, None] + np.diff(edges)[:, None] * 0.5 * (nodes + 1)).ravel()
        w = (np.diff(edges)[:, None] * 0.5 * weights).ravel()
        integral = np.sum(w * 2 * np.pi * r * tail_psf(r, r0, power) * j0(k * r))
        cut = 2 * np.pi * (2000.0 / k) * tail_psf(2000.0 / k, r0, power) / k * np.sqrt(2 / (np.pi * 2000.0))
        assert_allclose(tail_otf(frequency, r0, power), integral, atol=2 * cut + 1e-12)


@pytest.mark.parametrize("power", [3.0, 5.0])
def test_closed_forms_continue_the_bessel_form(power):
    f = np.geomspace(1e-6, 10.0, 200)
    # a power 1e-7 away: the value moves by as much, times at most 2
    assert_allclose(tail_otf(f, 1.0, power), tail_otf(f, 1.0, power + 1e-7), atol=2e-7)


@given(power=powers, r0=floats(0.1, 1e4))
def test_it_is_one_at_zero_falls_and_stays_between_one_and_zero(power, r0):
    frequency = np.concatenate([[0.0], np.geomspace(1e-12, 1e3, 300) / r0])
    value = tail_otf(frequency, r0, power)
    assert value[0] == 1.0
    assert np.all((value >= 0) & (value <= 1))
    assert np.all(np.diff(value) <= 2e-14)  # the error of the Bessel function
    assert value[-1] < 1e-300


@given(power=powers, radius=floats(0.0, 1e6))
def test_the_light_within_a_radius_is_the_integral_of_the_tail(power, radius):
    # its derivative by the radius is the ring, by a central difference of relative width 1e-5
    inner, outer = radius * (1 - 5e-6) + 1e-7, radius * (1 + 5e-6) + 2e-7
    middle = 0.5 * (inner + outer)
    ring = tail_psf(middle, 3.0, power) * 2 * np.pi * middle * (outer - inner)
    assert_allclose(tail_within(outer, 3.0, power) - tail_within(inner, 3.0, power), ring, rtol=1e-5, atol=2e-16)
    assert 0 <= tail_within(radius, 3.0, power) <= 1
    assert tail_within(0.0, 3.0, power) == 0.0


def test_half_of_a_cubic_tail_lies_within_the_root_of_three():
    assert_allclose(tail_within(np.sqrt(3.0), 1.0), 0.5, rtol=1e-15)
    assert_allclose(tail_within(99.995, 1.0), 0.99, rtol=1e-6)  # 1 - 1/sqrt(1 + r^2) by hand


def filtered(plane, fraction, veil, r0, power=3.0):
    f = np.hypot(np.fft.fftfreq(plane.shape[0])[:, None], np.fft.fftfreq(plane.shape[1])[None, :])
    return np.fft.ifft2(np.fft.fft2(plane) * glare_otf(f, fraction, veil, r0, power)).real


@settings(max_examples=25, deadline=None)
@given(fraction=floats(0.0, 0.6), veil=floats(0.0, 0.4), r0=floats(0.3, 30.0), power=powers)
def test_glare_keeps_the_light_and_is_linear(fraction, veil, r0, power):
    one, other = np.random.default_rng(3).uniform(0.0, 1.0, (2, 24, 30))
    mixed = filtered(2 * one - 0.3 * other, fraction, veil, r0, power)
    assert_allclose(mixed.sum(), (2 * one - 0.3 * other).sum(), rtol=1e-12)
    separate = 2 * filtered(one, fraction, veil, r0, power) - 0.3 * filtered(other, fraction, veil, r0, power)
    assert_allclose(mixed, separate, atol=1e-13)


def test_a_veil_is_the_mean_of_the_frame_added_to_what_stays():
    plane = np.random.default_rng(4).uniform(0.0, 1.0, (20, 25))
    assert_allclose(filtered(plane, 0.0, 0.07, 5.0), 0.93 * plane + 0.07 * plane.mean(), rtol=1e-13)
    assert_allclose(filtered(plane, 0.0, 1.0, 5.0), plane.mean(), rtol=1e-13)
    assert_allclose(filtered(plane, 0.0, 0.0, 5.0), plane, rtol=1e-13)


def test_a_tail_around_a_point_is_the_tail_and_its_periodic_images():
    r0, size = 4.0, 256
    point = np.zeros((size, size))
    point[0, 0] = 1.0
    spread = filtered(point, 1.0, 0.0, r0)
    y = np.fft.fftfreq(size, 1 / size)
    images = np.arange(-12, 13) * size
    found = sum(tail_psf(np.hypot(10.0 + i, 3.0 + j), r0) for i in images for j in images)
    # images beyond the 12th: the light outside a circle of that radius, spread over one frame
    rest = (1 - tail_within(12.5 * size, r0)) / size**2
    assert_allclose(spread[int(np.where(y == 10)[0][0]), int(np.where(y == 3)[0][0])], found + rest, rtol=1e-5)
    assert spread.min() > 0


def test_shares_that_are_more_than_all_and_tails_without_end_are_refused():
    f = np.linspace(0.0, 0.5, 3)
    for shares in ((0.7, 0.4), (-0.1, 0.0), (0.0, 1.1), (np.nan, 0.0)):
        with pytest.raises(ValueError, match="together at most 1"):
            glare_otf(f, *shares, 1.0)
    with pytest.raises(ValueError, match="above 2"):
        tail_otf(f, 1.0, 2.0)
    with pytest.raises(ValueError, match="r0 is"):
        tail_within(f, 0.0)
