"""Deconvolution undoes a known blur where it can, and leaves what cannot be known alone."""

import math

import numpy as np
import pytest
import scipy.fft
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue.transfer import sampling
from etendue_camera.resolution import restoration_gain
from etendue_camera.restoration import deconvolution
from tests.physics.reference import cases, extra

sizes = st.tuples(st.integers(1, 12), st.integers(1, 12))
seeds = st.integers(0, 2**32 - 1)


def gaussian(shape, sigma):
    """The transfer function of a Gaussian blur on the padded plane of a frame."""
    fy, fx = deconvolution.frequencies(*shape)
    return np.exp(-2 * (np.pi * sigma) ** 2 * (fy[:, None] ** 2 + fx**2))


def box(shape, width):
    """Of a moving mean along x: with zeros inside the band where the width is above 2 pixels."""
    fy, fx = deconvolution.frequencies(*shape)
    return np.broadcast_to(np.sinc(width * fx), (fy.size, fx.size)).copy()


# -- Wiener


def test_the_high_precision_gains_are_held():
    for case, expected, rtol in cases("wiener_gain"):
        got = deconvolution.wiener_gain(np.array(complex(case["H_re"], case["H_im"])), case["nsr"])
        assert_allclose([got.real, got.imag], expected, rtol=rtol, atol=1e-300, err_msg=str(case))


@given(
    size=st.floats(-308, 308),
    angle=st.floats(-math.pi, math.pi),
    noise=st.one_of(st.just(0.0), st.floats(-320, 300).map(lambda e: 10.0**e)),
)
def test_no_transfer_function_and_no_noise_gives_an_undefined_gain(size, angle, noise):
    transfer = 10.0**size * np.exp(1j * angle)
    gain = deconvolution.wiener_gain(transfer, noise)
    assert np.isfinite(gain)
    if noise > 0:
        assert abs(gain) <= 0.5 / math.sqrt(noise) * (1 + 1e-14)
    elif abs(transfer) > 1e-300:
        assert_allclose(gain * transfer, 1.0, rtol=1e-14)


def test_without_noise_the_gain_is_the_inverse_where_there_is_one_and_0_where_there_is_none():
    transfer = np.array([1.0, 0.5, -0.25, 0.3 - 0.4j, 1e-200, 0.0])
    gain = deconvolution.wiener_gain(transfer, 0.0)
    assert_allclose(gain[:-1], 1 / transfer[:-1], rtol=1e-15)
    assert gain[-1] == 0
    assert_array_equal(deconvolution.wiener_gain(np.zeros(3), [0.0, 1e-300, 1.0]), 0)


def test_as_noise_vanishes_the_gain_tends_to_the_inverse_in_proportion():
    transfer = np.array([0.9, 0.1, -0.3])
    for noise in (1e-6, 1e-8, 1e-10):
        lost = 1 - deconvolution.wiener_gain(transfer, noise) * transfer
        assert_allclose(lost, noise / transfer**2, rtol=2e-4, atol=2e-16)


@given(shape=sizes, seed=seeds, value=st.floats(-1e6, 1e6))
def test_constants_are_kept_and_so_is_what_a_gain_of_1_is_applied_to(shape, seed, value):
    ones = np.ones_like(gaussian(shape, 0.0))
    planes = np.random.default_rng(seed).uniform(0, 1, (2, *shape))
    assert_allclose(deconvolution.apply(planes, ones), planes, rtol=0, atol=3e-15)
    noise = np.where(ones.cumsum().reshape(ones.shape) == 1, 0.0, 0.1)  # the mean is known
    gain = deconvolution.wiener_gain(gaussian(shape, 0.7), noise)
    assert_allclose(deconvolution.apply(np.full(shape, value), gain), value, rtol=2e-14, atol=1e-300)


def test_a_blurred_plane_comes_back_where_nothing_was_lost():
    shape = (33, 47)
    blur = gaussian(shape, 0.5)  # 0.08 in the corner of the band
    padded = sampling.pad(np.random.default_rng(0).uniform(0, 1, shape))
    blurred = scipy.fft.irfft2(scipy.fft.rfft2(padded) * blur, s=padded.shape)
    inverse = deconvolution.wiener_gain(blur, 0.0)
    back = scipy.fft.irfft2(scipy.fft.rfft2(blurred) * inverse, s=padded.shape)
    assert_allclose(back, padded, rtol=0, atol=1e-13)  # 12-fold rounding


