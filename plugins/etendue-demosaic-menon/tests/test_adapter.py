"""The package's own result, at any size, and nothing left behind by its import."""

import subprocess
import sys

import numpy as np
import pytest
from etendue_demosaic_menon.adapter import SMALLEST, implementation, menon
from etendue_demosaic_menon.stages import DemosaicMenon
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.mosaic import bilinear
from etendue_camera.sensor import cfa

REACH = 8  # 2 for green, 2 for differences, 2 for their sums; 1 and 1 for the last step
SWAPPED = str.maketrans("RB", "BR")

patterns = st.sampled_from(cfa.BAYER)
seeds = st.integers(0, 2**32 - 1)


def noise(shape, seed):
    return np.random.default_rng(seed).uniform(0.0, 1.0, shape)


@given(
    pattern=patterns,
    rows=st.integers(SMALLEST, 14),
    columns=st.integers(SMALLEST, 14),
    seed=seeds,
    refine=st.booleans(),
)
@settings(deadline=None)
def test_it_is_the_packages_own_result(pattern, rows, columns, seed, refine):
    raw = noise((rows, columns), seed)
    theirs = implementation()(raw, pattern, refining_step=refine)
    assert_array_equal(menon(raw, pattern, refine), np.moveaxis(theirs, -1, 0))


@given(pattern=patterns, rows=st.integers(1, 9), columns=st.integers(1, 9), seed=seeds, refine=st.booleans())
@settings(deadline=None)
def test_measured_samples_are_untouched_at_any_size(pattern, rows, columns, seed, refine):
    raw = noise((rows, columns), seed)
    planes = menon(raw, pattern, refine)
    assert planes.shape == (3, rows, columns)
    assert np.isfinite(planes).all()
    assert_array_equal(cfa.pick(planes, pattern), raw)


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (5, 1), (2, 2), (2, 7), (6, 3), (7, 9)])
@pytest.mark.parametrize("pattern", cfa.BAYER)
def test_constant_colours_stay_constant_at_any_size(pattern, shape):
    assert_allclose(menon(np.full(shape, 0.3), pattern), 0.3, rtol=0, atol=3e-16)
    if 1 not in shape:  # a line lacks a colour
        planes = np.broadcast_to(np.array([0.7, 0.2, 0.4])[:, None, None], (3, *shape))
        # differences that are smoothed and taken back: a few roundings
        assert_allclose(menon(cfa.pick(planes, pattern), pattern), planes, rtol=0, atol=6e-16)


@given(pattern=patterns, seed=seeds)
@settings(deadline=None)
def test_moving_the_window_moves_the_picture_and_red_and_blue_are_alike(pattern, seed):
    raw, n = noise((26, 27), seed), REACH
    whole = menon(raw, pattern)
    beside, below = pattern[1] + pattern[0] + pattern[3] + pattern[2], pattern[2:] + pattern[:2]
    # the order of some sums follows the order of rows
    assert_allclose(menon(raw[:, 1:], beside)[:, n:-n, n:-n], whole[:, n:-n, n + 1 : -n], rtol=0, atol=3e-15)
    assert_allclose(menon(raw[1:], below)[:, n:-n, n:-n], whole[:, n + 1 : -n, n:-n], rtol=0, atol=3e-15)
    assert_allclose(menon(raw, pattern.translate(SWAPPED)), whole[::-1], rtol=0, atol=3e-15)


@given(pattern=patterns, seed=seeds)
@settings(deadline=None)
def test_mirrored_scenes_give_mirrored_pictures_inside_the_border(pattern, seed):
    raw, n = noise((27, 27), seed), REACH
    whole = menon(raw, pattern)[:, n:-n, n:-n]
    assert_allclose(menon(raw[::-1], pattern)[:, n:-n, n:-n], whole[:, ::-1], rtol=0, atol=3e-15)
    assert_allclose(menon(raw[:, ::-1], pattern)[:, n:-n, n:-n], whole[:, :, ::-1], rtol=0, atol=3e-15)


@pytest.mark.parametrize("shape", [(2, 2), (3, 5), (5, 12), (12, 4)])
def test_a_small_frame_is_a_piece_of_its_own_mirror_images(shape):
    raw = noise(shape, 3)
    rows, columns = (24 if size < SMALLEST else 0 for size in shape)
    large = menon(np.pad(raw, ((rows, rows), (columns, columns)), mode="reflect"), "GRBG")
    cut = large[:, rows : rows + shape[0], columns : columns + shape[1]]
    inner = (
        np.s_[:, :, :]
        if rows and columns
        else np.s_[:, REACH // 2 : -REACH // 2 or None, :]
        if columns
        else np.s_[:, :, 4:-4]
    )
    assert_allclose(menon(raw, "GRBG")[inner], cut[inner], rtol=0, atol=3e-15)


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (5, 1)])
def test_a_frame_of_one_line_is_interpolated_along_its_length(shape):
    assert_array_equal(menon(noise(shape, 1), "GRBG"), bilinear.bilinear(noise(shape, 1), "GRBG"))


def test_nan_spreads_no_further_than_the_method_reaches_and_negative_values_are_kept():
    raw = noise((31, 31), 1)
    planes = menon(raw, "GRBG")
    # a tie of the two directions goes to rows either way
    assert_allclose(menon(-raw, "GRBG"), -planes, rtol=0, atol=3e-15)
    raw[15, 14] = np.nan
    found = menon(raw, "GRBG")
    y, x = np.nonzero(np.isnan(found).any(axis=0))
    assert max(abs(y - 15).max(), abs(x - 14).max()) <= REACH
    far = np.ones((31, 31), bool)
    far[15 - REACH : 16 + REACH, 14 - REACH : 15 + REACH] = False
    assert_array_equal(found[:, far], planes[:, far])


def test_precision_is_kept_and_integers_become_double():
    raw = np.random.default_rng(2).integers(0, 4096, (9, 10), dtype=np.uint16)
    double = menon(raw, "RGGB")
    assert double.dtype == np.float64
    single = menon(raw.astype(np.float32), "RGGB")
    assert single.dtype == np.float32
    assert_array_equal(single, double.astype(np.float32))  # whole numbers are the same in both


def test_unknown_patterns_and_shapes_are_refused():
    with pytest.raises(ValueError, match="RGGB, BGGR, GRBG, GBRG"):
        menon(np.zeros((8, 8)), "RGBG")
    with pytest.raises(ValueError, match="mosaic has shape"):
        menon(np.zeros((3, 8, 8)), "RGGB")
    with pytest.raises(ValueError, match="mosaic has shape"):
        menon(np.zeros((0, 4)), "RGGB")
    with pytest.raises(ValueError, match="demosaic_menon supports"):
        DemosaicMenon(pattern="X-Trans")


def test_the_import_is_late_silent_and_leaves_numpys_printing_alone():
    program = """
import sys, warnings
warnings.simplefilter("error")
import numpy as np
def state():
    return repr(np.float64(0.5)), np.get_printoptions(), list(warnings.filters)
from etendue_demosaic_menon.stages import DemosaicMenon
stage, before = DemosaicMenon(pattern="RGGB"), state()
assert "colour_demosaicing" not in sys.modules and "colour" not in sys.modules
at = np.arange(8.0)
found = stage.run(np.ones((8, 8)), at, at, stage.prepare({}))["rgb_camera"]
assert "colour_demosaicing" in sys.modules
assert state() == before
print(found.shape)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("(3, 8, 8)\n", "")
