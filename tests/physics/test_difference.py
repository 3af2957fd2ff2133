"""CIELAB and CIEDE2000 against 60-digit arithmetic, and as a measure of difference."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.colour import difference
from tests.physics.reference import cases

D65 = np.array([0.95047, 1.0, 1.08883])
colours = st.tuples(st.floats(0, 100), st.floats(-128, 128), st.floats(-128, 128)).map(np.array)


def test_the_high_precision_lab_values_are_held():
    for case, expected, rtol in cases("lab"):
        got = difference.lab([case["X"], case["Y"], case["Z"]], [case["Xn"], case["Yn"], case["Zn"]])
        assert_allclose(got, expected, rtol=rtol, err_msg=str(case))


def test_the_high_precision_differences_are_held():
    for case, expected, rtol in cases("de2000"):
        first, second = ([case[c + n] for c in "Lab"] for n in "12")
        assert_allclose(difference.delta_e_2000(first, second), expected, rtol=rtol, err_msg=str(case))


@given(scale=st.floats(1e-12, 1.0))
def test_greys_of_the_white_have_no_chroma(scale):
    lightness, a, b = difference.lab(scale * D65, D65)
    assert 0 < lightness <= 100 * (1 + 1e-15)
    assert_allclose([a, b], 0, atol=3e-13)  # 500 x the roundings of two cube roots up to 1


def test_in_the_dark_lightness_is_linear():
    # (29/3)^3 Y; through 116 f - 16 only 8 digits would be left here
    assert_allclose(difference.lab(1e-9 * D65, D65)[0], (29 / 3) ** 3 * 1e-9, rtol=1e-15)


def test_white_is_a_hundred_black_is_zero_and_the_break_is_smooth():
    assert_array_equal(difference.lab(D65, D65), [100, 0, 0])
    assert_array_equal(difference.lab(0 * D65, D65), [0, 0, 0])
    y = (6 / 29) ** 3 * np.array([1 - 1e-9, 1 + 1e-9])
    low, high = difference.lab(y * np.ones((3, 1)), np.ones(3))[0]
    assert_allclose(high - low, 903.3 * (y[1] - y[0]), rtol=1e-4)


@given(first=colours, second=colours)
def test_a_difference_is_symmetric_at_least_zero_and_zero_for_equals(first, second):
    there, back = difference.delta_e_2000(first, second), difference.delta_e_2000(second, first)
    assert_allclose(there, back, rtol=1e-10, atol=1e-12)
    assert there >= 0
    assert difference.delta_e_2000(first, first) == 0


@given(lightness=st.floats(0, 100))
def test_along_the_greys_only_lightness_counts(lightness):
    step = difference.delta_e_2000([lightness, 0, 0], [50, 0, 0])
    middle = (lightness + 50) / 2 - 50
    expected = abs(lightness - 50) / (1 + 0.015 * middle**2 / np.sqrt(20 + middle**2))
    assert_allclose(step, expected, rtol=1e-15)


def test_small_differences_grow_in_proportion():
    base, step = np.array([60.0, 30.0, -40.0]), np.array([0.3, -0.5, 0.7])
    near, nearer = (difference.delta_e_2000(base, base + s * step) for s in (1e-4, 1e-5))
    assert_allclose(near / nearer, 10, rtol=1e-4)


def test_pictures_are_compared_pixel_by_pixel_and_float32_is_kept():
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0, 1, (2, 3, 5, 7)).astype(np.float32)
    one, two = (difference.lab(picture, D65) for picture in xyz)
    result = difference.delta_e_2000(one, two)
    assert one.dtype == result.dtype == np.float32
    assert result.shape == (5, 7)
    exact = difference.delta_e_2000(*(difference.lab(picture.astype(float), D65) for picture in xyz))
    assert_allclose(result, exact, rtol=1e-4)  # 100 x 6e-8 of a Lab value over differences of order 1
    assert_allclose(difference.delta_e_2000(one[:, 2, 3], two)[2, 3], result[2, 3], rtol=1e-5)


def test_what_is_no_colour_is_refused():
    with pytest.raises(ValueError, match="xyz has shape"):
        difference.lab(np.zeros((2, 2)), D65)
    for white in ([0.95, 1.0], [0.95, 0.0, 1.0], [0.95, np.nan, 1.0]):
        with pytest.raises(ValueError, match="white_xyz"):
            difference.lab(np.zeros(3), white)
    with pytest.raises(ValueError, match="lab2 has shape"):
        difference.delta_e_2000(np.zeros(3), np.zeros(4))
