"""Noise through a linear chain: predicted from what the chain answers to single pixels, found in pictures of noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.colour.noise_propagation import (
    carried_covariance,
    correlation,
    found_covariance,
    standard_error_of_variance,
    without_trend,
)
from etendue_camera.mosaic import bilinear
from etendue_camera.restoration import sharpening

PLACES = ((0, 0), (0, 1), (1, 0), (1, 1))


def answers(chain, size=24):
    """What a chain on a Bayer mosaic answers to a unit step at each place of its cell, near the middle."""
    found = []
    for y, x in PLACES:
        mosaic = np.zeros((size, size))
        mosaic[size // 2 + y, size // 2 + x] = 1
        found.append(chain(mosaic))
    return np.array(found)


def test_bilinear_interpolation_of_red_keeps_nine_sixteenths_of_the_variance():
    """By hand: 1 at red's own place, 1/2 at two, 1/4 at one of four; green 1 at two places and 1/4 at two."""
    found = carried_covariance(answers(lambda m: bilinear.bilinear(m, "RGGB")), np.ones(4))
    assert_allclose(
        np.diag(found), [(1 + 0.5 + 0.5 + 0.25) / 4, (1 + 1 + 0.25 + 0.25) / 4, (1 + 0.5 + 0.5 + 0.25) / 4], rtol=1e-15
    )
    assert_allclose(found - np.diag(np.diag(found)), 0, atol=1e-16)  # no channel takes anything from another


def test_colour_differences_correlate_the_channels():
    found = carried_covariance(answers(lambda m: bilinear.colour_difference(m, "RGGB")), np.ones(4))
    shared = correlation(found, np.diag(found))
    assert (shared > 0.2).all() and np.allclose(np.diag(shared), 1)


def test_sharpening_after_interpolation_multiplies_what_both_answer_to_a_pixel():
    """White noise through the Laplacian alone has the closed noise gain; after bilinear, neighbours correlate and it
    gains less.
    """
    alone = carried_covariance(answers(lambda m: sharpening.sharpen(m, 0.2)[None]), np.ones(4))
    assert_allclose(alone[0, 0], sharpening.noise_gain(0.2) ** 2, rtol=1e-14)
    plain = carried_covariance(answers(lambda m: bilinear.bilinear(m, "RGGB")), np.ones(4))
    both = carried_covariance(answers(lambda m: sharpening.sharpen(bilinear.bilinear(m, "RGGB"), 0.2)), np.ones(4))
    assert (np.diag(both) > np.diag(plain)).all() and (np.diag(both) < np.diag(plain) * alone[0, 0]).all()


@given(seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_a_matrix_on_the_channels_acts_on_the_covariance_from_both_sides(seed):
    matrix = np.random.default_rng(seed).normal(size=(3, 3))
    plain = answers(lambda m: bilinear.bilinear(m, "RGGB"))
    mixed = np.einsum("ij,pjyx->piyx", matrix, plain)
    v = np.array([1.0, 2.0, 2.0, 5.0])
    assert_allclose(
        carried_covariance(mixed, v), matrix @ carried_covariance(plain, v) @ matrix.T, rtol=1e-12, atol=1e-12
    )


def test_the_prediction_is_what_pictures_of_noise_show():
    """400 x 400 pixels: the standard error of a variance is 0.5 %, of a covariance less."""
    v = np.array([4.0, 1.0, 1.0, 9.0])
    noise = np.random.default_rng(3).normal(size=(400, 400))
    for place, (y, x) in enumerate(PLACES):
        noise[y::2, x::2] *= np.sqrt(v[place])

    def chain(m):
        return sharpening.sharpen(bilinear.colour_difference(m, "RGGB"), 0.15)

    picture = without_trend(chain(noise)[:, 8:-8, 8:-8])
    for lag in ((0, 0), (0, 1), (1, 0), (1, -1), (0, 2)):
        expected = carried_covariance(answers(chain), v, lag)
        assert_allclose(
            found_covariance(picture, lag), expected, atol=0.02 * np.trace(carried_covariance(answers(chain), v))
        )


def test_a_lag_and_its_opposite_are_each_others_transpose():
    h, v = answers(lambda m: bilinear.colour_difference(m, "GRBG")), np.array([1.0, 2.0, 3.0, 4.0])
    assert_allclose(carried_covariance(h, v, (1, -2)), carried_covariance(h, v, (-1, 2)).T, rtol=1e-14, atol=1e-16)
    noise = np.random.default_rng(1).normal(size=(3, 20, 20))
    assert_allclose(found_covariance(noise, (1, -2)), found_covariance(noise, (-1, 2)).T, rtol=1e-13)


def test_a_trend_up_to_its_degree_leaves_nothing():
    y, x = np.mgrid[:20, :30]
    assert_allclose(without_trend(3.0 + 0.1 * y - 0.02 * x * y + 0.003 * x**2), 0, atol=1e-12)


def test_the_standard_error_is_that_of_independent_noise():
    """Variance of a sample variance of n normals: 2/n; 100 frames of 64 x 64 agree with the scatter of blocks to 5
    %.
    """
    noise = np.random.default_rng(2).normal(size=(100, 1, 64, 64))
    assert_allclose(standard_error_of_variance(noise), np.sqrt(2 / noise.size), rtol=0.05)
    assert np.isnan(standard_error_of_variance(noise[:1, :, :16, :16])).all()


def test_what_makes_no_sense_is_refused():
    with pytest.raises(ValueError, match="variance is"):
        carried_covariance(np.ones((4, 3, 5, 5)), [-1, 1, 1, 1])
    with pytest.raises(ValueError, match=r"\(place,\)"):
        carried_covariance(np.ones((4, 3, 5, 5)), [1, 1])
    with pytest.raises(ValueError, match="lag is"):
        carried_covariance(np.ones((4, 3, 5, 5)), np.ones(4), (5, 0))
