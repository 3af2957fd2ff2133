"""Exposure value, ISO speed, metering and the grey card: closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.electronics import dynamic_range, metering


def test_exposure_value_is_zero_at_f1_and_one_second_and_15_on_a_sunny_day():
    assert metering.exposure_value(1.0, 1.0) == 0
    assert_allclose(metering.exposure_value(16.0, 1 / 128), 15.0, rtol=1e-15)
    assert_allclose(metering.exposure_value(np.array([2.0, 2.8284271247461903]), 0.25), [4.0, 5.0], rtol=1e-15)


def test_iso_100_saturates_at_078_lux_seconds():
    assert_allclose(metering.saturation_iso(0.78), 100.0, rtol=1e-15)


@pytest.mark.parametrize("method", ["mean", "centre", "highlight"])
@pytest.mark.parametrize("shape", [(5, 8), (2, 5, 8)])
def test_a_uniform_frame_is_metered_as_its_level(method, shape):
    assert_allclose(metering.metered_level(np.full(shape, 7.0), method), 7.0, rtol=1e-15)


def test_the_centre_counts_more_and_the_highlight_ignores_what_lies_above_its_quantile():
    frame = np.zeros((33, 33))
    frame[16, 16] = 1.0
    corner = np.roll(frame, (16, 16), (0, 1))
    assert metering.metered_level(frame, "centre") > 40 * metering.metered_level(corner, "centre")
    assert metering.metered_level(frame, "mean") == metering.metered_level(corner, "mean")
    assert metering.metered_level(frame, "highlight", 0.99) == 0.0
    assert metering.metered_level(frame, "highlight", 1.0) == 1.0
    assert metering.metered_level(-frame, "mean") == 0.0  # undershoot is no light


@given(level=st.floats(1e-3, 1e9), target=st.floats(1.0, 1e6), bias=st.floats(-5, 5))
def test_the_metered_time_reaches_the_target(level, target, bias):
    time = metering.metered_time(level, target, bias, 1e-30, 1e30)
    assert_allclose(level * time, target * 2**bias, rtol=1e-14)
    assert metering.metered_time(0.0, target, bias, 1e-6, 30.0) == 30.0
    assert 1e-6 <= metering.metered_time(level, target, bias, 1e-6, 30.0) <= 30.0


@given(snr=st.floats(0.1, 1e3), variance=st.floats(0.0, 1e6))
def test_the_charge_at_an_snr_has_that_snr(snr, variance):
    signal = metering.charge_at_snr(snr, variance)
    assert_allclose(signal / np.sqrt(signal + variance), snr, rtol=1e-14)


def test_one_at_snr_1_is_the_threshold_of_emva():
    assert_allclose(
        metering.charge_at_snr(1.0, 25.0 + 1 / 12), dynamic_range.emva_smallest_photons(1.0, 1.0, 5.0), rtol=1e-15
    )


def test_a_grey_card_has_018_of_the_white():
    assert_allclose(metering.grey_card_snr(1e4 / 0.18, 0.0), 40.0, rtol=1e-14)
    assert_allclose(metering.grey_card_snr(1e4 / 0.18, 3e4), 20 * math.log10(50), rtol=1e-14)
    assert metering.grey_card_snr(0.0, 1.0) == -math.inf


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: metering.exposure_value(0.0, 1.0), "f_number is 0"),
        (lambda: metering.saturation_iso(0.0), "saturation_exposure_lx_s is 0"),
        (lambda: metering.metered_level(np.ones((0, 3)), "mean"), "the frame is empty"),
        (lambda: metering.metered_level(np.ones((2, 3)), "median"), "method is 'median'"),
        (lambda: metering.metered_level(np.ones((2, 3)), "highlight", 0.0), "quantile is 0"),
        (lambda: metering.metered_time(1.0, 1.0, 0.0, 2.0, 1.0), "shortest and longest are 2"),
        (lambda: metering.metered_time(-1.0, 1.0, 0.0, 1.0, 2.0), "level and target_electrons are -1"),
        (lambda: metering.charge_at_snr(-1.0, 0.0), "snr is -1"),
        (lambda: metering.grey_card_snr(1.0, -1.0), "white_electrons and dark_variance are 1"),
    ],
)
def test_what_cannot_be_metered_is_refused(call, said):
    with pytest.raises(ValueError, match=f"^{said}"):
        call()
