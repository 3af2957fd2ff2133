"""Directions are told apart by how alike colour differences stay along them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import convolve1d

from etendue_camera.mosaic import bilinear
from etendue_camera.mosaic.directional import FLOOR, directional
from etendue_camera.sensor import cfa

patterns = st.sampled_from(cfa.BAYER)
seeds = st.integers(0, 2**32 - 1)


def noise(shape, seed):
    return np.random.default_rng(seed).uniform(0.0, 1.0, shape)


def as_described(raw, pattern, floor):
    """Steps 1 to 4 of the module on full frames, each as a convolution of a mirrored frame."""
    colour = cfa.channel_index(pattern, *raw.shape)
    sign = np.where(colour == 1, -1.0, 1.0)
    estimates, dissimilar = [], []
    for axis in (1, 0):
        k = sign * convolve1d(raw, [-0.25, 0.5, -0.5, 0.5, -0.25], axis=axis, mode="mirror")
        step = np.abs(convolve1d(k, [1.0, 0.0, -1.0], axis=axis, mode="mirror"))
        window = np.array([1, 2, 2, 2, 1]) / 8
        for along in (0, 1):
            step = convolve1d(step, window, axis=along, mode="mirror")
        estimates.append(convolve1d(k, [0.25, 0.5, 0.25], axis=axis, mode="mirror"))
        dissimilar.append((step + floor) ** -2)
    k = (estimates[0] * dissimilar[0] + estimates[1] * dissimilar[1]) / (dissimilar[0] + dissimilar[1])
    green = np.where(colour == 1, raw, raw + k)
    planes = [None, green, None]
    for number in (0, 2):
        differences = np.where(colour == number, k, 0.0)
        for axis in (0, 1):
            differences = convolve1d(differences, [0.5, 1.0, 0.5], axis=axis, mode="mirror")
        planes[number] = np.where(colour == number, raw, green - differences)
    return np.stack(planes)


@given(
    pattern=patterns,
    rows=st.integers(2, 17),
    columns=st.integers(2, 17),
    seed=seeds,
    floor=st.sampled_from([1e-9, FLOOR, 0.1]),
)
def test_it_is_what_its_description_says_at_every_pixel_and_size(pattern, rows, columns, seed, floor):
    raw = noise((rows, columns), seed)
    # weights round where both directions are nearly without difference: in frames of a few pixels that are their own
    # mirror image
    assert_allclose(
        directional(raw, pattern, floor), as_described(raw, pattern, floor), rtol=0, atol=2e-14 + 1e-15 * 1e-3 / floor
    )


@given(pattern=patterns, seed=seeds, exponent=st.integers(-12, 12))
def test_the_unit_of_the_mosaic_does_not_matter_when_the_floor_has_it_too(pattern, seed, exponent):
    raw, scale = noise((11, 12), seed), 2.0**exponent
    assert_array_equal(directional(scale * raw, pattern, scale * FLOOR), scale * directional(raw, pattern))


@given(pattern=patterns, seed=seeds, across=st.sampled_from([0, 1]))
def test_a_grey_grating_along_an_axis_is_restored_as_the_square_of_the_floor(pattern, seed, across):
    line = noise(26, seed)
    grey = np.broadcast_to(line if across else line[:, None], (26, 26))
    inner = np.s_[:, 6:-6, 6:-6]
    errors = [np.abs(directional(grey.copy(), pattern, floor) - grey)[inner].max() for floor in (1e-4, 5e-5, 1e-9)]
    # the wrong direction has the weight 1 / (1 + (1 + d / floor)^2), whose next term is 2 floor / d, d being some 0.3
    assert_allclose(errors[0] / errors[1], 4.0, rtol=0.05)
    assert errors[2] < 1e-14  # values up to 1
    assert np.abs(bilinear.colour_difference(grey.copy(), pattern) - grey)[inner].max() > 10 * errors[0]


def test_a_floor_above_all_differences_gives_rows_and_columns_equal_parts():
    raw = noise((20, 22), 5)
    blind, described = directional(raw, "RGGB", 1e9), as_described(raw, "RGGB", 1e9)
    assert_allclose(blind, described, rtol=0, atol=1e-14)
    # without a choice the method is linear
    other = noise((20, 22), 6)
    assert_allclose(directional(raw + other, "RGGB", 1e9), blind + directional(other, "RGGB", 1e9), rtol=0, atol=1e-8)


@given(pattern=patterns, length=st.integers(2, 12), seed=seeds, upright=st.booleans())
def test_a_line_is_the_row_of_a_picture_that_has_nothing_else_to_say(pattern, length, seed, upright):
    """Many copies of a line agree along columns only where all is grey; along rows they hold the line's own
    estimate.
    """
    raw = noise((1, length), seed)
    planes = directional(raw.T.copy() if upright else raw, pattern)
    planes = planes.swapaxes(1, 2) if upright else planes
    order = [pattern[0], pattern[2 if upright else 1]]
    green, other = planes[1, 0], planes["RGB".index(order[1 - order.index("G")]), 0]
    k = np.pad(raw[0], 3, mode="reflect")
    taps = np.array([1, -4, 7, -8, 7, -4, 1]) / 16
    sites = np.arange(length) % 2 != order.index("G")
    assert_allclose(green, np.where(sites, raw[0] + np.convolve(k, taps, mode="valid"), raw[0]), rtol=0, atol=2e-15)
    assert_array_equal(other[sites], raw[0][sites])


def test_single_precision_is_kept_and_close_even_where_greens_differ_on_flat_ground():
    rng = np.random.default_rng(4)
    for floor in (1e-3, 1e-2):
        cell = np.tile([[0.9, 0.2], [0.3, 0.8]], (30, 30))  # two greens that differ by a tenth
        for raw, bound in (
            (rng.uniform(0, 1, (60, 61)), 4e-7),
            (cell + 1e-5 * rng.standard_normal((60, 60)), 4e-7 + 5e-9 / floor),
        ):
            single = directional(raw.astype(np.float32), "GRBG", floor)
            assert single.dtype == np.float32
            # the stage states this: roundings add up to dissimilarity, which counts against the floor
            assert np.abs(single - directional(raw.astype(np.float32).astype(float), "GRBG", floor)).max() < bound


def test_values_far_beyond_the_squares_of_single_precision_are_no_trouble():
    raw = noise((16, 16), 7)
    large = directional((1e30 * raw).astype(np.float32), "RGGB")
    assert np.isfinite(large).all()
    assert_allclose(large, 1e30 * directional(raw, "RGGB", 1e-33), rtol=0, atol=1e30 * 1e-6)


def test_fine_coloured_detail_comes_out_better_than_from_plain_colour_differences():
    """A zone plate seen through three channels of different contrast: both directions and everything between."""
    y, x = np.mgrid[:192, :192] - 95.5
    wave = 0.5 + 0.45 * np.cos(np.pi * (x**2 + y**2) / 420)
    planes = np.stack([0.8 * wave + 0.1, wave, 0.6 * wave])
    raw = cfa.pick(planes, "RGGB")

    def squared(method):
        return np.square(method(raw, "RGGB") - planes)[:, 10:-10, 10:-10].mean()

    # 3 dB and more
    assert squared(directional) < 0.5 * squared(bilinear.colour_difference)
    assert squared(bilinear.colour_difference) < squared(bilinear.bilinear) < squared(bilinear.nearest)


@pytest.mark.parametrize("floor", [0.0, -1.0, np.inf, np.nan])
def test_a_floor_of_nothing_is_refused(floor):
    with pytest.raises(ValueError, match="floor is"):
        directional(np.zeros((4, 4)), "RGGB", floor)
    with pytest.raises(ValueError, match="mosaic has shape"):
        directional(np.zeros((3, 4, 4)), "RGGB")
    with pytest.raises(ValueError, match="RGGB, BGGR, GRBG, GBRG"):
        directional(np.zeros((4, 4)), "RGB")
