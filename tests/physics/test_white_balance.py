"""Which white a mosaic shows, and mosaics balanced by it. In: mosaics made of a known white. Out: the white, equal
channels.
"""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.mosaic import white_balance
from etendue_camera.sensor import cfa

NAMES = ("RGGB", "GBRG", "quad-BGGR", "X-Trans", "RGBW", "RCCC", "mono", "RGB/BRG/GBR")
ROUNDING = 4e-16  # of one product and one quotient in double precision
whites = st.lists(st.floats(0.01, 1.0), min_size=4, max_size=4)
starts = st.integers(-5, 7)


def seen(reflectance, white, mask, first=(0, 0)):
    """The mosaic of grey reflectances under a white."""
    planes = np.asarray(white)[: len(mask.channels), None, None] * reflectance
    return cfa.pick(planes, mask, *first)


def reflectances(shape, seed=0):
    return np.random.default_rng(seed).uniform(0.05, 0.9, shape)


@given(name=st.sampled_from(NAMES), white=whites, row=starts, column=starts)
@settings(max_examples=60, deadline=None)
def test_a_grey_scene_is_one_plane_behind_the_balance_whatever_the_mask_and_the_window(name, white, row, column):
    mask = cfa.parse(name)
    white = np.array(white[: len(mask.channels)])
    grey = reflectances((12, 13))
    gains = white_balance.gains_of(white)
    found = white_balance.balanced(seen(grey, white, mask, (row, column)), gains, mask, row, column)
    assert_allclose(found, white.max() * grey, rtol=3 * ROUNDING)


def test_the_channel_that_clips_first_keeps_its_bits_and_all_end_at_one():
    mask = cfa.parse("RGGB")
    mosaic = np.random.default_rng(1).uniform(-0.01, 1.0, (20, 22)).astype(np.float32)
    mosaic[5, 5] = mosaic[4, 5] = mosaic[4, 6] = 1.0
    gains = white_balance.gains_of([0.5, 0.8, 0.3])
    found = white_balance.balanced(mosaic, gains, mask, ceiling=1.0)
    green = cfa.channel_index(mask, *mosaic.shape) == 1
    assert found.dtype == np.float32
    assert_array_equal(found[green], mosaic[green])
    assert found[4, 5] == found[5, 5] == found[4, 6] == 1.0  # clipped everywhere: white, not magenta
    assert found.max() == 1.0
    assert white_balance.balanced(mosaic, gains, mask).max() == pytest.approx(0.8 / 0.3, rel=1e-6)  # kept


@given(name=st.sampled_from(NAMES), white=whites, first=st.tuples(starts, starts), cell=st.integers(1, 7))
@settings(max_examples=60, deadline=None)
def test_flat_grey_shows_its_white_to_every_method(name, white, first, cell):
    mask = cfa.parse(name)
    white = np.array(white[: len(mask.channels)])
    means, cells = white_balance.cell_means(
        seen(np.full((24, 26), 0.5), white, mask, first), mask, cell, 0.98, 0.0, *first
    )
    assert means.shape == (len(white), cells)
    for found in (
        white_balance.grey_world(means),
        white_balance.grey_world(means, 6.0),
        white_balance.white_patch(means),
    ):
        assert white_balance.angle_between(found, white) < 1e-12  # degrees: means and powers of equal numbers


