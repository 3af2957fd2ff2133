"""Sharpening is identity plus a Laplacian, in space, in frequency and on noise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage

from etendue.physics import restoration
from tests.physics.reference import cases

strengths = st.floats(0, 4)
shapes = st.tuples(st.integers(1, 3), st.integers(1, 9), st.integers(1, 9))
seeds = st.integers(0, 2**32 - 1)


def test_the_high_precision_responses_are_held():
    for case, expected, rtol in cases("laplacian_response"):
        got = restoration.laplacian_response(case["fy_cyc_per_px"], case["fx_cyc_per_px"])
        assert_allclose(got, expected, rtol=rtol, err_msg=str(case))
    for case, expected, rtol in cases("sharpen_response"):
        got = restoration.sharpen_response(case["fy_cyc_per_px"], case["fx_cyc_per_px"], case["k"])
        assert_allclose(got, expected, rtol=rtol, err_msg=str(case))


@given(shape=shapes, seed=seeds, strength=strengths)
def test_sharpening_is_convolution_with_the_printed_matrix(shape, seed, strength):
    planes = np.random.default_rng(seed).uniform(0, 1, shape)
    taps = np.pad([[1.0]], 1) + strength * restoration.LAPLACIAN
    direct = np.stack([ndimage.convolve(p, taps, mode="nearest") for p in planes])
    # values up to 1 + 16 k, each way a dozen roundings
    assert_allclose(restoration.sharpen(planes, strength), direct, rtol=0, atol=4e-15 * (1 + strength))


@given(shape=shapes, seed=seeds, strength=strengths)
def test_sharpening_keeps_the_sum_of_every_plane(shape, seed, strength):
    planes = np.random.default_rng(seed).uniform(0, 1, shape)
    before, after = planes.sum(axis=(1, 2)), restoration.sharpen(planes, strength).sum(axis=(1, 2))
    assert_allclose(after, before, rtol=0, atol=1e-13 * (1 + strength))


@given(value=st.floats(-1e30, 1e30), shape=shapes, strength=strengths)
def test_a_constant_plane_is_kept_exactly(value, shape, strength):
    planes = np.full(shape, value)
    assert_array_equal(restoration.sharpen(planes, strength), planes)


@pytest.mark.parametrize(("cycles_y", "cycles_x"), [(0, 0), (1, 0), (0, 5), (3, 7), (16, 0), (16, 16)])
def test_a_wave_is_multiplied_by_the_response(cycles_y, cycles_x):
    n, strength = 32, 0.3
    y, x = np.mgrid[:n, :n]
    wave = np.cos(2 * np.pi * (cycles_y * y + cycles_x * x) / n)
    gain = restoration.sharpen_response(cycles_y / n, cycles_x / n, strength)
    inner = np.s_[1:-1, 1:-1]
    assert_allclose(restoration.sharpen(wave, strength)[inner], gain * wave[inner], rtol=0, atol=1e-13)


@given(fy=st.floats(-0.5, 0.5), fx=st.floats(-0.5, 0.5), strength=strengths)
def test_no_frequency_is_weakened_and_none_gains_more_than_twelve_fold(fy, fx, strength):
    response = restoration.sharpen_response(fy, fx, strength)
    assert 1 <= response <= (1 + 12 * strength) * (1 + 1e-15)
    assert_allclose(response, restoration.sharpen_response(-fx, fy, strength), rtol=1e-15)


def test_near_zero_the_laplacian_is_twelve_pi_squared_f_squared():
    # the printed product of cosines gives 0 here
    assert_allclose(restoration.laplacian_response(0.0, 1e-12), 12 * math.pi**2 * 1e-24, rtol=1e-15)


@given(strength=strengths)
def test_noise_gain_is_the_norm_of_the_taps_and_the_mean_square_of_the_response(strength):
    taps = np.pad([[1.0]], 1) + strength * restoration.LAPLACIAN
    assert_allclose(restoration.noise_gain(strength), np.sqrt(np.sum(taps**2)), rtol=1e-15)
    f = np.arange(8) / 8  # Parseval: a 3 x 3 kernel is resolved on any grid from 3 x 3 on
    response = restoration.sharpen_response(f[:, None], f, strength)
    assert_allclose(restoration.noise_gain(strength), np.sqrt(np.mean(response**2)), rtol=1e-14)


def test_full_strength_multiplies_white_noise_by_9_4():
    noise = np.random.default_rng(0).standard_normal((300, 300))
    gain = restoration.sharpen(noise, 1.0)[1:-1, 1:-1].std()
    assert_allclose(restoration.noise_gain(1.0), math.sqrt(89), rtol=1e-15)
    assert_allclose(gain, math.sqrt(89), rtol=0.02)  # 3e5 correlated samples: 0.5 % standard error


def test_float32_is_kept_leading_axes_pass_and_inputs_are_not_written():
    planes = np.random.default_rng(1).uniform(0, 1, (2, 3, 16, 17)).astype(np.float32)
    before = planes.copy()
    sharp = restoration.sharpen(planes, 0.5)
    assert sharp.dtype == np.float32
    assert_array_equal(planes, before)
    assert_array_equal(sharp[1, 2], restoration.sharpen(planes[1, 2], 0.5))


@pytest.mark.parametrize("strength", [-0.1, math.nan, math.inf])
def test_impossible_strengths_are_refused(strength):
    for call in (
        lambda: restoration.sharpen(np.zeros((2, 2)), strength),
        lambda: restoration.sharpen_response(0.1, 0.1, strength),
        lambda: restoration.noise_gain(strength),
    ):
        with pytest.raises(ValueError, match="strength"):
            call()
    with pytest.raises(ValueError, match="planes has shape"):
        restoration.sharpen(np.zeros(4), 0.1)
