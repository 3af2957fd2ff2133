"""The best demosaicer: what it keeps, what it is blind to, and that its estimators are what they claim."""

import itertools
import warnings
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import special

from etendue_camera.mosaic import bilinear
from etendue_camera.mosaic import frame as demosaic_frame
from etendue_camera.mosaic import residual as demosaic_residual
from etendue_camera.mosaic.directional import directional
from etendue_camera.mosaic.residual import REACH, residual
from etendue_camera.sensor import cfa

SMALL = [(1, 1), (1, 2), (2, 1), (1, 7), (6, 1), (2, 2), (2, 3), (3, 2), (3, 3), (5, 8), (31, 4)]
FLIPPED_ROWS = {"RGGB": "GBRG", "GBRG": "RGGB", "BGGR": "GRBG", "GRBG": "BGGR"}
FLIPPED_COLUMNS = {"RGGB": "GRBG", "GRBG": "RGGB", "BGGR": "GBRG", "GBRG": "BGGR"}
TRANSPOSED = {"RGGB": "RGGB", "BGGR": "BGGR", "GRBG": "GBRG", "GBRG": "GRBG"}
INSIDE = np.s_[:, REACH:-REACH, REACH:-REACH]

patterns = st.sampled_from(cfa.BAYER)
seeds = st.integers(0, 2**32 - 1)
shapes = st.tuples(st.integers(2, 12), st.integers(2, 12))
few = settings(max_examples=25, deadline=None)


def noise(shape, seed):
    return np.random.default_rng(seed).uniform(0.0, 1.0, shape)


