"""Defective pixels found and replaced. In: ramps, edges and flat fields with defects put in. Out: what they were
before.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.mosaic import defect_correction
from etendue_camera.mosaic.defect_correction import PixelNoise
from etendue_camera.sensor import cfa

NAMES = ("RGGB", "GBRG", "quad-BGGR", "X-Trans", "RGBW", "RCCC", "mono", "RGB/BRG/GBR")
QUIET = PixelNoise(1e-4, np.inf)
slopes = st.floats(-0.01, 0.01)


def ramp(shape, slope_y, slope_x, level=0.5):
    y, x = np.indices(shape)
    return level + slope_y * (y - shape[0] / 2) + slope_x * (x - shape[1] / 2)


def scattered(shape, step=13):
    """Isolated places that meet every phase of every mask here, away from the border."""
    found = np.zeros(shape, bool)
    found[12:-12:step, 12:-12:step] = True
    return found


@given(name=st.sampled_from(NAMES), slope_y=slopes, slope_x=slopes, row=st.integers(-7, 7), column=st.integers(-7, 7))
@settings(max_examples=40, deadline=None)
def test_isolated_defects_on_a_linear_ramp_are_undone_exactly_for_every_mask(name, slope_y, slope_x, row, column):
    truth, places = ramp((64, 66), slope_y, slope_x), scattered((64, 66))
    broken = np.where(places, 7.0, truth)
    found, left = defect_correction.replaced(broken, places, cfa.parse(name), row, column)
    assert left == 0
    assert_array_equal(found[~places], truth[~places])  # bit for bit
    assert_allclose(found, truth, atol=2e-15)  # means of up to eight lines, of numbers below 1.2


@given(
    name=st.sampled_from(NAMES),
    slope_y=slopes,
    slope_x=slopes,
    shape=st.sampled_from([(40, 42), (7, 30), (1, 30), (30, 1), (3, 3)]),
)
@settings(max_examples=60, deadline=None)
def test_a_ramp_has_no_defects_not_even_at_its_border(name, slope_y, slope_x, shape):
    assert not defect_correction.outliers(ramp(shape, slope_y, slope_x), cfa.parse(name), QUIET, contrast=0.0).any()


@pytest.mark.parametrize("name", NAMES)
def test_nothing_defective_leaves_every_bit(name):
    frame = np.random.default_rng(1).standard_normal((30, 31)).astype(np.float32)
    found, left = defect_correction.replaced(frame, np.zeros(frame.shape, bool), cfa.parse(name))
    assert found.dtype == np.float32 and left == 0
    assert found.tobytes() == frame.tobytes()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [1.0, 0.0])
def test_isolated_hot_and_dead_pixels_are_found_for_every_mask_and_nothing_else(name, value):
    flat, places = np.full((64, 66), 0.4), scattered((64, 66))
    assert_array_equal(defect_correction.outliers(np.where(places, value, flat), cfa.parse(name), QUIET), places)


def test_one_defect_does_not_hide_another():
    pair = np.full((20, 20), 0.3)
    pair[8, 8] = pair[8, 10] = 0.9  # nearest neighbours of one colour
    assert_array_equal(np.argwhere(defect_correction.outliers(pair, cfa.parse("RGGB"), QUIET)), [[8, 8], [8, 10]])


@pytest.mark.parametrize("name", ["RGGB", "mono"])
def test_an_edge_is_no_defect_and_a_defect_beside_it_is_repaired_along_it(name):
    edge = np.where(np.arange(24)[None, :] < 12, 0.1, 0.9) * np.ones((24, 1))
    for frame in (edge, edge.T.copy()):
        assert not defect_correction.outliers(frame, cfa.parse(name), QUIET).any()
        places = np.zeros(frame.shape, bool)
        places[11, 11] = places[12, 12] = True
        found, _ = defect_correction.replaced(np.where(places, 0.5, frame), places, cfa.parse(name))
        assert_allclose(found, frame, atol=3e-4)  # weights across the edge: (0.009/1.6)^2 of those along it


def test_sound_pixels_are_taken_for_defects_once_in_a_million_where_the_light_is_even():
    rng, electrons = np.random.default_rng(5), 5000.0
    for level in (0.02, 0.5):
        noisy = rng.poisson(level * electrons, (1000, 1000)) / electrons + 0.001 * rng.standard_normal((1000, 1000))
        found = defect_correction.outliers(noisy, cfa.parse("RGGB"), PixelNoise(0.001, electrons))
        assert np.count_nonzero(found) <= 5  # 1 expected; more than 5 has probability 6e-4


def test_a_defect_takes_no_part_in_anothers_repair():
    frame = np.random.default_rng(3).uniform(0.2, 0.8, (40, 40))
    places = np.random.default_rng(4).uniform(size=frame.shape) < 0.15
    first, _ = defect_correction.replaced(np.where(places, 0.0, frame), places, cfa.parse("RGGB"))
    second, _ = defect_correction.replaced(np.where(places, 1e6, frame), places, cfa.parse("RGGB"))
    assert_array_equal(first, second)
    assert 0.2 <= first.min() and first.max() <= 0.8  # means and medians of sound pixels


@given(row=st.integers(0, 5), column=st.integers(0, 5), seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_a_window_that_starts_elsewhere_keeps_the_sensors_mask(row, column, seed):
    mask = cfa.parse("X-Trans")
    shifted = cfa.parse(
        "/".join(("".join(mask.rows[(row + y) % 6][(column + x) % 6] for x in range(6))) for y in range(6))
    )
    frame = np.random.default_rng(seed).uniform(size=(24, 25))
    places = defect_correction.outliers(frame, mask, PixelNoise(0.0, np.inf), 1.0, 0.0, row, column)
    assert_array_equal(places, defect_correction.outliers(frame, shifted, PixelNoise(0.0, np.inf), 1.0, 0.0))
    one, other = (
        defect_correction.replaced(frame, places, mask, row, column),
        defect_correction.replaced(frame, places, shifted),
    )
    assert_array_equal(one[0], other[0])


def test_clusters_are_filled_from_what_is_sound_and_what_cannot_be_is_left_and_counted():
    flat = np.full((40, 40), 0.25)
    block = np.zeros(flat.shape, bool)
    block[10:15, 10:15] = True
    found, left = defect_correction.replaced(np.where(block, 1.0, flat), block, cfa.parse("RGGB"))
    assert left == 0
    assert_array_equal(found, flat)
    for shape in ((1, 1), (2, 2), (5, 4)):
        everything = np.ones(shape, bool)
        found, left = defect_correction.replaced(np.full(shape, 0.3), everything, cfa.parse("RGGB"))
        assert left == everything.size
        assert_array_equal(found, np.full(shape, 0.3))


def test_a_corner_has_the_median_of_its_sound_neighbours():
    frame = np.full((9, 9), 0.5)
    places = np.zeros(frame.shape, bool)
    places[0, 0] = places[8, 0] = True
    found, left = defect_correction.replaced(np.where(places, 9.0, frame), places, cfa.parse("RGGB"))
    assert left == 0
    assert_array_equal(found, frame)


def test_pixels_with_too_few_neighbours_are_not_judged():
    for shape in ((1, 1), (1, 3), (2, 2), (1, 5)):
        frame = np.zeros(shape)
        frame[0, 0] = 1.0
        assert not defect_correction.outliers(frame, cfa.parse("RGGB"), QUIET).any()
    assert defect_correction.outliers(np.empty((0, 4)), cfa.parse("RGGB"), QUIET).shape == (0, 4)


def test_what_is_no_frame_or_out_of_range_is_refused():
    flat, mask = np.full((6, 6), 0.5), cfa.parse("RGGB")
    undefined = flat.copy()
    undefined[2, 2] = np.nan
    for call, text in (
        (lambda: defect_correction.outliers(undefined, mask, QUIET), "finite"),
        (lambda: defect_correction.replaced(undefined, flat > 1, mask), "finite"),
        (lambda: defect_correction.replaced(flat, np.zeros((6, 5), bool), mask), "defective"),
        (lambda: defect_correction.replaced(flat, np.zeros((6, 6), int), mask), "bool"),
        (lambda: defect_correction.outliers(flat, mask, PixelNoise(-1.0, 1e4)), "dark_sigma is -1.0"),
        (lambda: defect_correction.outliers(flat, mask, PixelNoise(0.0, 0.0)), "electrons is 0.0"),
        (lambda: defect_correction.outliers(flat, mask, PixelNoise(0.0, 1e4, np.nan)), "prnu is nan"),
        (lambda: defect_correction.outliers(flat, mask, PixelNoise(0.0, 1e4), -1.0), "threshold is -1.0"),
    ):
        with pytest.raises(ValueError, match=text):
            call()
