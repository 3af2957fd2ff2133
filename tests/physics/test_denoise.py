"""Denoising takes known noise away where nothing else is, and touches nothing else."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.restoration.denoise import denoise

shapes = st.tuples(st.integers(1, 3), st.integers(1, 12), st.integers(1, 12))
seeds = st.integers(0, 2**32 - 1)
radii = st.integers(1, 5)


@given(shape=shapes, seed=seeds, radius=radii)
def test_without_noise_nothing_changes(shape, seed, radius):
    planes = np.random.default_rng(seed).normal(0, 1, shape)
    assert_array_equal(denoise(planes, 0.0, 0.0, radius), planes)
    assert_array_equal(denoise(planes, 1.0, 1.0, radius, strength=0.0), planes)


@given(shape=shapes, seed=seeds, radius=radii, shot=st.floats(0, 10), floor=st.floats(0, 10))
def test_the_sum_of_every_plane_is_kept(shape, seed, radius, shot, floor):
    planes = np.random.default_rng(seed).normal(0.5, 1, shape)
    got = denoise(planes, shot, floor, radius)
    assert_allclose(got.sum(axis=(1, 2)), planes.sum(axis=(1, 2)), rtol=0, atol=1e-14 * np.abs(planes).sum() + 1e-15)


@given(value=st.floats(-1e6, 1e6), shape=shapes, radius=radii)
def test_a_constant_is_kept(value, shape, radius):
    # running sums of equal values, and a mean that is taken away and put back
    assert_allclose(denoise(np.full(shape, value), 0.01, 0.01, radius), value, rtol=1e-14)


@given(shape=shapes, seed=seeds)
def test_with_overwhelming_noise_each_pixel_is_the_mean_of_means(shape, seed):
    planes = np.random.default_rng(seed).uniform(0, 1, shape)
    box = np.ones((3, 3)) / 9
    windows = planes
    for _ in range(2):
        padded = np.pad(windows, ((0, 0), (1, 1), (1, 1)), mode="symmetric")
        windows = (np.lib.stride_tricks.sliding_window_view(padded, (3, 3), axis=(1, 2)) * box).sum(axis=(-1, -2))
    assert_allclose(denoise(planes, 0.0, 1e6, 1), windows, rtol=1e-13)


@pytest.mark.parametrize("radius", [1, 2, 4])
def test_on_flat_ground_noise_falls_and_more_so_in_larger_windows(radius):
    sigma = 0.05
    flat = 0.5 + sigma * np.random.default_rng(radius).standard_normal((200, 200))
    left = denoise(flat, 0.0, sigma**2, radius)[20:-20, 20:-20].std() / sigma
    # a window's own variance is above the noise's half of the time, by about sqrt(2/n) of it: that much is taken for
    # picture
    pixels = (2 * radius + 1) ** 2
    assert left < 1.1 / math.sqrt(pixels) + 0.45 * math.sqrt(2 / pixels)


def test_noise_is_known_by_brightness():
    """Shot noise on two fields: each loses what its own level says, with one constant."""
    rng, shot = np.random.default_rng(0), 1e-3
    for level in (0.02, 0.9):
        field = level + np.sqrt(shot * level) * rng.standard_normal((120, 120))
        ratio = denoise(field, shot, 0.0, 2)[10:-10, 10:-10].std() / math.sqrt(shot * level)
        assert 0.15 < ratio < 0.35


def test_an_edge_far_above_the_noise_stays():
    edge = np.where(np.arange(40) < 20, 0.2, 0.8) * np.ones((30, 1))
    sigma = 0.005
    got = denoise(edge, 0.0, sigma**2, 2)
    # in windows that hold the edge a share of noise over variance goes to the mean: (0.005 / 0.3)^2 at a half, more at
    # a fifth
    assert np.abs(got - edge).max() < 0.6 * (sigma**2 / (0.6**2 * 0.2 * 0.8))


def test_the_picture_with_noise_comes_nearer_to_the_one_without():
    y, x = np.mgrid[:100, :100]
    clean = 0.4 + 0.2 * np.sin(x / 9) + 0.3 * (y + 0.3 * x > 60)
    for sigma in (0.01, 0.03, 0.1):
        noisy = clean + sigma * np.random.default_rng(1).standard_normal(clean.shape)
        # least is won where the waves themselves vary more than the noise does
        assert np.std(denoise(noisy, 0.0, sigma**2, 2) - clean) < (0.8 if sigma < 0.02 else 0.65) * sigma


def test_a_faint_variation_on_a_bright_ground_is_seen_in_both_precisions():
    """Variances of 1e-10 beside squares of 1: taken about the mean, they keep six digits."""
    waves = 1000.0 + 1e-5 * np.sin(np.arange(64) / 3) * np.ones((16, 1))
    got = denoise(waves, 0.0, 1e-14, 2)
    assert np.abs(got - waves).max() < 1e-7
    planes = np.random.default_rng(3).uniform(0, 1, (2, 40, 50))
    single = denoise(planes.astype(np.float32), 1e-3, 1e-4, 2)
    assert single.dtype == np.float32
    assert (
        np.abs(single - denoise(planes, 1e-3, 1e-4, 2)).max() < 5e-7
    )  # the input's own rounding, 6e-8, through a ratio of variances


def test_input_is_not_written_and_nonsense_is_refused():
    planes = np.random.default_rng(0).uniform(0, 1, (5, 5))
    planes.flags.writeable = False
    denoise(planes, 0.1, 0.1)
    for values, name in (
        ((-1.0, 0.0), "shot"),
        ((0.0, math.nan), "floor"),
        ((0.1, 0.1, 0), "radius"),
        ((0.1, 0.1, 1.5), "radius"),
        ((0.1, 0.1, 1, -2.0), "strength"),
    ):
        with pytest.raises(ValueError, match=f"{name} is"):
            denoise(planes, *values)
    with pytest.raises(ValueError, match="planes has shape"):
        denoise(np.zeros(3), 0.1, 0.1)