@lru_cache
def discs(seed, shape=(160, 170), colours=1.0):
    """Dead leaves: discs of power-law sizes that cover one another, each with a grating; `colours` is their
    saturation.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[0], : shape[1]]
    planes = np.zeros((3, *shape))
    for _ in range(700):
        radius = 3.0 / np.sqrt(1e-3 + rng.uniform())
        down, right = y - rng.uniform(0, shape[0]), x - rng.uniform(0, shape[1])
        hue = 0.5 + colours * rng.uniform(-0.4, 0.4, 3) + rng.uniform(-0.1, 0.1)
        angle, period = rng.uniform(0, np.pi), rng.uniform(3.5, 12.0)
        grating = 1 + 0.3 * np.cos(2 * np.pi * (np.cos(angle) * down + np.sin(angle) * right) / period)
        cover = np.clip(radius - np.hypot(down, right) + 0.5, 0, 1)  # an edge one pixel wide
        planes = planes * (1 - cover) + np.clip(hue, 0.02, 1)[:, None, None] * grating * cover
    return planes


def decibels(found, truth, border=10):
    inner = np.s_[:, border:-border, border:-border]
    return -10 * np.log10(np.mean((found[inner] - truth[inner]) ** 2))


@pytest.mark.parametrize("pattern", cfa.BAYER)
@pytest.mark.parametrize("shape", SMALL)
def test_frames_of_all_sizes_are_filled_and_measured_samples_untouched(pattern, shape):
    raw = noise(shape, 7) - 0.3
    before = raw.copy()
    planes = residual(raw, pattern)
    assert planes.shape == (3, *shape) and np.isfinite(planes).all()
    assert_array_equal(cfa.pick(planes, pattern), raw)
    assert_array_equal(raw, before)
    if 1 in shape:
        assert_array_equal(planes, bilinear.colour_difference(raw, pattern))


@few
@given(pattern=patterns, shape=shapes, seed=seeds)
def test_mirrored_and_transposed_scenes_give_mirrored_and_transposed_pictures(pattern, shape, seed):
    raw = noise(shape, seed)
    planes = residual(raw, pattern)
    assert_allclose(
        residual(raw.T, TRANSPOSED[pattern]), planes.swapaxes(1, 2), rtol=0, atol=1e-12
    )  # some 1e3 roundings, amplified
    below = FLIPPED_ROWS[pattern] if shape[0] % 2 == 0 else pattern
    beside = FLIPPED_COLUMNS[pattern] if shape[1] % 2 == 0 else pattern
    assert_array_equal(residual(raw[::-1], below), planes[:, ::-1])
    assert_array_equal(residual(raw[:, ::-1], beside), planes[:, :, ::-1])


@few
@given(pattern=patterns, shape=shapes, seed=seeds, exponent=st.integers(-400, 400))
def test_the_method_has_no_unit_and_no_sign_and_treats_red_and_blue_alike(pattern, shape, seed, exponent):
    raw = noise(shape, seed)
    planes = residual(raw, pattern)
    assert_array_equal(residual(raw * 2.0**exponent, pattern), planes * 2.0**exponent)
    assert_allclose(residual(raw * 0.3, pattern), planes * 0.3, rtol=0, atol=1e-12)  # roundings before and after
    assert_array_equal(residual(-raw, pattern), -planes)
    assert_array_equal(residual(raw, pattern.translate(str.maketrans("RB", "BR"))), planes[::-1])


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize("column", [0, 1])
def test_a_window_sees_what_the_whole_frame_shows_from_any_phase_of_the_array(row, column):
    raw = noise((2 * REACH + 23, 2 * REACH + 32), 11)
    whole = residual(raw, "RGGB")
    rows = ("RGGB", "GBRG")[row]
    pattern = FLIPPED_COLUMNS[rows] if column else rows
    part = residual(raw[row:, column:], pattern)
    assert_array_equal(part[INSIDE], whole[:, row + REACH : -REACH, column + REACH : -REACH])


@pytest.mark.parametrize(("pixels", "width"), [(900, 30), (64, 16), (2**12, 200)])
def test_tiles_leave_no_trace(pixels, width, monkeypatch):
    raw = noise((49, 70), 3)
    whole = residual(raw, "GBRG")
    monkeypatch.setattr(demosaic_frame, "TILE_PIXELS", pixels)
    monkeypatch.setattr(demosaic_frame, "TILE_WIDTH", width)
    assert_array_equal(residual(raw, "GBRG"), whole)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.9])
def test_what_stands_in_one_pixel_reaches_no_farther_than_it_says(value):
    raw = noise((2 * REACH + 31, 2 * REACH + 20), 5)
    y, x = REACH + 15, REACH + 9
    other = raw.copy()
    other[y, x] = value
    changed = (residual(other, "BGGR") != residual(raw, "BGGR")).any(axis=0)
    rows, columns = np.nonzero(changed)
    assert max(abs(rows - y).max(), abs(columns - x).max()) <= REACH
    assert_array_equal(cfa.pick(residual(other, "BGGR"), "BGGR"), other)  # what was measured beside it is still there


@pytest.mark.parametrize("pattern", cfa.BAYER)
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_constant_colours_stay_constant_up_to_the_border(pattern, kind):
    planes = np.broadcast_to(np.array([0.3, 0.7, 0.1], kind)[:, None, None], (3, 21, 26))
    assert_allclose(residual(cfa.pick(planes, pattern), pattern), planes, rtol=0, atol=4 * np.finfo(kind).eps)
    assert not residual(np.zeros((9, 8), kind), pattern).any()


def test_linear_planes_are_exact_inside_the_border():
    y, x = np.mgrid[: 2 * REACH + 20, : 2 * REACH + 30]
    planes = np.stack([0.1 + 1e-3 * y + 3e-3 * x, 0.6 - 2e-3 * y + 1e-3 * x, 0.9 + 5e-4 * y - 2e-3 * x])
    found = residual(cfa.pick(planes, "GRBG"), "GRBG")
    # half-lines to the left and the right differ by their floors, which follow the level: a little of the slope stays
    assert_allclose(found[INSIDE], planes[INSIDE], rtol=0, atol=3e-7)


@pytest.mark.parametrize("across", [0, 1])
def test_a_grey_grating_along_an_axis_is_restored_to_one_percent(across):
    line = noise(140, 4)
    grey = np.broadcast_to(line if across else line[:, None], (140, 140)).copy()
    errors = [np.abs(method(grey, "RGGB") - grey)[INSIDE].max() for method in (residual, bilinear.colour_difference)]
    assert errors[0] < 0.01 < 0.3 < errors[1]  # the floor of the weights is 1 % of the level


@pytest.mark.parametrize("frame", ["noise", "blocks", "points", "bars", "black", "dark noise", "greens apart"])
def test_single_precision_is_close(frame):
    rng = np.random.default_rng(8)
    n = 96
    raw = {
        "noise": lambda: rng.uniform(size=(n, n)),
        "blocks": lambda: np.kron(rng.integers(0, 2, (12, 12)), np.ones((8, 8))),
        "points": lambda: (rng.uniform(size=(n, n)) < 0.02) * rng.uniform(size=(n, n)),
        "bars": lambda: np.repeat(rng.integers(0, 2, (1, n)), n, axis=0),
        "black": lambda: np.zeros((n, n)),
        "dark noise": lambda: rng.normal(0.0, 1e-3, (n, n)),
        "greens apart": lambda: np.tile([[0.4, 0.3], [0.2, 0.5]], (n // 2, n // 2)),
    }[frame]()
    single = raw.astype(np.float32)
    found = residual(single, "GRBG")
    assert found.dtype == np.float32
    # 1e-5 is the largest difference in some 500 such frames; it comes up beside points on black
    assert_allclose(found, residual(single.astype(np.float64), "GRBG"), rtol=0, atol=2e-5 * max(abs(raw).max(), 1e-30))


@pytest.mark.parametrize("peak", [1e-44, 1e-30, 1e-5, 1e30, 6e37])
def test_extremes_of_single_precision_stay_finite_and_silent(peak):
    raw = (noise((20, 22), 6) * peak).astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        planes = residual(raw, "RGGB")
    assert np.isfinite(planes).all()
    assert_array_equal(cfa.pick(planes, "RGGB"), raw)


def test_integers_and_half_precision_are_taken():
    raw = np.random.default_rng(1).integers(0, 255, (12, 13), dtype=np.uint8)
    assert residual(raw, "RGGB").dtype == np.float64
    assert_array_equal(residual(raw, "RGGB"), residual(raw.astype(float), "RGGB"))
    half = (raw / 255).astype(np.float16)
    assert residual(half, "RGGB").dtype == np.float16
    assert_allclose(
        residual(half, "RGGB"), residual(half.astype(float), "RGGB"), rtol=1e-3, atol=1e-4
    )  # half precision has 11 bits


def test_what_is_no_bayer_mosaic_is_refused():
    with pytest.raises(ValueError, match=r"shape \(3, 4, 4\)"):
        residual(np.ones((3, 4, 4)), "RGGB")
    with pytest.raises(ValueError, match="'RGBG'; allowed: RGGB"):
        residual(np.ones((4, 4)), "RGBG")


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("colours", [0.0, 1.0])
def test_it_is_nearer_to_the_truth_than_the_directional_method_on_grey_and_on_coloured_discs(colours, seed):
    truth = discs(seed, colours=colours)
    raw = cfa.pick(truth, "GRBG")
    found, peer, plain = (decibels(m(raw, "GRBG"), truth) for m in (residual, directional, bilinear.bilinear))
    assert found > peer + 0.5
    assert found > plain + 1


@pytest.mark.parametrize("colours", [0.0, 1.0])
def test_shot_noise_does_not_mislead_it(colours):
    """400 electrons at 1: a signal-to-noise ratio of 20 in white. Averages fare well there, and it is no worse."""
    truth = discs(3, colours=colours)
    raw = np.random.default_rng(0).poisson(400 * cfa.pick(truth, "GRBG")) / 400
    assert decibels(residual(raw, "GRBG"), truth) > decibels(bilinear.bilinear(raw, "GRBG"), truth)


def dark_corner(ratio, angle, place, blur, n=72):
    """A grey corner, 1 / ratio of what is around it, behind a Gaussian blur, and how deep in it each pixel stands."""
    fine = (np.arange(4 * n) + 0.5) / 4 - n / 2
    down, right = fine[:, None] - place[0], fine - place[1]
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    depth = np.minimum(c * down - s * right, s * down + c * right)
    edges = [0.5 * special.erfc(-d / blur / np.sqrt(2)) for d in (c * down - s * right, s * down + c * right)]
    grey = 1 - (1 - 1 / ratio) * edges[0] * edges[1]
    grey, depth = (a.reshape(n, 4, n, 4).mean((1, 3)) for a in (grey, depth))
    depth[60:] = depth[:, 60:] = 0  # mirrored at the border, tilted edges bend
    return np.broadcast_to(grey, (3, n, n)), depth


@pytest.mark.parametrize("ratio", [5, 20, 50])
def test_no_light_wanders_into_a_dark_corner_as_colour(ratio):
    """R/B and G/B are bilinear's to 0.45 % x ratio four pixels inside, 0.1 % x ratio from five on: so much of the
    white beside.
    """
    worst = {4: 0.0, 5: 0.0}
    for angle, place in itertools.product((0, 5, 20), ((0, 0), (0.5, 0.25), (1, 0), (0, 1.5))):
        for blur in (0.5, 0.7):
            truth, depth = dark_corner(ratio, angle, place, blur)
            raw = cfa.pick(truth, "RGGB")
            found, plain = (np.log(m(raw, "RGGB")[:, depth > 4]) for m in (residual, bilinear.bilinear))
            wrong = np.abs((found[:2] - found[2]) - (plain[:2] - plain[2])).max(axis=0)
            worst = {deep: max(most, wrong[depth[depth > 4] > deep].max()) for deep, most in worst.items()}
    assert worst[4] < 0.0045 * ratio
    assert worst[5] < 0.001 * ratio


def test_the_smooth_estimator_knows_its_error():
    """A slow signal in white noise: the estimate beats the samples threefold, and its expected error is that of the
    truth.
    """
    rng = np.random.default_rng(2)
    signal = 0.05 * np.sin(2 * np.pi * np.arange(400) / 60) + np.zeros((300, 1))
    rough = signal + rng.normal(0.0, 0.1, signal.shape)
    slow = demosaic_residual.scaled(demosaic_residual.five(demosaic_residual.five(rough, 1), 1), 1 / 25)
    found, error = demosaic_residual._likeliest(rough, slow, 1, np.full(rough.shape, 1e-30))
    true = np.mean(np.subtract(*demosaic_residual.meet(found, signal)) ** 2)
    assert true < 0.1**2 / 3
    assert_allclose(np.mean(error), true, rtol=0.5)  # variances of nine samples, two of them independent
