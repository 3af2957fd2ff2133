"""The silicon table: its published values, its logarithmic interpolation and its ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats
from numpy.testing import assert_allclose

from etendue_camera.sensor.silicon import absorption

# Green 2008 as alpha = 4 pi k / lambda, worked out separately and rounded to two to four digits
PUBLISHED = {
    0.40: 9.299, 0.45: 2.410, 0.50: 1.110, 0.55: 0.6390, 0.60: 0.4175, 0.65: 0.2790,
    0.70: 0.1890, 0.75: 0.1310, 0.80: 0.0850, 0.85: 0.0534, 0.90: 0.0303, 0.95: 0.0156,
    1.00: 0.00640, 1.05: 0.00163, 1.10: 3.5e-4, 1.20: 2.2e-6, 1.45: 1.2e-12,
}  # fmt: skip


def test_table_holds_the_published_coefficients():
    for wavelength, expected in PUBLISHED.items():
        digits = 2 if wavelength >= 1.10 else 3
        assert float(f"{absorption(wavelength):.{digits - 1}e}") == float(f"{expected:.{digits - 1}e}")


def test_both_ends_belong_to_the_table_in_either_precision():
    for precision in (np.float64, np.float32):
        ends = absorption(np.array([0.25, 1.45], precision))
        assert ends.dtype == precision
        assert_allclose(ends, [4 * np.pi * 3.665 / 0.25, 4 * np.pi * 1.3846e-13 / 1.45], rtol=3e-6)


@given(index=floats(0.0, 119.0).map(int), share=floats(0.0, 1.0))
def test_coefficient_is_a_power_law_between_neighbours(index, share):
    low, high = (25 + index) / 100, (26 + index) / 100
    expected = absorption(low) ** (1.0 - share) * absorption(high) ** share
    # the logarithm reaches 28 and its slope 130 per um, each with the rounding of its argument
    assert_allclose(absorption(low + share * (high - low)), expected, rtol=1e-12)


@given(one=floats(0.29, 1.45), other=floats(0.29, 1.45))
def test_silicon_grows_clearer_towards_the_red(one, other):
    short, long = sorted((one, other))
    assert absorption(short) >= absorption(long) * (1.0 - 1e-12)  # rounding


def test_wavelengths_outside_the_table_are_refused():
    for bad in (0.249, 1.451, np.nan, [0.5, 2.0], -1.0):
        with pytest.raises(ValueError, match=r"within the silicon table, 0\.25 to 1\.45"):
            absorption(bad)


def test_shape_is_kept():
    assert absorption(np.full((2, 3), 0.55)).shape == (2, 3)
    assert absorption(0.55).shape == ()
