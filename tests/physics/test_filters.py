"""Laws of filters: a cut that falls, and the birefringent filter that makes four copies of the light, wherever it is
turned.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats
from numpy.testing import assert_allclose

from etendue_camera.optics.filters import four_spot_otf, smooth_cut

separations = floats(0.0, 20.0)


def test_whole_sample_shifts_give_exactly_the_mean_of_the_shifted_copies():
    plane = np.random.default_rng(1).uniform(0.0, 1.0, (18, 20))
    f = np.fft.fftfreq(18)[:, None], np.fft.fftfreq(20)[None, :]
    for dy, dx in ((2, 4), (6, 0), (0, 2), (0, 0)):
        copies = [np.roll(plane, (sy * dy // 2, sx * dx // 2), (0, 1)) for sy in (-1, 1) for sx in (-1, 1)]
        filtered = np.fft.ifft2(np.fft.fft2(plane) * four_spot_otf(*f, dy, dx)).real
        assert_allclose(filtered, np.mean(copies, axis=0), atol=1e-15)


@given(dy=separations, dx=separations, rotation=floats(-np.pi, np.pi))
def test_it_is_the_transform_of_four_equal_spots(dy, dx, rotation):
    fy, fx = np.linspace(-0.4, 0.4, 9)[:, None], np.linspace(-0.4, 0.4, 7)[None, :]
    total = 0.0
    for sy in (-0.5, 0.5):
        for sx in (-0.5, 0.5):
            # axes of the filter turned from x towards y
            y = sy * dy * np.cos(rotation) + sx * dx * np.sin(rotation)
            x = sx * dx * np.cos(rotation) - sy * dy * np.sin(rotation)
            total = total + np.exp(-2j * np.pi * (fy * y + fx * x)) / 4
    value = four_spot_otf(fy, fx, dy, dx, rotation)
    assert_allclose(value, total.real, atol=1e-13)
    assert_allclose(total.imag, 0.0, atol=1e-13)
    assert_allclose(value, value[::-1, ::-1], atol=1e-13)
    assert np.all(np.abs(value) <= 1)


def test_two_spots_leave_the_other_direction_alone():
    f = np.linspace(0.0, 0.5, 11)
    assert np.all(four_spot_otf(f[:, None], np.zeros((1, 1)), 0.0, 5.0) == 1.0)
    assert_allclose(
        four_spot_otf(f[:, None], np.zeros((1, 1)), 0.0, 5.0, np.pi / 2)[:, 0], np.cos(np.pi * 5 * f), atol=1e-14
    )


@pytest.mark.parametrize("pitch", [1.1, 5.4])
def test_spots_one_pitch_apart_stop_nyquist_and_reverse_what_lies_beyond(pitch):
    assert abs(four_spot_otf(0.0, 0.5 / pitch, 0.0, pitch)) < 1e-15
    assert four_spot_otf(0.0, 0.75 / pitch, 0.0, pitch) < -0.7


def test_a_quarter_turn_swaps_the_axes_and_a_half_turn_changes_nothing():
    fy, fx = np.linspace(-0.4, 0.4, 9)[:, None], np.linspace(-0.3, 0.3, 7)[None, :]
    assert_allclose(four_spot_otf(fy, fx, 3.0, 7.0, np.pi / 2), four_spot_otf(fy, fx, 7.0, 3.0), atol=1e-14)
    assert_allclose(four_spot_otf(fy, fx, 3.0, 7.0, np.pi), four_spot_otf(fy, fx, 3.0, 7.0), atol=1e-14)
    assert_allclose(four_spot_otf(fy, fx, 3.0, 7.0, 1e-12), four_spot_otf(fy, fx, 3.0, 7.0), atol=1e-11)


def test_a_smooth_cut_falls_from_one_to_zero_through_one_half_even_where_it_is_steep():
    wavelength = np.linspace(300.0, 1100.0, 801)
    for edge in (1e-3, 0.5, 15.0, 300.0):
        cut = smooth_cut(wavelength, 650.0, edge)
        assert cut[350] == 0.5
        assert np.all(np.diff(cut) <= 0) and np.all((cut >= 0) & (cut <= 1))
        assert_allclose(cut + smooth_cut(1300.0 - wavelength, 650.0, edge), 1.0, rtol=1e-15)
    assert_allclose(
        smooth_cut(np.array([642.5, 657.5]), 650.0, 15.0), [1 / (1 + np.exp(-1)), 1 / (1 + np.exp(1))], rtol=1e-15
    )
    assert np.all(smooth_cut(wavelength, np.inf, 15.0) == 1.0)
    with pytest.raises(ValueError, match="edge is 0"):
        smooth_cut(wavelength, 650.0, 0.0)
