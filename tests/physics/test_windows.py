"""Windows are sums over neighbours, and what has no full neighbourhood is left out evenly."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.mosaic import windows

sizes = {windows.three: 3, windows.five: 5, windows.nine: 9}


def field(seed, shape=(40, 43)):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, shape)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("window", sizes)
def test_a_window_is_the_sum_of_its_samples(window, step, axis):
    values, size = field(1), sizes[window]
    found = window(values, axis, step)
    lost = step * (size - 1)
    length = values.shape[axis] - lost
    expected = sum(values.take(range(k * step, k * step + length), axis) for k in range(size))
    assert_allclose(found, expected, rtol=0, atol=4e-15)  # nine values up to 1, nine roundings
    assert_array_equal(window(np.flip(values, axis), axis, step), np.flip(found, axis))


@pytest.mark.parametrize("axis", [0, 1])
def test_neighbours_are_added_and_subtracted_about_the_same_centre(axis):
    values = field(2)
    after, before = values.take(range(2, values.shape[axis]), axis), values.take(range(values.shape[axis] - 2), axis)
    assert_array_equal(windows.pair(values, axis), after + before)
    assert_array_equal(windows.slope(values, axis), after - before)
    assert_array_equal(windows.moved(values, axis, 1, 1), after)
    assert_array_equal(windows.moved(values, axis, -1, 1), before)


@given(reaches=st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=5))
def test_arrays_meet_where_they_show_the_same_places(reaches):
    values = field(3)
    found = windows.meet(*(values[y : 40 - y, x : 43 - x] for y, x in reaches))
    top, left = max(y for y, _ in reaches), max(x for _, x in reaches)
    for part in found:
        assert_array_equal(part, values[top : 40 - top, left : 43 - left])
    for part in windows.within(10, values.shape, *(values[y : 40 - y, x : 43 - x] for y, x in reaches)):
        assert_array_equal(part, values[10:-10, 10:-10])


def test_square_windows_are_no_more_than_that_and_scaling_keeps_the_type():
    values = field(4).astype(np.float32)
    total = windows.square(values, windows.five)
    assert total.shape == (36, 39)
    assert_allclose(total[3, 8], values[3:8, 8:13].sum(), rtol=0, atol=3e-6)  # 25 values up to 1 in single precision
    assert windows.scaled(total, 1 / 25) is total and total.dtype == np.float32
