"""Visible noise of a flat patch."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.quality.visible_noise import cieluv, visible_noise

WHITE = np.array([0.95047, 1.0, 1.08883])


def _patch(seed, level, size, shape=(32, 32)):
    draw = np.random.default_rng(seed).standard_normal((3, *shape))
    return (level + size * draw) * WHITE[:, None, None]


@given(level=st.floats(1e-6, 2), samples=st.floats(1, 200))
@settings(deadline=None)
def test_a_uniform_patch_has_none(level, samples):
    # the roundings of three planes: of L* = 116 at most, and 13 L* u'
    assert visible_noise(np.full((3, 8, 8), level) * WHITE[:, None, None], WHITE, samples).value < 1e-9


@given(seed=st.integers(0, 2**32 - 1), level=st.floats(0.05, 0.9))
@settings(deadline=None, max_examples=25)
def test_small_noise_counts_in_proportion(seed, level):
    small, twice = (visible_noise(_patch(seed, level, size), WHITE, 30) for size in (1e-5 * level, 2e-5 * level))
    assert_allclose(
        twice, 2 * np.array(small), rtol=1e-3
    )  # the curvature of the cube root: 1e-5 over the level, times a few sigma


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=10)
def test_a_larger_distance_and_a_finer_noise_show_less(seed):
    patch = _patch(seed, 0.3, 0.03)
    values = [visible_noise(patch, WHITE, samples).value for samples in (10, 20, 40, 80)]
    assert values == sorted(values, reverse=True)
    coarse = np.repeat(np.repeat(patch[:, ::2, ::2], 2, axis=1), 2, axis=2)
    assert visible_noise(coarse, WHITE, 40).value > visible_noise(patch, WHITE, 40).value


def test_the_value_is_the_weighted_sum_of_the_three_spreads():
    found = visible_noise(_patch(0, 0.3, 0.02), WHITE, 30)
    assert_allclose(found.value, found.lightness + 0.852 * found.u + 0.323 * found.v, rtol=1e-15)


def test_noise_of_luminance_alone_has_no_colour_seen_close():
    # seen close there is no blur: greys of the white's own chromaticity have u* = v* = 0
    grey = np.random.default_rng(0).uniform(0.2, 0.4, (1, 16, 16)) * WHITE[:, None, None]
    found = visible_noise(grey, WHITE, 1e-9)
    assert found.lightness > 1
    assert found.u + found.v < 1e-9


def test_the_luv_of_white_black_and_a_colour():
    assert_allclose(cieluv(WHITE, WHITE), [100, 0, 0], atol=1e-12)
    assert_allclose(cieluv(np.zeros(3), WHITE), 0)
    # sRGB red (0.4124, 0.2126, 0.0193) under D65: 53.24, 175.01, 37.76 in textbooks, from XYZ of four digits
    assert_allclose(cieluv([0.412456, 0.212673, 0.019334], WHITE), [53.24, 175.01, 37.76], atol=0.02)
    assert cieluv(np.ones((3, 2), np.float32), WHITE).dtype == np.float32


def test_nonsense_is_refused():
    with pytest.raises(ValueError, match="brighter than black"):
        visible_noise(np.zeros((3, 4, 4)), WHITE, 30)
    with pytest.raises(ValueError, match="samples is 0"):
        visible_noise(np.ones((3, 4, 4)), WHITE, 0)
    with pytest.raises(ValueError, match="white_xyz"):
        visible_noise(np.ones((3, 4, 4)), [1, 0, 1], 30)