def test_at_zeros_of_the_transfer_function_nothing_is_amplified():
    shape = (40, 64)
    blur = box(shape, 4.0)
    padded = sampling.pad(np.random.default_rng(0).uniform(0, 1, shape))
    spectrum = scipy.fft.rfft2(padded)
    gain = deconvolution.wiener_gain(blur, 1e-3)
    dead = np.abs(blur) < 1e-14
    assert dead.any() and np.all(gain[dead] < 1e-10)
    assert np.abs(gain).max() <= 0.5 / math.sqrt(1e-3)
    restored = scipy.fft.irfft2(spectrum * blur * gain, s=padded.shape)
    assert (
        np.square(restored - padded).mean()
        < np.square(scipy.fft.irfft2(spectrum * blur, s=padded.shape) - padded).mean()
    )


def test_no_other_gain_errs_less_for_the_assumed_powers():
    blur = gaussian((30, 30), 0.6)
    ratio = 0.02 / deconvolution.signal_spectrum(*np.meshgrid(*deconvolution.frequencies(30, 30), indexing="ij"))
    best = deconvolution.wiener_gain(blur, ratio)

    def error(gain):
        return (np.abs(1 - gain * blur) ** 2 + ratio * np.abs(gain) ** 2).sum()

    rng = np.random.default_rng(0)
    for size in (1e-3, 1e-1):
        assert error(best) < error(best * (1 + size * rng.standard_normal(best.shape)))


@given(exponent=st.floats(0, 8), outer=st.floats(1e-2, 0.4))
def test_the_power_law_has_the_integral_of_a_flat_spectrum(exponent, outer):
    nodes, weights = np.polynomial.legendre.leggauss(60)
    u = 0.5 * (nodes + 1)  # f = u^4 / 2 gathers nodes where the law bends
    f, df = 0.5 * u**4, 0.5 * weights * 2 * u**3
    total = (2 * np.pi * f * df * deconvolution.signal_spectrum(0.0, f, exponent, outer)).sum()
    assert_allclose(total, np.pi / 4, rtol=1e-9)
    assert_allclose(deconvolution.signal_spectrum(f, 0.0, 0.0, outer), 1.0, rtol=1e-15)


def test_the_price_in_noise_is_the_root_mean_square_of_the_gain():
    shape = (256, 256)
    fy, fx = deconvolution.frequencies(*shape)
    gain = deconvolution.wiener_gain(gaussian(shape, 0.7), 0.01 / deconvolution.signal_spectrum(fy[:, None], fx))
    noise = np.random.default_rng(4).standard_normal(shape)
    total = sampling.padded_size(shape[1])
    twice = np.full(gain.shape, 2.0)
    twice[:, [0, -1]] = 1.0
    assert total % 2 == 0
    predicted = restoration_gain.response_noise_gain(gain, twice)
    assert predicted > 1.5
    assert_allclose(deconvolution.apply(noise, gain).std(), predicted, rtol=0.02)  # 65536 draws, correlated: 0.6 %


def test_a_border_does_not_see_the_other_one():
    shape = (24, 200)
    planes = np.zeros(shape)
    planes[:, :8] = 1.0
    gain = deconvolution.wiener_gain(gaussian(shape, 0.7), 1e-2)
    assert (
        np.abs(deconvolution.apply(planes, gain)[:, -8:]).max() < 1e-4
    )  # the filter's tail after 190 pixels, not an edge of 1


@given(largest=st.floats(1e-3, 1e3), seed=seeds)
def test_a_limited_gain_keeps_its_phase_and_what_is_below_the_limit(largest, seed):
    rng = np.random.default_rng(seed)
    gain = rng.standard_normal(20) * 10 ** rng.uniform(-3, 3, 20) * np.exp(1j * rng.uniform(0, 6, 20))
    less = deconvolution.limited(gain, largest)
    assert_allclose(np.abs(less), np.minimum(np.abs(gain), largest), rtol=1e-14)
    assert_allclose(np.angle(less), np.angle(gain), atol=1e-14)
    assert deconvolution.limited(gain, math.inf) is gain


def test_float32_is_kept_with_its_stated_error():
    shape = (60, 80)
    planes = np.random.default_rng(1).uniform(0, 1, (3, *shape))
    gain = deconvolution.wiener_gain(gaussian(shape, 0.8), 1e-3)
    single = deconvolution.apply(planes.astype(np.float32), gain)
    assert single.dtype == np.float32
    assert np.abs(single - deconvolution.apply(planes, gain)).max() < 3e-7 * np.abs(gain).max()


# -- Richardson-Lucy


def test_the_exact_cases_are_held():
    for case in extra("richardson_lucy_1d"):
        data, kernel = (np.array([case[name]], dtype=float) for name in ("y", "h"))
        got, done = deconvolution.richardson_lucy_periodic(
            data, scipy.fft.rfft2(kernel / kernel.sum()), case["iterations"]
        )
        assert done == case["iterations"]
        assert_allclose(got[0], [float(v) for v in case["out"]], rtol=0, atol=1e-14)


