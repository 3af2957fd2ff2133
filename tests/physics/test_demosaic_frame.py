"""A frame is the same picture whatever tiles it is computed in, and stands mirrored beyond its border."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from etendue_camera.mosaic import bilinear
from etendue_camera.mosaic import frame as demosaic_frame
from etendue_camera.mosaic.directional import directional

METHODS = (bilinear.bilinear, bilinear.colour_difference, directional)


@given(rows=st.integers(2, 12), columns=st.integers(2, 12), reach=st.integers(1, 30), seed=st.integers(0, 2**32 - 1))
def test_beyond_the_border_stands_the_mirror_image_however_far(rows, columns, reach, seed):
    frame = np.random.default_rng(seed).uniform(-1.0, 1.0, (rows, columns))
    assert_array_equal(demosaic_frame.mirrored(frame, reach), np.pad(frame, reach, mode="reflect"))


@pytest.mark.parametrize(("pixels", "width"), [(2, 2), (16, 4), (64, 16), (200, 10)])
@pytest.mark.parametrize("shape", [(2, 2), (2, 37), (31, 3), (24, 24), (33, 41)])
@pytest.mark.parametrize("method", METHODS)
def test_tiles_leave_no_trace(method, shape, pixels, width, monkeypatch):
    raw = np.random.default_rng(3).uniform(0.0, 1.0, shape)
    whole = method(raw, "GBRG")
    monkeypatch.setattr(demosaic_frame, "TILE_PIXELS", pixels)
    monkeypatch.setattr(demosaic_frame, "TILE_WIDTH", width)
    assert_array_equal(method(raw, "GBRG"), whole)


@settings(deadline=None)
@given(rows=st.integers(2, 4000), columns=st.integers(2, 4000), width=st.integers(1, 300).map(lambda n: 2 * n))
def test_tiles_are_even_and_no_larger_than_asked(rows, columns, width):
    for size in (rows, columns):
        share = demosaic_frame._even_share(size, width)
        assert share % 2 == 0 and 2 <= share <= width
        # about equal: as many tiles as are needed, no crumbs
        assert -(-size // share) <= -(-size // width)


@given(
    seed=st.integers(0, 2**32 - 1), reach=st.sampled_from([2, 4, 6]), rows=st.integers(2, 9), columns=st.integers(2, 9)
)
def test_quarter_planes_hold_one_site_in_the_tile_and_one_pixel_around_it(seed, reach, rows, columns):
    framed = np.random.default_rng(seed).uniform(size=(rows + 2 * reach, columns + 2 * reach))
    for place in np.ndindex(2, 2):
        plane = demosaic_frame.quarter(framed, reach, place)
        tile = framed[reach:-reach, reach:-reach]
        assert_array_equal(demosaic_frame.own(plane, place, tile.shape), tile[place[0] :: 2, place[1] :: 2])
        around = framed[reach - 1 : rows + reach + 1, reach - 1 : columns + reach + 1]
        assert_array_equal(plane, around[1 - place[0] :: 2, 1 - place[1] :: 2])
        moved = demosaic_frame.quarter(framed, reach, place, -1, 1)
        shifted = framed[reach - 2 : rows + reach, reach : columns + reach + 2]
        assert_array_equal(moved, shifted[1 - place[0] :: 2, 1 - place[1] :: 2])
