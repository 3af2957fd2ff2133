"""The kernel against the published coefficients, tap by tap."""

import numpy as np
import pytest
from etendue_demosaic_malvar.kernel import malvar
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.mosaic import bilinear
from etendue_camera.sensor import cfa

# Figure 2 of the paper, times 8.
GREEN_AT_CHROMA = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]])
CHROMA_BESIDE_GREEN = np.array(
    [[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]
)
CHROMA_ABOVE_GREEN = CHROMA_BESIDE_GREEN.T
CHROMA_AT_OPPOSITE = np.array(
    [[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]
)

patterns = st.sampled_from(cfa.BAYER)
seeds = st.integers(0, 2**32 - 1)
sides = st.integers(2, 11)


def direct(raw, pattern):
    """Pixel by pixel: the sum of coefficient times sample, over a frame mirrored about its outermost samples."""
    framed = np.pad(raw, 2, mode="reflect")
    colours = cfa.channel_index(pattern, *raw.shape)
    planes = np.empty((3, *raw.shape))
    for y, x in np.ndindex(*raw.shape):
        here = "RGB"[colours[y, x]]
        for number, wanted in enumerate("RGB"):
            if wanted == here:
                planes[number, y, x] = raw[y, x]
                continue
            if wanted == "G":
                kernel = GREEN_AT_CHROMA
            elif here == "G":
                beside = pattern[2 * (y % 2) + (x + 1) % 2] == wanted
                kernel = CHROMA_BESIDE_GREEN if beside else CHROMA_ABOVE_GREEN
            else:
                kernel = CHROMA_AT_OPPOSITE
            planes[number, y, x] = (kernel * framed[y : y + 5, x : x + 5]).sum() / 8
    return planes


@given(pattern=patterns, rows=sides, columns=sides, seed=seeds)
def test_it_is_the_published_convolution_at_every_pixel_of_every_phase(pattern, rows, columns, seed):
    raw = np.random.default_rng(seed).uniform(-1.0, 1.0, (rows, columns))
    # about ten roundings of terms that add up to 2.5 at most
    assert_allclose(malvar(raw, pattern), direct(raw, pattern), rtol=0, atol=2e-15)


@given(pattern=patterns, rows=st.integers(1, 9), columns=st.integers(1, 9), seed=seeds)
def test_measured_samples_are_untouched_at_any_size(pattern, rows, columns, seed):
    raw = np.random.default_rng(seed).uniform(0.0, 1.0, (rows, columns))
    planes = malvar(raw, pattern)
    assert planes.shape == (3, rows, columns)
    assert np.isfinite(planes).all()
    assert_array_equal(cfa.pick(planes, pattern), raw)


@pytest.mark.parametrize("pattern", cfa.BAYER)
def test_a_ramp_shared_by_all_colours_is_exact_inside_the_border(pattern):
    y, x = np.mgrid[0:9, 0:10]
    ramp = 3.0 * y + 2.0 * x
    planes = np.stack([ramp + 8.0, ramp + 16.0, ramp])
    found = malvar(cfa.pick(planes, pattern), pattern)
    # small whole numbers times sixteenths are exact in binary
    for colour, shift in zip(found, (8.0, 16.0, 0.0), strict=True):
        # each colour's constant stays within the kernels' rows: Laplacians of a constant vanish within its own lattice
        assert_array_equal((colour - ramp)[2:-2, 2:-2], shift)


@pytest.mark.parametrize("shape", [(2, 2), (2, 3), (3, 2), (5, 4), (7, 9)])
@pytest.mark.parametrize("pattern", cfa.BAYER)
def test_a_constant_grey_frame_stays_constant(pattern, shape):
    # multiples of 1/16 of a power of two add up without rounding
    assert_array_equal(malvar(np.full(shape, 0.25), pattern), np.full((3, *shape), 0.25))


@given(rows=sides, columns=sides, seed=seeds)
def test_transposing_the_mosaic_transposes_the_result(rows, columns, seed):
    raw = np.random.default_rng(seed).uniform(0.0, 1.0, (rows, columns))
    # the same terms in another order: a few roundings
    assert_allclose(malvar(raw.T, "GBRG"), malvar(raw, "GRBG").transpose(0, 2, 1), rtol=0, atol=1e-15)


@given(pattern=patterns, seed=seeds)
def test_moving_the_window_moves_the_picture_and_mirroring_mirrors_it(pattern, seed):
    raw = np.random.default_rng(seed).uniform(-1.0, 1.0, (13, 13))
    whole = malvar(raw, pattern)
    beside, below = pattern[1] + pattern[0] + pattern[3] + pattern[2], pattern[2:] + pattern[:2]
    assert_array_equal(malvar(raw[:, 1:], beside)[:, 2:-2, 2:-2], whole[:, 2:-2, 3:-2])
    assert_array_equal(malvar(raw[1:], below)[:, 2:-2, 2:-2], whole[:, 3:-2, 2:-2])
    assert_array_equal(malvar(raw[::-1], pattern), whole[:, ::-1])
    assert_array_equal(malvar(raw[:, ::-1], pattern), whole[:, :, ::-1])
    assert_array_equal(malvar(-raw, pattern), -whole)


def test_nan_spreads_no_further_than_the_kernels_reach():
    raw = np.random.default_rng(1).uniform(0.0, 1.0, (15, 15))
    raw[7, 8] = np.nan
    y, x = np.nonzero(np.isnan(malvar(raw, "GRBG")).any(axis=0))
    assert max(abs(y - 7).max(), abs(x - 8).max()) == 2


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (5, 1)])
def test_a_frame_of_one_line_is_interpolated_along_its_length(shape):
    raw = np.random.default_rng(1).uniform(0.0, 1.0, shape)
    assert_array_equal(malvar(raw, "GRBG"), bilinear.bilinear(raw, "GRBG"))


def test_precision_and_order_of_the_input_are_kept_and_integers_become_double():
    raw = np.random.default_rng(2).integers(0, 4096, (6, 7), dtype=np.uint16)
    assert malvar(raw, "RGGB").dtype == np.float64
    single = malvar(raw.astype(np.float32), "RGGB")
    assert single.dtype == np.float32
    # 12-bit integers times sixteenths are exact in float32
    assert_array_equal(single, malvar(raw, "RGGB"))
    assert_array_equal(malvar(np.asfortranarray(raw.astype(float)), "RGGB"), malvar(raw.astype(float), "RGGB"))


def test_it_beats_bilinear_on_a_grey_edge():
    x = np.linspace(-8.0, 8.0, 64)
    edge = np.broadcast_to(1 / (1 + np.exp(-x)), (64, 64))
    raw = cfa.pick(np.stack([edge] * 3), "RGGB")
    worst = {
        name: np.abs(method(raw, "RGGB") - edge)[:, 3:-3, 3:-3].max()
        for name, method in (("m", malvar), ("b", bilinear.bilinear))
    }
    assert worst["m"] < 0.5 * worst["b"]


def test_unknown_patterns_and_shapes_are_refused():
    with pytest.raises(ValueError, match="RGGB, BGGR, GRBG, GBRG"):
        malvar(np.zeros((4, 4)), "RGBG")
    with pytest.raises(ValueError, match="mosaic has shape"):
        malvar(np.zeros((3, 4, 4)), "RGGB")
    with pytest.raises(ValueError, match="mosaic has shape"):
        malvar(np.zeros((0, 4)), "RGGB")
