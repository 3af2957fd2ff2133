"""Laws of the measured and modelled lens blurs: closed forms, orders of convergence, symmetries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats, integers
from numpy.testing import assert_allclose

from etendue_camera.optics.diffraction import airy_psf_density, circular_otf
from etendue_camera.optics.lens import (
    gaussian_otf,
    mean_square_radius,
    radial_psf_otf,
)


def gaussian_table(sigma, count, reach=8.0):
    radius = np.linspace(0.0, reach * sigma, count)
    return radius, np.exp(-(radius**2) / (2.0 * sigma**2))


def test_no_blur_is_exactly_one():
    fy, fx = np.fft.fftfreq(8)[:, None], np.fft.fftfreq(6)[None, :]
    assert np.array_equal(gaussian_otf(fy, fx, 0.0), np.ones((8, 6)))


@given(sigma=floats(0.0, 10.0), fy=floats(-2.0, 2.0), fx=floats(-2.0, 2.0))
def test_gaussian_blur_depends_on_the_distance_from_zero_frequency_only(sigma, fy, fx):
    exponent = 2.0 * np.pi**2 * sigma**2 * (fy**2 + fx**2)
    # an exponential magnifies the rounding of its exponent
    rtol = 1e-15 * max(1.0, exponent)
    assert_allclose(gaussian_otf(fy, fx, sigma), np.exp(-exponent), rtol=rtol, atol=1e-300)


@given(one=floats(0.0, 5.0), other=floats(0.0, 5.0))
def test_two_gaussian_blurs_are_one_with_the_summed_variance(one, other):
    fy, fx = np.linspace(-0.3, 0.3, 7)[:, None], np.linspace(0.0, 0.3, 4)[None, :]
    both = gaussian_otf(fy, fx, one) * gaussian_otf(fy, fx, other)
    assert_allclose(both, gaussian_otf(fy, fx, np.hypot(one, other)), rtol=1e-12, atol=1e-300)  # exponents to 180


def test_gaussian_blur_stays_float32():
    fy = np.linspace(-0.5, 0.5, 5, dtype=np.float32)[:, None]
    assert gaussian_otf(fy, fy.T, np.float64(0.7)).dtype == np.float32


def test_tabulated_gaussian_gives_the_gaussian_transfer_function():
    sigma = 1.3
    radius, psf = gaussian_table(sigma, 200)
    frequency = np.linspace(0.0, 0.5, 40)
    # straight lines between samples err by h^2/8 times the curvature 1/sigma^2, in value and in total energy
    step = radius[1] / sigma
    expected = np.exp(-2.0 * (np.pi * sigma * frequency) ** 2)
    assert_allclose(radial_psf_otf(frequency, radius, psf), expected, rtol=0.0, atol=step**2 / 4.0)


def test_halving_the_table_step_quarters_the_error():
    sigma, frequency = 1.3, np.linspace(0.0, 0.3, 20)
    expected = np.exp(-2.0 * (np.pi * sigma * frequency) ** 2)
    errors = [
        np.max(np.abs(radial_psf_otf(frequency, *gaussian_table(sigma, count)) - expected)) for count in (101, 201, 401)
    ]
    assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.02)  # second order, steps of 0.08 sigma


def test_a_grid_of_frequencies_gives_the_values_of_its_members():
    radius = np.linspace(0.0, 30.0, 90)
    psf = airy_psf_density(radius, 0.55, 8.0) * (1.0 + 0.1 * np.sin(5.0 * radius))
    fy, fx = np.linspace(-0.4, 0.4, 60)[:, None], np.linspace(0.0, 0.4, 31)[None, :]
    grid = radial_psf_otf(np.hypot(fy, fx), radius, psf)
    some = [(0, 0), (30, 15), (59, 30), (12, 7)]
    direct = [radial_psf_otf(np.hypot(fy[i, 0], fx[0, j]), radius, psf) for i, j in some]
    assert_allclose([grid[i, j] for i, j in some], direct, rtol=0.0, atol=1e-14)  # interpolation to rounding


def test_a_long_table_of_the_airy_pattern_tends_to_the_diffraction_limit():
    radius = np.linspace(0.0, 400.0, 8001)
    frequency = np.array([0.0, 0.05, 0.1, 0.2, 0.4])
    found = radial_psf_otf(frequency, radius, airy_psf_density(radius, 0.55, 2.8))
    # the energy beyond the table, 2/(pi v) = 8e-4, is missing from it
    assert_allclose(found, circular_otf(frequency, 0.55, 2.8), rtol=0.0, atol=8e-4)


@given(scale=floats(1e-6, 1e6), steps=integers(2, 30))
def test_a_radial_table_has_no_scale_and_is_one_at_zero(scale, steps):
    radius = np.linspace(0.0, 1.0, steps) ** 2 * 7.0
    psf = np.exp(-radius)
    frequency = np.array([0.0, 0.03, -0.03, 0.7])
    values = radial_psf_otf(frequency, radius, psf)
    assert values[0] == 1.0
    assert values[1] == values[2]
    assert_allclose(radial_psf_otf(frequency, radius, scale * psf), values, rtol=0.0, atol=1e-14)  # rounding


def test_faulty_tables_are_refused():
    good = np.array([0.0, 1.0, 2.0])
    for radius, psf, message in (
        (good + 1.0, good, "start at 0"),
        (good[::-1] - 2.0, good, "start at 0 um and grow"),
        (good, good[:2], "equal length"),
        (good, np.array([1.0, np.nan, 0.0]), "finite"),
        (good, -good, "total energy"),
        (good[:1], good[:1], "at least two"),
    ):
        with pytest.raises(ValueError, match=message):
            radial_psf_otf(0.1, radius, psf)
    with pytest.raises(ValueError, match="sigma is -1"):
        gaussian_otf(0.0, 0.0, -1.0)


@given(sigma=floats(0.3, 10.0))
def test_a_gaussian_has_twice_its_variance_as_mean_square_radius(sigma):
    """2 sigma^2; its transfer function bends by 2 pi^2 times that at 0, and nowhere more."""
    radius, psf = gaussian_table(sigma, 400)
    assert_allclose(mean_square_radius(radius, psf), 2 * sigma**2, rtol=1e-3)  # of straight lines between 400 radii
    frequency = np.linspace(0.0, 1.0 / sigma, 200)
    bend = np.diff(radial_psf_otf(frequency, radius, psf), 2) / frequency[1] ** 2
    assert np.abs(bend).max() <= 2 * np.pi**2 * mean_square_radius(radius, psf)
