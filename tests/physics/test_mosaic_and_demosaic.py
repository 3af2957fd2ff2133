"""The colour filter array takes two thirds away; what may be said about the guesses that put them back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.mosaic import bilinear
from etendue_camera.mosaic.directional import directional
from etendue_camera.sensor import cfa
from tests.physics.reference import extra

METHODS = (bilinear.nearest, bilinear.bilinear, bilinear.colour_difference, directional)
REACH = {bilinear.nearest: 1, bilinear.bilinear: 1, bilinear.colour_difference: 2, directional: 6}
SMALL = [(1, 1), (1, 2), (2, 1), (1, 3), (1, 6), (5, 1), (2, 2), (3, 2), (2, 3), (3, 3), (5, 7), (8, 8)]

patterns = st.sampled_from(cfa.BAYER)
methods = st.sampled_from(METHODS)
shapes = st.tuples(st.integers(1, 9), st.integers(1, 9))
seeds = st.integers(0, 2**32 - 1)
FLIPPED_ROWS = {"RGGB": "GBRG", "GBRG": "RGGB", "BGGR": "GRBG", "GRBG": "BGGR"}
TRANSPOSED = {"RGGB": "RGGB", "BGGR": "BGGR", "GRBG": "GBRG", "GBRG": "GRBG"}


def noise(shape, seed):
    return np.random.default_rng(seed).uniform(0.0, 1.0, shape)


@given(pattern=patterns, shape=shapes, seed=seeds)
def test_each_pixel_keeps_the_colour_the_pattern_names(pattern, shape, seed):
    planes = noise((3, *shape), seed)
    index = cfa.channel_index(pattern, *shape)
    picked = cfa.pick(planes, pattern)
    assert_array_equal(picked, np.take_along_axis(planes, index[None].astype(int), 0)[0])
    for (y, x), colour in np.ndenumerate(index):
        assert "RGB"[colour] == pattern[2 * (y % 2) + x % 2]
        assert (y % 2, x % 2) in cfa.phase(pattern)["RGB"[colour]]


def test_unknown_patterns_are_refused_with_the_four_that_exist():
    for call in (
        lambda: cfa.phase("RGBG"),
        lambda: bilinear.bilinear(np.zeros((4, 4)), "XTRANS"),
    ):
        with pytest.raises(ValueError, match="RGGB, BGGR, GRBG, GBRG"):
            call()
    with pytest.raises(ValueError, match="planes has shape"):
        cfa.pick(np.zeros((2, 4, 4)), "RGGB")
    for shape in ((4,), (0, 4), (3, 4, 4)):
        with pytest.raises(ValueError, match="mosaic has shape"):
            bilinear.nearest(np.zeros(shape), "RGGB")


@pytest.mark.parametrize("case", extra("demosaic_exact"), ids=lambda c: c["pattern_top_left_row_major"])
@pytest.mark.parametrize("name", ["bilinear", "colour_difference_bilinear"])
def test_the_rational_cases_are_exact_in_the_interior(case, name):
    method = bilinear.bilinear if name == "bilinear" else bilinear.colour_difference
    planes = method(np.array(case["mosaic"]), case["pattern_top_left_row_major"])
    first, last = case["rows_cols"]
    # sums of 12-bit integers over 2, 4 and 16 are exact in binary
    assert_array_equal(np.moveaxis(planes, 0, -1)[first:last, first:last], np.array(case[name]))


@given(pattern=patterns, shape=shapes, seed=seeds, method=methods)
def test_measured_samples_are_untouched(pattern, shape, seed, method):
    raw = noise(shape, seed)
    planes = method(raw, pattern)
    assert planes.shape == (3, *shape)
    assert np.isfinite(planes).all()
    assert_array_equal(cfa.pick(planes, pattern), raw)


@pytest.mark.parametrize("shape", SMALL)
@pytest.mark.parametrize("pattern", cfa.BAYER)
def test_a_constant_grey_frame_of_any_size_stays_constant(pattern, shape):
    for method in METHODS:
        # sums of 2 and 4 equal numbers over 2 and 4 are exact
        assert_array_equal(method(np.full(shape, 0.1), pattern), np.full((3, *shape), 0.1))


@given(pattern=patterns, rows=st.integers(2, 9), columns=st.integers(2, 9), method=methods)
def test_constant_colours_stay_constant_up_to_the_border(pattern, rows, columns, method):
    planes = np.broadcast_to(np.array([0.7, 0.2, 0.4])[:, None, None], (3, rows, columns))
    # G - (G - R) rounds at 1e-16, and differences of differences at a few of it
    assert_allclose(method(cfa.pick(planes, pattern), pattern), planes, rtol=0, atol=5e-16)


@given(pattern=patterns, seed=seeds)
def test_linear_planes_are_exact_inside_the_border(pattern, seed):
    a, b, c = noise((3, 3), seed)[:, :, None, None]
    y, x = np.mgrid[:17, :16]
    planes = a * y + b * x + c
    for method in METHODS[1:]:
        border = REACH[method]
        inner = np.s_[:, border:-border, border:-border]
        result = method(cfa.pick(planes, pattern), pattern)
        assert_allclose(result[inner], planes[inner], rtol=0, atol=3e-14)  # values up to 35


@given(pattern=patterns, seed=seeds, method=methods, colour=st.integers(0, 2))
def test_a_colour_cast_moves_its_own_plane_only(pattern, seed, method, colour):
    raw = noise((6, 7), seed)
    cast = 0.25 * (cfa.channel_index(pattern, 6, 7) == colour)
    moved = method(raw + cast, pattern) - method(raw, pattern)
    if REACH[method] > 1 and colour == 1:  # red and blue follow green, measured samples do not
        moved[[0, 2]] = 0
    # direction similarity rounds too, and it weighs estimates that are up to 2 apart
    atol = 1e-14 if method is directional else 1e-15
    assert_allclose(moved, 0.25 * (np.arange(3) == colour)[:, None, None] * np.ones((3, 6, 7)), rtol=0, atol=atol)


@given(pattern=patterns, shape=shapes, seed=seeds, method=st.sampled_from(METHODS[1:]))
def test_mirrored_and_transposed_scenes_give_mirrored_and_transposed_pictures(pattern, shape, seed, method):
    raw = noise(shape, seed)
    planes = method(raw, pattern)
    # rows and columns enter the mixture of directions in another order: a few roundings of values up to 4
    atol = 4e-15 if method is directional else 0
    assert_allclose(method(raw.T, TRANSPOSED[pattern]), planes.swapaxes(1, 2), rtol=0, atol=atol)
    flipped = FLIPPED_ROWS[pattern] if shape[0] % 2 == 0 else pattern
    assert_array_equal(method(raw[::-1], flipped), planes[:, ::-1])


@given(pattern=patterns, seed=seeds)
def test_nearest_repeats_its_cell_with_the_green_of_the_row(pattern, seed):
    raw = noise((4, 6), seed)
    planes = bilinear.nearest(raw, pattern)
    for colour in (0, 2):
        [(row, column)] = cfa.phase(pattern)["RGB"[colour]]
        assert_array_equal(planes[colour], raw[row::2, column::2].repeat(2, axis=0).repeat(2, axis=1))
    for row, column in cfa.phase(pattern)["G"]:
        assert_array_equal(planes[1, row::2], raw[row::2, column::2].repeat(2, axis=1))


@given(pattern=patterns, seed=seeds, row=st.integers(0, 3), column=st.integers(0, 3))
def test_the_cells_of_nearest_are_the_sensor_s_wherever_a_window_begins(pattern, seed, row, column):
    raw = noise((12, 13), seed)
    found = bilinear.nearest(raw[row:, column:], cfa.shifted_bayer(pattern, row, column), row, column)
    up, left = row % 2, column % 2  # cells that the window cuts are completed from inside
    assert_array_equal(found[:, up:-1, left:-1], bilinear.nearest(raw, pattern)[:, row + up : -1, column + left : -1])


@given(pattern=patterns, seed=seeds, method=methods)
def test_red_and_blue_are_treated_alike(pattern, seed, method):
    raw = noise((6, 7), seed)
    swapped = pattern.translate(str.maketrans("RB", "BR"))
    assert_array_equal(method(raw, swapped), method(raw, pattern)[::-1])


@given(pattern=patterns, seed=seeds)
def test_moving_the_window_moves_the_picture(pattern, seed):
    raw = noise((18, 19), seed)
    beside, below = pattern[1] + pattern[0] + pattern[3] + pattern[2], pattern[2:] + pattern[:2]
    for method in METHODS[1:]:
        n, whole = REACH[method], method(raw, pattern)
        assert_array_equal(method(raw[:, 1:], beside)[:, n:-n, n:-n], whole[:, n:-n, n + 1 : -n])
        assert_array_equal(method(raw[1:], below)[:, n:-n, n:-n], whole[:, n + 1 : -n, n:-n])


@given(seed=seeds, method=st.sampled_from(METHODS[1:]))
def test_a_frame_reads_alike_from_any_phase_of_the_array(seed, method):
    """The same samples under the four Bayer orders: the four begin at the four sites of one array."""
    raw, n = noise((20, 20), seed), REACH[method]
    whole = method(raw, "RGGB")
    for order, (row, column) in {"RGGB": (0, 0), "GRBG": (0, 1), "GBRG": (1, 0), "BGGR": (1, 1)}.items():
        part = method(raw[row:, column:], order)
        assert_array_equal(part[:, n:-n, n:-n], whole[:, row + n : -n, column + n : -n])


@given(pattern=patterns, seed=seeds, method=methods)
def test_negative_samples_are_samples_like_others(pattern, seed, method):
    raw = noise((9, 8), seed)
    planes = method(raw, pattern)
    assert_array_equal(method(-raw, pattern), -planes)
    shifted = method(raw - 0.5, pattern)
    # rounding of the shift, and of the direction weights
    assert_allclose(shifted, planes - 0.5, rtol=0, atol=2e-14)


@given(pattern=patterns, length=st.integers(2, 9), seed=seeds)
def test_a_single_line_interpolates_along_itself_and_fills_in_the_absent_colour(pattern, length, seed):
    raw = noise((1, length), seed)
    absent = ({0, 1, 2} - {"RGB".index(c) for c in pattern[:2]}).pop()
    for method in METHODS:
        planes = method(raw, pattern)
        present = np.delete(planes, absent, axis=0)
        assert_allclose(planes[absent], present.mean(axis=0), rtol=1e-15)
    even = "RGB".index(pattern[0])
    line = bilinear.bilinear(raw, pattern)[even, 0]
    if length > 2:
        assert_allclose(line[1], (raw[0, 0] + raw[0, 2]) / 2, rtol=1e-15)
    if length % 2 == 0:
        assert line[-1] == raw[0, -2]


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG"])
@pytest.mark.parametrize("length", [2, 6, 7])
def test_both_pixels_of_a_pair_on_a_line_are_given_its_two_samples(pattern, length):
    """Nearest means the same cell on a line too: pixels 0 and 1 have one colour, 2 and 3 another."""
    line = np.arange(1.0, length + 1)
    for frame in (line[None], line[:, None]):
        planes = bilinear.nearest(frame, pattern).reshape(3, length)
        whole = length // 2 * 2
        assert_array_equal(planes[:, 0:whole:2], planes[:, 1:whole:2])
        assert (planes[:, :2].min(), planes[:, :2].max()) == (1.0, 2.0)


@pytest.mark.parametrize("method", METHODS)
def test_nan_spreads_no_further_than_the_method_reaches(method):
    raw = noise((19, 19), 1)
    raw[9, 8] = np.nan
    found = method(raw, "GRBG")
    y, x = np.nonzero(np.isnan(found).any(axis=0))
    assert max(abs(y - 9).max(), abs(x - 8).max()) <= REACH[method]
    assert_array_equal(cfa.pick(found, "GRBG"), raw)  # what was measured beside it is still there


@pytest.mark.parametrize("method", METHODS)
def test_float32_is_kept_and_close_and_inputs_are_not_written(method):
    raw = noise((64, 65), 2).astype(np.float32)
    before = raw.copy()
    planes = method(raw, "BGGR")
    assert planes.dtype == np.float32
    assert_array_equal(raw, before)
    # up to 9 roundings of values up to 2
    assert_allclose(planes, method(raw.astype(np.float64), "BGGR"), rtol=0, atol=1e-6)
