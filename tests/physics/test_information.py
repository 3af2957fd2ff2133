"""Information capacity, NEQ and the ideal observer against closed forms; noise power against what was put in."""

import math

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st

from etendue_camera.colour import noise_propagation
from etendue_camera.resolution import information as inf
from etendue_camera.resolution import noise_power as nps

SQUARE = inf.nyquist_square()
FY, FX = SQUARE.fy[:, None], SQUARE.fx


def test_the_square_has_the_area_of_a_pixel_and_both_halves():
    assert SQUARE.weight.sum() == pytest.approx(1, abs=1e-14)
    assert SQUARE.mean(FX**2) == pytest.approx(1 / 12, rel=1e-12)
    assert SQUARE.mean(FY**2) == pytest.approx(1 / 12, rel=1e-12)


@given(st.floats(0, 1e6), st.floats(1, 1e6))
def test_white_noise_and_full_contrast_have_shannons_capacity(quanta, ratio):
    variance = inf.signal_variance(ratio)
    expected = 0.5 * math.log2(1 + variance * quanta)
    assert inf.capacity(np.full((1, 1), quanta), SQUARE, variance) == pytest.approx(expected, rel=1e-12, abs=1e-15)
    assert inf.capacity_along(lambda f: np.full(f.shape, quanta), variance) == pytest.approx(
        expected, rel=1e-12, abs=1e-15
    )


@pytest.mark.parametrize("snr", [0.1, 10.0, 1e4])
def test_a_gaussian_blur_has_the_dilogarithm_of_its_power(snr):
    """All of its contrast lies inside the square: pi / (2 a ln 2) times -Li2(-A), of A exp(-a f^2), from polar
    coordinates.
    """
    a = 4 * (math.pi * 1.5) ** 2
    found = inf.capacity(snr * np.exp(-a * (FY**2 + FX**2)), SQUARE, 1.0)
    outside = 1e-3 if snr * math.exp(-a / 4) > 1e-6 else 1e-9
    assert found == pytest.approx(-math.pi / (2 * a * math.log(2)) * scipy.special.spence(1 + snr), rel=outside)


def test_a_square_pixel_costs_two_times_the_mean_of_log_sinc():
    """At high signal: 0.5 log2(SNR) + 2 (1 - ln pi) / ln 2, since the mean of ln sinc over the Nyquist interval is 1
    - ln pi.
    """
    snr = 1e12
    found = inf.capacity(snr * (np.sinc(FY) * np.sinc(FX)) ** 2, SQUARE, 1.0)
    assert found == pytest.approx(0.5 * math.log2(snr) + 2 * (1 - math.log(math.pi)) / math.log(2), rel=1e-9)


@given(st.floats(0.01, 1e5), st.floats(0.01, 0.99), st.floats(0.01, 1 / 3))
def test_no_blur_and_no_noise_adds_information(quanta, contrast, variance):
    whole = inf.capacity(np.full((1, 1), quanta), SQUARE, variance)
    assert inf.capacity(np.full((1, 1), quanta * contrast**2), SQUARE, variance) <= whole


def test_rims_have_their_limits():
    nothing, endless = np.zeros((1, 1)), inf.neq(np.ones((1, 1)), np.zeros((1, 1)))
    assert inf.capacity(nothing, SQUARE, 0.12) == 0
    assert inf.capacity(endless, SQUARE, 0.12) == math.inf
    assert inf.capacity(endless, SQUARE, 0.0) == 0
    assert inf.neq(0.0, 0.0) == 0  # no signal, whatever the noise
    assert inf.signal_variance(1.0) == 0
    assert inf.signal_variance(math.inf) == pytest.approx(1 / 3)
    assert inf.signal_variance(4.0) == pytest.approx(0.12)
    for power in (-1.0, math.nan):
        with pytest.raises(ValueError, match="^noise power is negative or NaN"):
            inf.neq(1.0, power)
    with pytest.raises(ValueError, match=r"^ratio is 0\.5"):
        inf.signal_variance(0.5)
    with pytest.raises(ValueError, match="negative or NaN"):
        inf.capacity(np.full((1, 1), math.nan), SQUARE, 0.1)


def test_quanta_of_shot_noise_are_the_electrons_whatever_the_gain():
    for gain in (1.0, 0.03, 17.0):
        assert inf.neq(gain * 900.0, gain**2 * 900.0) == pytest.approx(900.0)