def kernels(shape, seed):
    """A random kernel without negative parts and with the sum 1, as a half spectrum."""
    values = np.random.default_rng(seed).uniform(0, 1, shape) ** 8
    return scipy.fft.rfft2(values / values.sum())


@settings(deadline=None)
@given(
    shape=sizes,
    seed=seeds,
    iterations=st.integers(1, 30),
    variation=st.sampled_from([0.0, 0.01, 0.2]),
    start=st.sampled_from(["mean", "data"]),
)
def test_the_sum_and_the_sign_are_kept(shape, seed, iterations, variation, start):
    rng = np.random.default_rng(seed)
    data = rng.uniform(0, 1, shape) * (rng.uniform(0, 1, shape) > 0.5)
    got, _ = deconvolution.richardson_lucy_periodic(data, kernels(shape, seed), iterations, variation, start=start)
    assert np.all(got >= 0)
    assert_allclose(got.sum(), data.sum(), rtol=1e-13)


@given(shape=sizes, seed=seeds, iterations=st.integers(1, 30))
def test_of_no_blur_the_data_are_the_fixed_point(shape, seed, iterations):
    data = np.random.default_rng(seed).uniform(0, 1, shape)
    got, _ = deconvolution.richardson_lucy_periodic(data, np.ones((shape[0], shape[1] // 2 + 1)), iterations)
    assert_allclose(got, data, rtol=0, atol=1e-13)


@settings(deadline=None, max_examples=30)
@given(shape=sizes, seed=seeds)
def test_likelihood_never_falls(shape, seed):
    transfer = kernels(shape, seed)
    data = np.random.default_rng(seed).poisson(5.0, shape).astype(float)

    def likelihood(estimate):
        model = np.maximum(scipy.fft.irfft2(scipy.fft.rfft2(estimate) * transfer, s=shape), 1e-300)
        return (data * np.log(model) - model).sum()

    found = [likelihood(deconvolution.richardson_lucy_periodic(data, transfer, n)[0]) for n in (1, 2, 4, 8)]
    assert np.all(np.diff(found) > -1e-9 * abs(found[0]))


def test_a_kernel_with_negative_parts_stays_bounded():
    """A camera's transfer function ends at the Nyquist frequency above 0: its kernel rings, and beside a bright
    point Hx is negative.
    """
    n = 64
    fy, fx = scipy.fft.fftfreq(n), scipy.fft.rfftfreq(n)
    transfer = np.sinc(0.75 * fy)[:, None] * np.sinc(0.75 * fx)
    data = np.full((n, n), 1e-4)
    data[20:40, 20:40], data[10, 50] = 1.0, 1.0
    got, _ = deconvolution.richardson_lucy_periodic(data, transfer, 200)
    assert np.all(np.isfinite(got)) and np.all(got >= 0)
    assert (
        got.max() < 1.5
    )  # the inverse makes 1.18 of a lit pixel, squared mean of 1/sinc over the band, and more of corners
    assert_allclose(got.sum(), data.sum(), rtol=1e-12)


@pytest.mark.parametrize("start", ["mean", "data"])
@pytest.mark.parametrize("iterations", [1, 3, 12, 12.5, 40])
def test_small_contrasts_are_multiplied_by_the_stated_response(iterations, start):
    n, contrast = 48, 1e-5
    y, x = np.mgrid[:n, :n]
    fy, fx = scipy.fft.fftfreq(n), scipy.fft.rfftfreq(n)
    transfer = np.exp(-2 * (np.pi * 0.6) ** 2 * (fy[:, None] ** 2 + fx**2))
    for cy, cx in ((0, 1), (5, 9), (24, 24)):
        wave = np.cos(2 * np.pi * (cy * y + cx * x) / n)
        whole = [math.floor(iterations), math.ceil(iterations)]
        both = [
            deconvolution.richardson_lucy_periodic(1 + contrast * wave, transfer, k, start=start)[0] - 1 for k in whole
        ]
        got = 0.5 * (both[0] + both[1])
        response = deconvolution.richardson_lucy_response(
            np.exp(-2 * (np.pi * 0.6 / n) ** 2 * (cy**2 + cx**2)), iterations, start
        )
        assert_allclose(
            got / contrast, response * wave, rtol=0, atol=2e-3
        )  # second order in the contrast, which iterations gather


def test_the_response_tends_to_the_inverse_and_starts_as_the_matched_filter():
    transfer = np.array([1.0, 0.6, 0.1, 1e-9, 1e-200, 0.0, 0.3 - 0.2j])
    assert_array_equal(deconvolution.richardson_lucy_response(transfer, 0), 0)
    assert_allclose(deconvolution.richardson_lucy_response(transfer, 1), np.conj(transfer), rtol=1e-14)
    assert_allclose(deconvolution.richardson_lucy_response(transfer, 7)[3], 7e-9, rtol=1e-12)
    assert_allclose(deconvolution.richardson_lucy_response(transfer[:3], 1e5), 1 / transfer[:3], rtol=1e-14)
    assert_array_equal(deconvolution.richardson_lucy_response(transfer, 0, "data"), 1)
    from_data = deconvolution.richardson_lucy_response(np.linspace(0, 1, 50), 2.5, "data")
    assert np.all(from_data >= 1)  # never less sharp than the data
    exact = sum((1 - abs(transfer[-1]) ** 2) ** k for k in range(9)) * np.conj(transfer[-1])
    assert_allclose(deconvolution.richardson_lucy_response(transfer, 9)[-1], exact, rtol=1e-14)


def test_the_price_in_noise_of_richardson_lucy_is_that_of_its_response():
    shape, iterations = (200, 200), 8
    transfer = gaussian(shape, 0.6)
    noise = np.random.default_rng(2).standard_normal((1, *shape))
    got, _ = deconvolution.richardson_lucy(1 + 1e-4 * noise, transfer[None], iterations)
    twice = np.full(transfer.shape, 2.0)
    twice[:, [0, -1]] = 1.0
    predicted = restoration_gain.response_noise_gain(
        deconvolution.richardson_lucy_response(transfer, iterations), twice
    )
    assert predicted > 1.2
    assert_allclose(got.std() / 1e-4, predicted, rtol=0.02)  # 40000 draws, correlated: 0.8 %


def test_it_ends_where_the_residual_is_reached_and_moves_with_it_without_a_step():
    shape = (40, 50)
    transfer = gaussian(shape, 0.7)
    rng = np.random.default_rng(0)
    clean = np.clip(np.add.outer(np.sin(np.arange(40) / 2), np.cos(np.arange(50) / 3)), 0.1, None)
    data = deconvolution.apply(clean, transfer) + 0.02 * rng.standard_normal(shape)
    data = np.maximum(data, 0)[None]
    before = None
    for residual in np.linspace(0.015, 0.03, 31):
        got, done = deconvolution.richardson_lucy(data, transfer, 200, residual=residual)
        assert 0 < done[0] < 200
        if before is not None:
            assert done[0] <= before[1] and np.abs(got - before[0]).max() < 0.2 * data.max()
        before = got, done[0]
    _, none = deconvolution.richardson_lucy(data, transfer, 3, residual=1e-9)
    flat, at_once = deconvolution.richardson_lucy(data, transfer, 3, residual=10.0)
    assert none[0] == 3 and at_once[0] == 0
    assert np.ptp(flat) < 1e-12
    same, at_once = deconvolution.richardson_lucy(data, transfer, 3, residual=10.0, start="data")
    assert at_once[0] == 0
    assert_array_equal(same, data)


def test_total_variation_flattens_noise_and_keeps_an_edge():
    shape = (40, 60)
    transfer = gaussian(shape, 0.7)
    truth = np.where(np.arange(60) < 30, 0.2, 0.8) * np.ones((40, 1))
    data = deconvolution.apply(truth, transfer) + 0.02 * np.random.default_rng(1).standard_normal(shape)
    plain, smooth = (
        deconvolution.richardson_lucy(data[None], transfer, 20, variation)[0][0] for variation in (0.0, 0.01)
    )
    flat = np.s_[5:-5, 5:24]
    assert smooth[flat].std() < 0.5 * plain[flat].std()
    blurred, sharp = ((plane[:, 30] - plane[:, 29]).mean() for plane in (data, smooth))
    assert blurred < 0.35 and 0.5 < sharp < 0.65  # of a step of 0.6 between two pixels


def test_values_below_0_stand_on_a_pedestal_and_come_back():
    shape = (20, 30)
    transfer = gaussian(shape, 0.5)
    planes = np.random.default_rng(0).normal(0.1, 0.1, (2, *shape))
    got, _ = deconvolution.richardson_lucy(planes, transfer, 5)
    assert got.min() < 0
    assert_allclose(got.mean(axis=(1, 2)), planes.mean(axis=(1, 2)), atol=0.01)  # the sum is that of the padded plane
    lifted, _ = deconvolution.richardson_lucy(planes + 1.0, transfer, 5, pedestal=1.0)
    again, _ = deconvolution.richardson_lucy(planes + 2.0, transfer, 5, pedestal=0.0)
    assert_allclose(lifted - 1, again - 2, atol=1e-12)


def test_richardson_lucy_in_single_precision():
    shape = (50, 60)
    transfer = gaussian(shape, 0.7)
    planes = np.random.default_rng(3).uniform(0, 1, (3, *shape))
    double, _ = deconvolution.richardson_lucy(planes, transfer, 10)
    single, _ = deconvolution.richardson_lucy(planes.astype(np.float32), transfer, 10)
    assert single.dtype == np.float32
    assert np.abs(single - double).max() < 5e-6 * np.abs(double).max()  # ten iterations of 5e-7


def test_arguments_that_make_no_sense_are_refused():
    data, ones = np.ones((4, 4)), np.ones((4, 3))
    wrong = {
        "iterations is": lambda: deconvolution.richardson_lucy_periodic(data, ones, 0),
        "total_variation is": lambda: deconvolution.richardson_lucy_periodic(data, ones, 1, 0.3),
        "residual is": lambda: deconvolution.richardson_lucy_periodic(data, ones, 1, 0.0, -1.0),
        "start is": lambda: deconvolution.richardson_lucy_periodic(data, ones, 1, start="zero"),
        "start is 'x'": lambda: deconvolution.richardson_lucy_response(0.5, 1, "x"),
        "data holds": lambda: deconvolution.richardson_lucy_periodic(-data, ones, 1),
        "data has shape": lambda: deconvolution.richardson_lucy_periodic(data, np.ones((4, 4)), 1),
        "transfer has shape": lambda: deconvolution.richardson_lucy(data[None], ones, 1),
        "planes has shape": lambda: deconvolution.richardson_lucy(data, gaussian((4, 4), 0.1), 1),
        "pedestal is": lambda: deconvolution.richardson_lucy(data[None], gaussian((4, 4), 0.1), 1, pedestal=-1.0),
        "gain has shape": lambda: deconvolution.apply(data, ones),
        "noise_to_signal is": lambda: deconvolution.wiener_gain(ones, -1.0),
        "exponent is": lambda: deconvolution.signal_spectrum(0.1, 0.1, 9.0),
        "outer is": lambda: deconvolution.signal_spectrum(0.1, 0.1, 2.0, 0.0),
        "largest is": lambda: deconvolution.limited(ones, 0.0),
        "transfer has a size": lambda: deconvolution.richardson_lucy_response(1.5, 3),
    }
    for text, call in wrong.items():
        with pytest.raises(ValueError, match=text):
            call()


@given(step=st.floats(-1e-3, 1e-3))
def test_the_signal_spectrum_passes_smoothly_through_the_exponent_at_which_its_integral_is_a_logarithm(step):
    f = np.array([0.0, 0.01, 0.3])
    here, there = (deconvolution.signal_spectrum(0.0, f, 2.0 + s) for s in (0.0, step))
    # the logarithm of the spectrum has a slope of at most ln(256) by the exponent, and of its area as much; then
    # rounding
    assert_allclose(np.log(there / here), 0, atol=2 * math.log(256) * abs(step) + 1e-13)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0 - 1e-13, 2.0, 2.0 + 1e-13, 3.0, 8.0])
def test_the_signal_spectrum_has_the_variance_1_over_the_disc_of_the_band(exponent):
    node, weight = np.polynomial.legendre.leggauss(40)
    ends = 0.5 * np.linspace(0, 1, 41) ** 3  # rings, narrow where the spectrum is steep
    half = np.diff(ends)[:, None] / 2
    r, dr = ends[:-1, None] + half * (node + 1), half * weight
    power = deconvolution.signal_spectrum(0.0, r, exponent)
    # 2 pi r dr over the disc of radius 1/2, whose mean is that of the square's pi/4; the nodes leave 1e-12
    assert_allclose((dr * 2 * np.pi * r * power).sum(), np.pi / 4, rtol=1e-10)


def test_a_picture_far_below_its_pedestal_keeps_its_digits_in_single_precision():
    picture = np.random.default_rng(5).uniform(0.1, 1.0, (1, 9, 12))
    transfer = gaussian((9, 12), 0.6)[None]
    exact, _ = deconvolution.richardson_lucy(picture, transfer, 10, pedestal=1e4)
    found, _ = deconvolution.richardson_lucy(picture.astype(np.float32), transfer, 10, pedestal=1e4)
    assert found.dtype == np.float32
    assert_allclose(
        found, exact, rtol=0, atol=3e-7
    )  # the input and the result are rounded; with 1e4 added in float32 it was 5e-4
