"""Sharpening is identity plus a Laplacian or less a Gaussian: in space, in frequency and on noise; what restoring
gains and costs.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import ndimage, optimize

from etendue_camera.resolution import restoration_gain
from etendue_camera.restoration import sharpening
from tests.physics.reference import cases

strengths = st.floats(0, 4)
shapes = st.tuples(st.integers(1, 3), st.integers(1, 9), st.integers(1, 9))
seeds = st.integers(0, 2**32 - 1)


def test_the_high_precision_responses_are_held():
    for case, expected, rtol in cases("laplacian_response"):
        got = sharpening.laplacian_response(case["fy_cyc_per_px"], case["fx_cyc_per_px"])
        assert_allclose(got, expected, rtol=rtol, err_msg=str(case))
    for case, expected, rtol in cases("sharpen_response"):
        got = sharpening.sharpen_response(case["fy_cyc_per_px"], case["fx_cyc_per_px"], case["k"])
        assert_allclose(got, expected, rtol=rtol, err_msg=str(case))


@given(shape=shapes, seed=seeds, strength=strengths)
def test_sharpening_is_convolution_with_the_printed_matrix(shape, seed, strength):
    planes = np.random.default_rng(seed).uniform(0, 1, shape)
    taps = np.pad([[1.0]], 1) + strength * sharpening.LAPLACIAN
    direct = np.stack([ndimage.convolve(p, taps, mode="nearest") for p in planes])
    # values up to 1 + 16 k, each way a dozen roundings
    assert_allclose(sharpening.sharpen(planes, strength), direct, rtol=0, atol=4e-15 * (1 + strength))


@given(shape=shapes, seed=seeds, strength=strengths)
def test_sharpening_keeps_the_sum_of_every_plane(shape, seed, strength):
    planes = np.random.default_rng(seed).uniform(0, 1, shape)
    before, after = planes.sum(axis=(1, 2)), sharpening.sharpen(planes, strength).sum(axis=(1, 2))
    assert_allclose(after, before, rtol=0, atol=1e-13 * (1 + strength))


@given(value=st.floats(-1e30, 1e30), shape=shapes, strength=strengths)
def test_a_constant_plane_is_kept_exactly(value, shape, strength):
    planes = np.full(shape, value)
    assert_array_equal(sharpening.sharpen(planes, strength), planes)


@pytest.mark.parametrize(("cycles_y", "cycles_x"), [(0, 0), (1, 0), (0, 5), (3, 7), (16, 0), (16, 16)])
def test_a_wave_is_multiplied_by_the_response(cycles_y, cycles_x):
    n, strength = 32, 0.3
    y, x = np.mgrid[:n, :n]
    wave = np.cos(2 * np.pi * (cycles_y * y + cycles_x * x) / n)
    gain = sharpening.sharpen_response(cycles_y / n, cycles_x / n, strength)
    inner = np.s_[1:-1, 1:-1]
    assert_allclose(sharpening.sharpen(wave, strength)[inner], gain * wave[inner], rtol=0, atol=1e-13)


@given(fy=st.floats(-0.5, 0.5), fx=st.floats(-0.5, 0.5), strength=strengths)
def test_no_frequency_is_weakened_and_none_gains_more_than_twelve_fold(fy, fx, strength):
    response = sharpening.sharpen_response(fy, fx, strength)
    assert 1 <= response <= (1 + 12 * strength) * (1 + 1e-15)
    assert_allclose(response, sharpening.sharpen_response(-fx, fy, strength), rtol=1e-15)


def test_near_zero_the_laplacian_is_twelve_pi_squared_f_squared():
    # the printed product of cosines gives 0 here
    assert_allclose(sharpening.laplacian_response(0.0, 1e-12), 12 * math.pi**2 * 1e-24, rtol=1e-15)


@given(strength=strengths)
def test_noise_gain_is_the_norm_of_the_taps_and_the_mean_square_of_the_response(strength):
    taps = np.pad([[1.0]], 1) + strength * sharpening.LAPLACIAN
    assert_allclose(sharpening.noise_gain(strength), np.sqrt(np.sum(taps**2)), rtol=1e-15)
    f = np.arange(8) / 8  # Parseval: a 3 x 3 kernel is resolved on any grid from 3 x 3 on
    response = sharpening.sharpen_response(f[:, None], f, strength)
    assert_allclose(sharpening.noise_gain(strength), np.sqrt(np.mean(response**2)), rtol=1e-14)


def test_full_strength_multiplies_white_noise_by_9_4():
    noise = np.random.default_rng(0).standard_normal((300, 300))
    gain = sharpening.sharpen(noise, 1.0)[1:-1, 1:-1].std()
    assert_allclose(sharpening.noise_gain(1.0), math.sqrt(89), rtol=1e-15)
    assert_allclose(gain, math.sqrt(89), rtol=0.02)  # 3e5 correlated samples: 0.5 % standard error


def test_float32_is_kept_leading_axes_pass_and_inputs_are_not_written():
    planes = np.random.default_rng(1).uniform(0, 1, (2, 3, 16, 17)).astype(np.float32)
    before = planes.copy()
    sharp = sharpening.sharpen(planes, 0.5)
    assert sharp.dtype == np.float32
    assert_array_equal(planes, before)
    assert_array_equal(sharp[1, 2], sharpening.sharpen(planes[1, 2], 0.5))


@pytest.mark.parametrize("strength", [-0.1, math.nan, math.inf])
def test_impossible_strengths_are_refused(strength):
    for call in (
        lambda: sharpening.sharpen(np.zeros((2, 2)), strength),
        lambda: sharpening.sharpen_response(0.1, 0.1, strength),
        lambda: sharpening.noise_gain(strength),
    ):
        with pytest.raises(ValueError, match="strength"):
            call()
    with pytest.raises(ValueError, match="planes has shape"):
        sharpening.sharpen(np.zeros(4), 0.1)


# -- in front of the demosaicer


@given(shape=shapes, seed=seeds, strength=strengths, period=st.tuples(st.integers(1, 6), st.integers(1, 6)))
def test_sharpening_a_mosaic_is_sharpening_each_of_its_planes(shape, seed, strength, period):
    mosaic = np.random.default_rng(seed).uniform(0, 1, shape)
    sharp = sharpening.sharpen_mosaic(mosaic, strength, period)
    for row in range(min(period[0], shape[1])):
        for column in range(min(period[1], shape[2])):
            place = np.s_[:, row :: period[0], column :: period[1]]
            assert_array_equal(sharp[place], sharpening.sharpen(mosaic[place], strength))


def test_planes_of_their_own_keep_a_grey_card_of_three_colours_and_the_printed_kernel_does_not():
    card = np.tile([[0.3, 0.6], [0.6, 0.2]], (5, 7))
    assert_array_equal(sharpening.sharpen_mosaic(card, 1.0), card)
    assert np.abs(sharpening.sharpen_mosaic(card, 1.0, (1, 1)) - card).max() > 1


def test_impossible_periods_are_refused():
    with pytest.raises(ValueError, match="period is"):
        sharpening.sharpen_mosaic(np.zeros((4, 4)), 0.1, (0, 2))
    with pytest.raises(ValueError, match="mosaic has shape"):
        sharpening.sharpen_mosaic(np.zeros(4), 0.1)


# -- unsharp mask

radii = st.floats(0.05, 6)


@given(shape=shapes, seed=seeds, radius=radii, amount=strengths)
def test_unsharp_is_convolution_with_identity_less_a_gaussian_and_keeps_the_sum(shape, seed, radius, amount):
    planes = np.random.default_rng(seed).uniform(0, 1, shape)
    taps = sharpening.gaussian_taps(radius)
    kernel, reach = np.outer(taps, taps), taps.size // 2
    mirrored = np.pad(planes, ((0, 0), (reach, reach), (reach, reach)), mode="symmetric")
    windows = np.lib.stride_tricks.sliding_window_view(mirrored, kernel.shape, axis=(1, 2))
    direct = planes + amount * (planes - (windows * kernel).sum(axis=(-1, -2)))
    # values up to 1 + 2 a; sums of up to 49 x 49 products
    assert_allclose(sharpening.unsharp(planes, radius, amount), direct, rtol=0, atol=3e-15 * (1 + amount))
    assert_allclose(direct.sum(axis=(1, 2)), planes.sum(axis=(1, 2)), rtol=0, atol=1e-12 * (1 + amount))


@pytest.mark.parametrize(("cycles_y", "cycles_x"), [(0, 0), (1, 0), (0, 5), (3, 7), (24, 24)])
@pytest.mark.parametrize("radius", [0.2, 0.7, 2.0])
def test_a_wave_is_multiplied_by_the_response_of_the_unsharp_mask(cycles_y, cycles_x, radius):
    n, amount = 48, 0.8
    y, x = np.mgrid[:n, :n]
    wave = np.cos(2 * np.pi * (cycles_y * y + cycles_x * x) / n)
    gain = sharpening.unsharp_response(cycles_y / n, cycles_x / n, radius, amount)
    inner = np.s_[15:-15, 15:-15]  # out of reach of the border: 7 radii
    assert_allclose(sharpening.unsharp(wave, radius, amount)[inner], gain * wave[inner], rtol=0, atol=1e-13)


def test_a_wide_unsharp_mask_is_a_gaussian_in_frequency():
    f = np.linspace(0, 0.5, 51)
    gaussian = 1 + 0.6 * (1 - np.exp(-2 * (np.pi * 2.0 * f) ** 2))
    # sampled at two pixels a standard deviation, whose first alias is below 1e-8 at Nyquist; cut at seven, where 3e-12
    # is left
    assert_allclose(sharpening.unsharp_response(0.0, f, 2.0, 0.6), gaussian, rtol=0, atol=1e-8)


@given(radius=radii, amount=strengths)
def test_noise_gain_of_the_unsharp_mask_is_the_mean_square_of_its_response(radius, amount):
    n = 2 * sharpening.gaussian_taps(radius).size  # resolves the kernel
    f = np.arange(n) / n
    response = sharpening.unsharp_response(f[:, None], f, radius, amount)
    assert_allclose(sharpening.unsharp_noise_gain(radius, amount), np.sqrt(np.mean(response**2)), rtol=1e-13)


def test_differences_below_the_threshold_stay_as_they_are_and_larger_ones_lose_it():
    y, x = np.mgrid[:40, :40]
    planes = 0.5 + 1e-3 * (-1.0) ** (x + y) + 0.4 * (x > 20)
    sharp, plain = sharpening.unsharp(planes, 1.0, 1.0, 0.05), sharpening.unsharp(planes, 1.0, 1.0)
    assert_array_equal(sharp[:, :15], planes[:, :15])
    assert_allclose(sharp[:, 21], plain[:, 21] - 0.05, rtol=1e-14)  # one subtraction more
    assert_allclose(sharp[:, 20], plain[:, 20] + 0.05, rtol=1e-14)


def test_the_unsharp_mask_keeps_float32_and_refuses_nonsense():
    planes = np.random.default_rng(1).uniform(0, 1, (2, 16, 17)).astype(np.float32)
    sharp = sharpening.unsharp(planes, 0.7, 2.0, 0.01)
    assert sharp.dtype == np.float32
    # blurred in double, three roundings of values up to 5
    assert_allclose(sharp, sharpening.unsharp(planes.astype(float), 0.7, 2.0, 0.01), rtol=0, atol=2e-6)
    for values, name in (
        ((0.0, 1.0), "radius"),
        ((1.0, -1.0), "amount"),
        ((1.0, 1.0, math.nan), "threshold"),
        ((2000.0, 1.0), "radius"),
    ):
        with pytest.raises(ValueError, match=f"{name} is"):
            sharpening.unsharp(np.zeros((2, 2)), *values)
    with pytest.raises(ValueError, match="planes has shape"):
        sharpening.unsharp(np.zeros(4), 1.0, 1.0)


# -- what a restoration gains and costs


def test_noise_behind_bilinear_demosaicing_has_the_stated_spectrum():
    rng, n = np.random.default_rng(2), 64
    f = np.fft.fftfreq(n)
    for green in (True, False):
        power = np.zeros((n, n))
        for _ in range(60):
            noise, sites = rng.standard_normal((n, n)), np.zeros((n, n))
            sites[::2, ::2] = 1
            if green:
                sites[1::2, 1::2] = 1
            kernel = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4 if green else np.outer([1, 2, 1], [1, 2, 1]) / 4
            plane = ndimage.convolve(noise * sites, kernel, mode="wrap")
            power += np.abs(np.fft.fft2(plane)) ** 2 / n**2 / 60
        cy, cx = np.cos(2 * np.pi * f[:, None]), np.cos(2 * np.pi * f)
        spectrum = 0.5 * (1 + 0.5 * (cy + cx)) ** 2 if green else 0.25 * ((1 + cy) * (1 + cx)) ** 2
        assert_allclose(spectrum.mean(), 5 / 8 if green else 9 / 16, rtol=1e-14)
        blocks = [a.reshape(8, 8, 8, 8).mean(axis=(1, 3)) for a in (power, spectrum)]
        assert_allclose(
            blocks[0], blocks[1], rtol=0, atol=0.1 * blocks[1].max()
        )  # 3840 draws, two by two alike: 0.09 is 4 sigma
        response = sharpening.sharpen_response(f[:, None], f, 0.3)
        predicted = restoration_gain.response_noise_gain(response, spectrum)
        measured = math.sqrt((response**2 * power).sum() / power.sum())
        assert_allclose(predicted, measured, rtol=0.02)  # 2.5e5 draws


@pytest.mark.parametrize("strength", [0.0, 0.05, 0.15])
def test_gain_in_mtf50_is_that_of_the_product_of_both_responses(strength):
    sigma = 0.6

    def system(f):
        return np.exp(-2 * (np.pi * sigma * f) ** 2)

    def response(f):
        return sharpening.sharpen_response(0.0, f, strength)

    gain = restoration_gain.mtf50_gain(system, response)
    before = math.sqrt(math.log(2) / 2) / (math.pi * sigma)
    after = optimize.brentq(lambda f: system(f) * response(f) - 0.5, 0.1, 0.7)
    assert_allclose(gain, after / before, rtol=1e-9)  # the chord of a bracket of 6e-8


def test_gain_in_mtf50_does_not_know_units_and_is_undefined_where_half_is_not_reached():
    def system(f):
        return 7.0 * np.exp(-8 * f**2)

    assert_allclose(restoration_gain.mtf50_gain(system, lambda f: np.full(f.shape, -3.0)), 1.0, rtol=1e-12)
    assert math.isnan(restoration_gain.mtf50_gain(np.ones_like, np.ones_like))
    assert math.isnan(restoration_gain.mtf50_gain(system, lambda f: np.exp(8 * f**2)))


def test_impossible_spectra_are_refused():
    for spectrum in (np.ones((2, 3)), np.zeros((2, 2)), np.array([[1.0, -1.0], [1.0, 1.0]])):
        with pytest.raises(ValueError, match="spectrum"):
            restoration_gain.response_noise_gain(np.ones((2, 2)), spectrum)


@pytest.mark.parametrize("radius", [0.5, 0.75, 1.0, 2.0, 70.0])
def test_the_taps_change_little_where_one_more_comes_in(radius):
    below, above = (sharpening.gaussian_taps(radius * (1 + step)) for step in (-1e-12, 1e-12))
    inner = min(below.size, above.size)
    edge = [taps[(taps.size - inner) // 2 : (taps.size + inner) // 2] for taps in (below, above)]
    assert_allclose(edge[0], edge[1], rtol=0, atol=1e-10)  # e^-24.5 is 2e-11 of the middle tap