def test_channels_with_their_own_noise_add_their_quanta_and_copies_add_none():
    signal, noise = np.array([3.0, 2.0])[:, None], np.diag([4.0, 9.0])[:, :, None]
    own = 9 / 4 + 4 / 9
    assert inf.neq_of_channels(signal, noise)[0] == pytest.approx(own)
    mix = np.array([[1.0, 0.2], [0.3, 2.0], [-1.0, 0.5]])  # three channels made of two
    assert inf.neq_of_channels(mix @ signal, np.einsum("ab,bcn,dc->adn", mix, noise, mix))[0] == pytest.approx(own)
    assert inf.neq_of_channels(np.zeros((2, 1)), np.zeros((2, 2, 1)))[0] == 0


def test_the_ideal_observer_sees_a_gaussian_as_its_energy_over_the_noise():
    """White noise: contrast^2 NEQ times the integral of the squared object, pi sigma^2."""
    found = inf.ideal_observer(np.full((1, 1), 500.0), inf.gaussian_object(FY, FX, 1.5), SQUARE, 0.1)
    assert found == pytest.approx(0.1 * math.sqrt(500 * math.pi * 1.5**2), rel=1e-6)


def test_the_ideal_observer_sees_a_rectangle_as_its_area_over_the_noise():
    """Of an 8 x 6 rectangle's energy Parseval leaves the Nyquist square all but what sinc^2 has beyond it."""
    f = 0.5 * np.polynomial.legendre.leggauss(200)[0]
    inside = [float(0.5 * np.polynomial.legendre.leggauss(200)[1] @ (n * np.sinc(n * f) ** 2)) for n in (8, 6)]
    square = inf.nyquist_square(64)
    rectangle = 48 * np.sinc(8 * square.fy[:, None]) * np.sinc(6 * square.fx)
    found = inf.ideal_observer(np.full((1, 1), 100.0), rectangle, square)
    assert found == pytest.approx(math.sqrt(100 * 48 * inside[0] * inside[1]), rel=1e-9)


def answers(rng):
    h = np.zeros((2, 2, 11, 13))
    h[:, :, 3:8, 4:9] = rng.normal(size=(2, 2, 5, 5))
    return h, np.array([[5, 6], [5, 7]]), np.array([0.7, 2.0])


def test_power_over_the_square_is_the_covariance():
    h, sites, variance = answers(np.random.default_rng(3))
    square = inf.nyquist_square(32)
    power = nps.carried_power(nps.spectra(h, sites, square.fy, square.fx), variance)
    integral = [[square.mean(power[i, j].real) for j in (0, 1)] for i in (0, 1)]
    np.testing.assert_allclose(integral, noise_propagation.carried_covariance(h, variance), rtol=1e-9)


def test_the_expected_periodogram_is_what_frames_show():
    """40 frames of 160 x 160 pixels hold 3900 periodograms of 16: 1.6 % each; their mean over all frequencies 0.1 %."""
    rng = np.random.default_rng(5)
    h = np.zeros((1, 1, 9, 9))
    h[0, 0, 3:6, 3:6] = rng.random((3, 3))
    white = rng.standard_normal((40, 160, 160))
    seen = np.stack([scipy.ndimage.convolve(frame, h[0, 0], mode="wrap")[None] for frame in white])
    found, count = nps.periodograms(seen + np.linspace(0, 9, 160), 16)  # what all frames share is signal
    assert count == 39 * 100
    ratio = (found / nps.expected_periodogram(h, [1.0], 16)).real[0, 0]
    assert abs(ratio.mean() - 1) < 0.01
    assert ratio.std() < 1.5 / math.sqrt(count)


def test_large_blocks_show_the_power_itself():
    """What a block blurs falls as 1 / its side: extrapolated from two sides, the rest as its square."""
    h, sites, variance = answers(np.random.default_rng(7))
    at = np.fft.fftfreq(256)[::32]
    power = nps.carried_power(nps.spectra(h, sites, at, at), variance)
    small, large = (
        nps.expected_periodogram(h, variance, block)[..., :: block // 8, :: block // 8] for block in (128, 256)
    )
    np.testing.assert_allclose(2 * large - small, power, atol=2 * 8**2 / (128 * 256) * np.abs(power).max())


def test_detail_comes_through_a_shift_whole():
    h = np.zeros((1, 1, 7, 7))
    h[0, 0, 3, 4] = 1.0
    found = nps.carried_signal(nps.spectra(h, [[3, 3]], FY[:, 0], FX), np.full((1, len(FY), len(FX)), 5.0))
    np.testing.assert_allclose(np.abs(found), 5.0)