@given(gain=st.lists(st.floats(0.1, 10.0), min_size=3, max_size=3), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_a_filter_in_front_of_a_channel_changes_that_channel_of_the_estimate_and_no_other(gain, seed):
    mask = cfa.parse("GRBG")
    mosaic = np.random.default_rng(seed).uniform(0.01, 0.09, (16, 16))
    filtered = white_balance.balanced(mosaic, gain, mask)
    for method in (white_balance.grey_world, lambda m: white_balance.grey_world(m, 4.0), white_balance.white_patch):
        plain, changed = (method(white_balance.cell_means(m, mask, 4, 0.98, 0.0)[0]) for m in (mosaic, filtered))
        assert_allclose(changed, plain * np.array(gain), rtol=1e-13)  # sums of 16 to 256 terms


def test_shades_of_grey_lie_between_the_mean_and_the_brightest_cell():
    means = reflectances((3, 50), 3)
    powers = [white_balance.grey_world(means, p) for p in (1.0, 2.0, 6.0, 100.0)]
    assert_array_equal(powers[0], means.mean(axis=1))
    assert all(np.all(b > a) for a, b in pairwise(powers))  # power means ascend
    brightest = white_balance.white_patch(means, 1.0)
    assert np.all(powers[-1] <= brightest) and np.all(powers[-1] >= brightest * 50 ** (-1 / 100))  # n^(-1/p) at worst


def test_what_clips_in_one_channel_is_left_out_of_all():
    """Green clips first. Left out pixel by pixel it would lack what is bright, and the white would lean away from
    it.
    """
    mask, white = cfa.parse("RGGB"), np.array([0.5, 1.6, 0.7])
    grey = np.repeat(np.repeat(reflectances((20, 20), 4), 4, axis=0), 4, axis=1)
    mosaic = np.minimum(seen(grey, white, mask), 1.0)
    means, cells = white_balance.cell_means(mosaic, mask, 4, 0.98, 0.0)
    assert 0.3 * cells < means.shape[1] < 0.9 * cells
    assert white_balance.angle_between(white_balance.grey_world(means), white) < 1e-12
    index = cfa.channel_index(mask, *mosaic.shape)
    alone = [mosaic[(index == k) & (mosaic < 0.98)].mean() for k in range(3)]
    assert white_balance.angle_between(alone, white) > 3


@given(angle=st.floats(1e-12, 180.0), level=st.floats(1e-6, 1e6))
def test_the_angle_between_two_whites_is_that_of_a_turn_whatever_their_level(angle, level):
    turned = [np.cos(np.radians(angle)), 0.0, np.sin(np.radians(angle))]
    found = white_balance.angle_between([level, 0.0, 0.0], turned)
    assert found == pytest.approx(angle, rel=1e-14, abs=1e-13)  # 1e-13 degrees: the turn's own cosine and sine near 180


def test_a_vanishing_channel_is_refused_or_lifted_and_counted():
    for white in ([0.4, 0.0, 0.3], [0.4, -0.1, 0.3], [0.4, 1e-12, 0.3]):
        with pytest.raises(ValueError, match="vanishing"):
            white_balance.lifted(white, 0.0)
        with pytest.raises(ValueError, match="vanishing"):
            white_balance.gains_of(white)
        found, count = white_balance.lifted(white, 0.05)
        assert_allclose(found, [0.4, 0.02, 0.3], rtol=1e-15)
        assert count == 1
    assert white_balance.lifted([0.4, 0.3, 0.35], 0.05)[1] == 0
    for nothing in ([0.0, 0.0, 0.0], [-1.0, -1.0, -2.0], [np.nan, 1.0, 1.0], [np.inf, 1.0, 1.0]):
        with pytest.raises(ValueError, match="above 0"):
            white_balance.lifted(nothing, 0.05)


def test_frames_in_which_no_white_can_be_seen_are_refused_with_the_reason():
    bayer = cfa.parse("RGGB")
    for shape in ((1, 1), (1, 9), (9, 1)):
        with pytest.raises(ValueError, match="no pixels of channel"):
            white_balance.cell_means(np.full(shape, 0.5), bayer, 4, 0.98, 0.0)
    assert white_balance.cell_means(np.full((2, 2), 0.5), bayer, 4, 0.98, 0.0)[0].shape == (3, 1)
    for level, shown in ((0.0, 0), (1.0, 0), (0.5, 9)):
        assert white_balance.cell_means(np.full((12, 12), level), bayer, 4, 0.98, 0.01)[0].shape[1] == shown
    with pytest.raises(ValueError, match="finite"):
        white_balance.cell_means(np.array([[0.1, np.nan], [0.2, 0.3]]), bayer, 4, 0.98, 0.0)
    for method in (white_balance.grey_world, white_balance.white_patch):
        with pytest.raises(ValueError, match="at least one cell"):
            method(np.empty((3, 0)))


def test_arguments_out_of_range_are_named():
    mask, flat = cfa.parse("RGGB"), np.full((4, 4), 0.5)
    for call, text in (
        (lambda: white_balance.cell_means(flat, mask, 0, 0.98, 0.0), "cell is 0"),
        (lambda: white_balance.grey_world(np.ones((3, 2)), 0.5), "power is 0.5"),
        (lambda: white_balance.grey_world(np.ones((3, 2)), np.inf), "power is inf"),
        (lambda: white_balance.white_patch(np.ones((3, 2)), 0.0), "quantile is 0.0"),
        (lambda: white_balance.lifted([1.0, 1.0], 1.0), "floor is 1.0"),
        (lambda: white_balance.balanced(flat, [1.0, 2.0], mask), "gains"),
        (lambda: white_balance.angle_between([1.0, 0.0], [1.0, 0.0, 0.0]), "channels"),
        (lambda: white_balance.angle_between([0.0, 0.0], [1.0, 0.0]), "not all 0"),
    ):
        with pytest.raises(ValueError, match=text):
            call()
