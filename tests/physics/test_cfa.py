"""Colour filter arrays of any period: names, phases, borders, and what puts the missing channels back."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.mosaic import any_mask, bilinear
from etendue_camera.sensor import cfa

masks = st.sampled_from([*cfa.NAMES, "RGB/RGB", "CM/YG/CM/GY", "RGW/BRG"]).map(cfa.parse)
firsts = st.integers(-9, 9)
shapes = st.tuples(st.integers(1, 15), st.integers(1, 15))
seeds = st.integers(0, 2**32 - 1)


def noise(shape, seed):
    return np.random.default_rng(seed).uniform(0.0, 1.0, shape)


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("GRBG", {"R": 1, "G": 2, "B": 1}),
        ("quad-GRBG", {"R": 4, "G": 8, "B": 4}),
        ("RGBW", {"R": 2, "G": 4, "B": 2, "W": 8}),
        ("X-Trans", {"R": 8, "G": 20, "B": 8}),
        ("RCCC", {"R": 1, "C": 3}),
        ("mono", {"W": 1}),
    ],
)
def test_named_arrays_hold_the_published_numbers_of_each_filter(name, counts):
    mask = cfa.parse(name)
    assert {c: len(mask.sites(c)) for c in mask.channels} == counts
    assert tuple(counts) == mask.channels


def test_every_row_and_column_of_x_trans_holds_all_three_colours():
    rows = cfa.parse("X-Trans").rows
    assert all(set(row) == set("RGB") for row in [*rows, *map("".join, zip(*rows, strict=True))])


def test_each_site_of_a_quad_bayer_cell_is_four_pixels_of_the_bayer_cell():
    for order in cfa.BAYER:
        quad, plain = cfa.parse(f"quad-{order}"), cfa.parse(order)
        assert_array_equal(cfa.channel_index(quad, 8, 8), cfa.channel_index(plain, 4, 4).repeat(2, 0).repeat(2, 1))


def test_a_mask_is_the_same_however_often_its_cell_is_written_and_whatever_its_case():
    assert (
        cfa.parse("RG/GB/RG/GB")
        == cfa.parse("rggb")
        == cfa.parse("rgrg/gbgb")
        == cfa.parse_rows("# cell\nR, G\nG, B\n")
    )
    assert cfa.parse("RG/GB").bayer == "RGGB"
    assert cfa.parse("WW/WW") == cfa.parse("MONO")
    assert cfa.parse("X-Trans").bayer is None
    assert cfa.parse("RGB/").period == (1, 3)  # stripes


def test_the_bayer_kernels_and_the_general_ones_agree():
    for order in cfa.BAYER:
        for row, column in itertools.product((0, 1), repeat=2):
            moved = cfa.parse(cfa.shifted_bayer(order, row, column))
            assert_array_equal(cfa.channel_index(moved, 5, 6), cfa.channel_index(cfa.parse(order), 5, 6, row, column))


@given(mask=masks, shape=shapes, row=firsts, column=firsts, seed=seeds)
def test_every_pixel_is_picked_once_from_the_channel_its_place_on_the_sensor_names(mask, shape, row, column, seed):
    planes = noise((len(mask.channels), *shape), seed)
    index = cfa.channel_index(mask, *shape, row, column)
    assert_array_equal(cfa.pick(planes, mask, row, column), np.take_along_axis(planes, index[None].astype(int), 0)[0])
    counted = np.zeros(shape, int)
    for channel in mask.channels:
        for where in cfa.sites_of(mask, channel, row, column):
            counted[where] += 1
    assert (counted == 1).all()


@given(mask=masks, row=st.integers(0, 12), column=st.integers(0, 12), seed=seeds)
def test_the_mosaic_of_a_window_is_the_window_of_the_mosaic(mask, row, column, seed):
    planes = noise((len(mask.channels), 20, 21), seed)
    whole = cfa.pick(planes, mask)
    assert_array_equal(cfa.pick(planes[:, row:, column:], mask, row, column), whole[row:, column:])


@given(size=st.integers(1, 40), period=st.integers(1, 8), margin=st.integers(0, 90))
def test_beyond_the_border_colours_keep_their_place(size, period, margin):
    index = cfa.continued(size, period, margin)
    assert_array_equal(index[margin : margin + size], np.arange(size))
    assert index.min() >= 0 and index.max() < size
    if size >= period:
        assert_array_equal((index - np.arange(-margin, size + margin)) % period, 0)
    if period == 1 and margin <= size:
        assert_array_equal(index, np.pad(np.arange(size), margin, mode="symmetric"))


@given(mask=masks, seed=seeds, row=firsts, column=firsts, shape=shapes)
@settings(deadline=None)
def test_demosaicing_keeps_measured_samples_and_stays_in_their_range(mask, seed, row, column, shape):
    raw = noise(shape, seed)
    planes = any_mask.linear(raw, mask, row, column)
    assert planes.shape == (len(mask.channels), *shape)
    assert_array_equal(cfa.pick(planes, mask, row, column), raw)
    # weights are not negative and sum to 1 within 1e-15
    assert planes.min() >= raw.min() - 1e-14 and planes.max() <= raw.max() + 1e-14


@given(mask=masks, row=firsts, column=firsts)
@settings(deadline=None)
def test_constant_colours_stay_constant_up_to_the_border(mask, row, column):
    colours = np.linspace(0.2, 0.7, len(mask.channels))[:, None, None]
    planes = np.broadcast_to(colours, (len(mask.channels), 13, 14))
    assert_allclose(any_mask.linear(cfa.pick(planes, mask, row, column), mask, row, column), planes, rtol=1e-14)


@pytest.mark.parametrize("name", [n for n in cfa.NAMES if n != "mono"])
def test_linear_planes_are_exact_farther_inside_than_the_weights_reach(name):
    mask = cfa.parse(name)
    y, x = np.mgrid[:24, :25]
    planes = np.stack([0.3 * i + 0.01 * (i + 1) * y - 0.02 * x for i in range(len(mask.channels))])
    inner = np.s_[:, 3:-3, 3:-3]
    # weights have mean position 0 within 1e-14, values are up to 1
    assert_allclose(any_mask.linear(cfa.pick(planes, mask), mask)[inner], planes[inner], atol=1e-13)


@given(order=st.sampled_from(cfa.BAYER), rows=st.integers(2, 12), columns=st.integers(2, 12), seed=seeds)
@settings(deadline=None)
def test_on_bayer_it_is_the_bilinear_method_borders_included(order, rows, columns, seed):
    raw = noise((rows, columns), seed)
    assert_allclose(any_mask.linear(raw, cfa.parse(order)), bilinear.bilinear(raw, order), atol=1e-15)


@given(mask=masks, row=st.integers(0, 5), column=st.integers(0, 5), seed=seeds)
@settings(deadline=None)
def test_demosaicing_a_window_is_the_window_of_the_picture_inside_its_border(mask, row, column, seed):
    raw = noise((22, 23), seed)
    part = any_mask.linear(raw[row:, column:], mask, row, column)
    assert_allclose(part[:, 6:-6, 6:-6], any_mask.linear(raw, mask)[:, row + 6 : -6, column + 6 : -6], atol=1e-15)


def test_float32_is_kept_and_integers_become_floats():
    raw = noise((12, 13), 1).astype(np.float32)
    mask = cfa.parse("X-Trans")
    planes = any_mask.linear(raw, mask)
    assert planes.dtype == np.float32
    assert_allclose(planes, any_mask.linear(raw.astype(float), mask), atol=5e-7)  # five taps
    assert any_mask.linear(np.arange(12).reshape(3, 4), mask).dtype == np.float64


@pytest.mark.parametrize("text", ["RGBG", "RG/G", "R1/GB", "/", "R G/GB", "R" * 80 + "/"])
def test_what_is_no_mask_is_refused_with_what_is(text):
    with pytest.raises(ValueError, match="pattern"):
        cfa.parse(text)


def test_planes_that_do_not_fit_are_refused_by_name():
    with pytest.raises(ValueError, match="R, G, B, W"):
        cfa.pick(np.zeros((3, 4, 4)), cfa.parse("RGBW"))
    with pytest.raises(ValueError, match="mosaic has shape"):
        any_mask.linear(np.zeros((0, 4)), cfa.parse("RCCC"))
    with pytest.raises(ValueError, match="no letters"):
        cfa.parse_rows("# nothing\n")
