"""Encodings against their standards, their inverses and each other's limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.colour import encoding
from tests.physics.reference import cases

PAIRS = [(encoding.srgb_encode, encoding.srgb_decode), (encoding.bt709_encode, encoding.bt709_decode)]
values = st.floats(-1e6, 1e6)


@pytest.mark.parametrize("group", ["srgb_encode", "srgb_decode", "bt709_encode"])
def test_the_high_precision_encodings_are_held(group):
    for case, expected, rtol in cases(group):
        assert_allclose(getattr(encoding, group)(case["v"]), expected, rtol=rtol, err_msg=str(case))


def test_the_high_precision_powers_are_held():
    for case, expected, rtol in cases("gamma_signed"):
        got = encoding.gamma_signed(case["v"], case["gamma"])
        assert_allclose(got, expected, rtol=rtol, err_msg=str(case))


@pytest.mark.parametrize(
    ("encode", "case_gamma", "group"),
    [
        (encoding.srgb_encode, None, "srgb_encode"),
        (encoding.srgb_decode, None, "srgb_decode"),
        (encoding.bt709_encode, None, "bt709_encode"),
        (encoding.gamma_signed, "gamma", "gamma_signed"),
    ],
)
def test_float32_stays_float32_and_holds_single_precision(encode, case_gamma, group):
    for case, expected, rtol in cases(group, 3e-7):
        value = np.array([case["v"]], np.float32)
        got = encode(value, case[case_gamma]) if case_gamma else encode(value)
        assert got.dtype == np.float32
        # rounding the input to float32 costs another 6e-8 x condition
        assert_allclose(got[0], expected, rtol=1.2 * rtol, err_msg=str(case))


@pytest.mark.parametrize(("encode", "decode"), PAIRS)
@given(value=values)
def test_decoding_undoes_encoding(encode, decode, value):
    # 2.3e-9: the branches of sRGB miss each other by 3e-8 at the break; elsewhere rounding x condition
    assert_allclose(decode(encode(value)), value, rtol=4e-15, atol=2.3e-9)


@pytest.mark.parametrize("curve", [f for pair in PAIRS for f in pair])
@given(low=values, high=values)
def test_encodings_never_fall(curve, low, high):
    low, high = min(low, high), max(low, high)
    # the branches of sRGB overlap by 3e-8 at its break
    assert curve(low) <= curve(high) + 3e-8 * (curve in PAIRS[0])


@given(value=values, gamma=st.floats(0.1, 5))
def test_srgb_and_powers_are_odd(value, gamma):
    for curve in (encoding.srgb_encode, encoding.srgb_decode, lambda v: encoding.gamma_signed(v, gamma)):
        assert curve(-value) == -curve(value)


@pytest.mark.parametrize("curve", [f for pair in PAIRS for f in pair])
def test_black_is_zero_white_is_one_and_the_ends_of_the_line_are_kept(curve):
    assert curve(0.0) == 0
    assert_allclose(curve(1.0), 1.0, rtol=3e-16)
    assert_array_equal(curve(np.array([np.inf, -np.inf])), [np.inf, -np.inf])
    assert np.isnan(curve(np.nan))


@given(value=st.floats(1e-6, 1e6), first=st.floats(0.2, 3), second=st.floats(0.2, 3))
def test_powers_multiply(value, first, second):
    twice = encoding.gamma_signed(encoding.gamma_signed(value, first), second)
    # each power rounds once; a rounded exponent or base is multiplied by the logarithm or the other exponent
    rtol = 3e-16 * (1 + second + first * second * abs(np.log(value)))
    assert_allclose(encoding.gamma_signed(value, first * second), twice, rtol=rtol)


def test_gamma_of_zero_is_zero_even_beside_the_smallest_number():
    for dtype in (np.float32, np.float64):
        smallest = np.finfo(dtype).smallest_subnormal
        encoded = encoding.gamma_signed(np.array([-smallest, 0, smallest], dtype), 0.45)
        assert encoded[1] == 0
        # rounding the exponent costs eps/2 x 0.45 x log of the smallest number, 46 and 335
        assert_allclose(encoded[2], float(smallest) ** 0.45, rtol=200 * np.finfo(dtype).eps)
        assert encoded[0] == -encoded[2]


@pytest.mark.parametrize("gamma", [0.0, -1.0, np.nan, np.inf])
def test_impossible_gammas_are_refused(gamma):
    with pytest.raises(ValueError, match="gamma"):
        encoding.gamma_signed([0.5], gamma)


def test_inputs_are_not_written():
    picture = np.linspace(-0.5, 1.5, 50)
    before = picture.copy()
    for curve in (*(f for pair in PAIRS for f in pair), lambda v: encoding.gamma_signed(v, 0.45)):
        curve(picture)
        assert_array_equal(picture, before)
