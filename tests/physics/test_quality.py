"""PSNR, SSIM and the figures of a map."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.quality import fidelity


def _pair():
    y, x = np.mgrid[:24, :29].astype(float)
    reference = np.stack(
        [
            0.5 + 0.5 * np.sin(0.7 * x + 0.2 * y),
            ((3 * x + 5 * y) % 17) / 16,
            np.exp(-((x - 14) ** 2 + (y - 12) ** 2) / 40),
        ]
    )
    return np.clip(reference + 0.1 * np.cos(1.9 * x * y / 10 + np.arange(3)[:, None, None]), 0, 1), reference


def _random(seed, shape=(3, 14, 17)):
    return np.random.default_rng(seed).uniform(0, 1, shape)


@given(offset=st.floats(1e-6, 1.0), peak=st.floats(1e-3, 1e4))
def test_the_psnr_of_a_constant_offset_is_its_share_of_the_peak(offset, peak):
    reference = np.zeros((3, 4, 5))
    # the offset's own square and its logarithm, 300 dB at most
    assert_allclose(
        fidelity.psnr(reference + offset, reference, peak), 20 * np.log10(peak / offset), rtol=1e-13, atol=1e-12
    )


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(1e-3, 1e3))
def test_measures_of_error_do_not_depend_on_the_unit(seed, scale):
    picture, reference = _random(seed), _random(seed + 1)
    assert_allclose(
        fidelity.psnr(scale * picture, scale * reference, scale), fidelity.psnr(picture, reference), atol=1e-11
    )
    # roundings of squares near 1 against a variance near 1/12
    assert_allclose(
        fidelity.ssim(scale * picture, scale * reference, scale), fidelity.ssim(picture, reference), atol=1e-12
    )


@given(seed=st.integers(0, 2**32 - 1))
def test_measures_of_error_are_the_same_both_ways_and_when_both_pictures_are_turned(seed):
    picture, reference = _random(seed), _random(seed + 1)
    for measure in (fidelity.psnr, fidelity.ssim):
        assert_allclose(
            measure(picture, reference), measure(reference, picture), rtol=1e-14, atol=1e-14
        )  # SSIM passes through 0
        turned = measure(np.rot90(picture, axes=(1, 2)), np.rot90(reference, axes=(1, 2)))
        assert_allclose(turned, measure(picture, reference), rtol=1e-12, atol=1e-13)  # the order of the sums changes


def test_a_picture_is_equal_to_itself():
    picture, _ = _pair()
    assert fidelity.psnr(picture, picture) == np.inf
    assert_allclose(fidelity.ssim_map(picture, picture), 1.0, rtol=4e-15)  # cross and square sums round apart


def test_single_precision_pictures_are_summed_in_double():
    # a float32 sum of 4 million squares near 1e-2 keeps 4 digits; the mean square is that of the float32 values
    # themselves
    rng = np.random.default_rng(0)
    picture = rng.uniform(0, 1, (2000, 2000)).astype(np.float32)
    reference = np.zeros_like(picture)
    exact = -10 * np.log10(np.mean(picture.astype(np.longdouble) ** 2))
    assert_allclose(fidelity.psnr(picture, reference), float(exact), atol=1e-12)


def test_the_figures_of_scikit_image_are_held():
    # scikit-image 0.26.0: structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    # data_range=1) and peak_signal_noise_ratio of the same arrays
    picture, reference = _pair()
    assert_allclose(fidelity.ssim(picture, reference), float.fromhex("0x1.dfd62337b75f4p-1"), rtol=1e-13)
    each = [fidelity.ssim(*planes) for planes in zip(picture, reference, strict=True)]
    assert_allclose(each, [0.9754288745977054, 0.9761372754091348, 0.8599756949847651], rtol=1e-13)
    assert_allclose(fidelity.psnr(picture, reference), 23.741177689691852, rtol=1e-14)


def test_ssim_is_equation_13_under_the_window():
    # Wang et al. 2004, written out for one place
    picture, reference = _random(3, (11, 11)), _random(4, (11, 11))
    axis = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    w = np.outer(axis, axis) / axis.sum() ** 2
    mean_x, mean_y = (w * picture).sum(), (w * reference).sum()
    var_x, var_y = (w * (picture - mean_x) ** 2).sum(), (w * (reference - mean_y) ** 2).sum()
    cross = (w * (picture - mean_x) * (reference - mean_y)).sum()
    c1, c2 = 0.01**2, 0.03**2
    expected = (2 * mean_x * mean_y + c1) * (2 * cross + c2) / ((mean_x**2 + mean_y**2 + c1) * (var_x + var_y + c2))
    assert_allclose(fidelity.ssim_map(picture, reference), [[expected]], rtol=1e-12)


def test_lost_contrast_lowers_ssim_and_a_reversed_picture_is_below_zero():
    _, reference = _pair()
    mean = reference.mean(axis=(1, 2), keepdims=True)
    values = [fidelity.ssim(mean + share * (reference - mean), reference) for share in (1, 0.7, 0.4, 0.1, -1)]
    assert values == sorted(values, reverse=True)
    assert values[-1] < 0


def test_the_spread_of_a_map_is_its_mean_median_and_95_percent_point():
    values = np.arange(101, dtype=np.float32).reshape(1, 101)
    assert fidelity.spread(values) == (50.0, 50.0, 95.0)
    assert np.isnan(fidelity.spread(np.array([[1.0, np.nan]]))).all()


def test_nonsense_is_refused():
    a = np.zeros((3, 12, 12))
    with pytest.raises(ValueError, match="picture has shape"):
        fidelity.psnr(a, a[:, :5])
    with pytest.raises(ValueError, match="at least one pixel"):
        fidelity.psnr(a[:, :0], a[:, :0])
    with pytest.raises(ValueError, match="peak is 0"):
        fidelity.ssim(a, a, 0)
    with pytest.raises(ValueError, match="the window of SSIM"):
        fidelity.ssim(a[:, :10], a[:, :10])
    with pytest.raises(ValueError, match="values is empty"):
        fidelity.spread([])
