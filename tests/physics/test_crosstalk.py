"""Charge behind the filters: a mixture of Gaussians that is D(f), pixel kernels that keep every electron."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.sensor import cfa, crosstalk, crosstalk_planes, photodiode, silicon

REDDISH = float(silicon.absorption(0.65))
masks = st.sampled_from(cfa.NAMES).map(cfa.parse)
seeds = st.integers(0, 2**32 - 1)


def decades(low, high):
    return st.floats(low, high).map(lambda exponent: 10.0**exponent)


diodes = st.tuples(
    decades(-6.0, 3.0),
    decades(-3.0, 2.0),
    decades(-2.0, 3.0) | st.just(np.inf),
    decades(-1.0, 5.0),
    st.sampled_from(["absorbing", "reflecting"]),
)


def kernel_of(diode, pitch, light=1.0, reach=40, offsets=(0.0, 0.0), beyond=0.0):
    t = crosstalk.times(*diode[2:4])
    kept, moved = crosstalk.shares(t, *diode)
    along = [crosstalk.pixel_shares(t, pitch * light, pitch, reach, pitch * o) for o in offsets]
    kernels, lost = crosstalk.kernels(np.array([kept]), moved[None], *along, beyond)
    return kernels[0], float(lost[0])


PAPER = (REDDISH, 1.8, 10.0, 50.0, "absorbing")


@given(diode=diodes, f=decades(-4.0, 1.5))
def test_the_mixture_of_gaussians_is_the_diffusion_transfer_function(diode, f):
    t = crosstalk.times(*diode[2:4])
    kept, moved = crosstalk.shares(t, *diode)
    assert kept >= 0.0 and moved.min() >= 0.0
    assert_allclose(kept + moved.sum(), 1.0, rtol=1e-14)
    mixture = kept + moved @ np.exp(-((2 * np.pi * f) ** 2) * t)
    # the density of arrival times is cut at 1e-16 um2, where a bare diode still collects some
    assert_allclose(mixture, photodiode.collection_mtf(f, *diode), atol=4e-12)


def test_charge_from_infinitely_far_has_no_kernel():
    with pytest.raises(ValueError, match="infinitely deep"):
        crosstalk.shares(crosstalk.times(np.inf, np.inf), 0.0, 1.8, np.inf, np.inf)


@given(diode=diodes, pitch=st.floats(0.5, 20.0), light=st.floats(0.1, 1.0))
def test_kernels_are_not_negative_symmetric_and_sum_to_one(diode, pitch, light):
    kernel, lost = kernel_of(diode, pitch, light, reach=20)
    assert kernel.min() >= 0.0
    assert_allclose(kernel.sum(), 1.0, rtol=1e-14)
    assert 0.0 <= lost <= 1.0
    for twin in (kernel.T, kernel[::-1], kernel[:, ::-1]):
        assert_allclose(twin, kernel, atol=1e-13)  # of second differences, which cancel


@given(pitch=st.floats(1.5, 8.0), light=st.floats(0.3, 0.8), y=st.integers(-10, 10), x=st.integers(-10, 10))
@settings(deadline=None, max_examples=40)
def test_a_window_off_centre_gives_more_to_the_side_it_lies_on(pitch, light, y, x):
    y, x = 0.01 * y, 0.01 * x
    kernel, _ = kernel_of(PAPER, pitch, light, 8, offsets=(y, x), beyond=1e-15)
    r = kernel.shape[0] // 2
    assert (kernel[r + 1, r] - kernel[r - 1, r]) * y >= 0
    assert (kernel[r, r + 1] - kernel[r, r - 1]) * x >= 0
    mirrored, _ = kernel_of(PAPER, pitch, light, 8, offsets=(-y, x), beyond=1e-15)
    assert_allclose(mirrored, kernel[::-1], atol=1e-13)


@pytest.mark.parametrize("pitch", [1.1, 2.8, 5.4])
def test_a_kernel_is_the_pixel_integral_of_the_transfer_function(pitch):
    """Own pixel and two neighbours, by quadrature over frequency of D x window x pixel: nothing of the kernel's own
    making.
    """
    light = 0.741 * pitch
    floor = photodiode.collection_mtf(np.inf, *PAPER)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    edges = np.linspace(0.0, 40.0 / pitch, 121)
    f = (edges[:-1, None] + np.diff(edges)[:, None] * (nodes + 1) / 2).ravel()
    w = (np.diff(edges)[:, None] * weights / 2).ravel()
    moved = photodiode.collection_mtf(np.hypot(f[:, None], f[None, :]), *PAPER) - floor
    kernel, _ = kernel_of(PAPER, pitch, 0.741)
    r = kernel.shape[0] // 2
    for down, right in ((0, 0), (0, 1), (1, 1)):
        along = [
            2 * np.sinc(f * light) * np.sinc(f * pitch) * np.cos(2 * np.pi * f * n * pitch) * w for n in (down, right)
        ]
        direct = pitch**2 * along[0] @ moved @ along[1] + (floor if down == right == 0 else 0.0)
        # beyond 40 cycles a pixel the integrand is below 1/f^3
        assert_allclose(kernel[r + down, r + right], direct, atol=2e-5)


@pytest.mark.parametrize(
    ("pitch", "leaves", "from_window"), [(1.1, 0.42, 0.410), (2.8, 0.33, 0.314), (5.4, 0.25, 0.220)]
)
def test_at_650_nm_as_much_charge_leaves_its_pixel_as_the_contract_says(pitch, leaves, from_window):
    """42, 33 and 25 per cent from a pixel that is lit over its whole width; less from one lit in its middle."""
    whole, _ = kernel_of(PAPER, pitch)
    middle, _ = kernel_of(PAPER, pitch, 0.741)
    assert_allclose(1 - whole.max(), leaves, atol=0.005)  # the digits of the contract
    assert_allclose(1 - middle.max(), from_window, atol=0.0005)


def test_without_diffusion_every_charge_stays_and_large_pixels_lose_what_their_edge_loses():
    for still in (
        (REDDISH, 1.8, 0.0, 50.0, "absorbing"),
        (REDDISH, 1e4, 10.0, 50.0, "absorbing"),
        (1e3, 1.8, 10.0, 50.0, "absorbing"),
    ):
        kernel, _ = kernel_of(still, 2.8)
        assert_allclose(kernel.max(), 1.0, rtol=1e-14)
    left = [1 - kernel_of(PAPER, pitch)[0].max() for pitch in (200.0, 400.0, 800.0)]
    assert_allclose(left[0] / left[1], 2.0, rtol=0.01)  # circumference over area; corners are the next order
    assert_allclose(left[1] / left[2], 2.0, rtol=0.005)
    short = [1 - kernel_of((REDDISH, 1.8, depth, 50.0, "absorbing"), 2.8)[0].max() for depth in (1.0, 0.1, 0.01)]
    assert short[0] > short[1] > short[2] and short[2] < 1e-5


def test_a_cut_kernel_spreads_what_it_cuts_and_says_how_much():
    wide, _ = kernel_of(PAPER, 1.1, reach=80)
    narrow, lost = kernel_of(PAPER, 1.1, reach=80, beyond=1e-4)
    assert narrow.shape[0] < wide.shape[0] and 0 < lost <= 1e-4
    r, n = wide.shape[0] // 2, narrow.shape[0] // 2
    inner = wide[r - n : r + n + 1, r - n : r + n + 1]
    assert_allclose(1 - inner.sum(), lost, atol=1e-12)
    assert_allclose(narrow, inner / inner.sum(), rtol=1e-12)


def kernels_for(mask, pitch=2.0, reach=12):
    """Another photodiode for each channel, so that nothing holds by their being equal."""
    return np.stack(
        [
            kernel_of((0.2 * (i + 1), 1.0, 5.0, 50.0, "absorbing"), pitch, 0.9, reach)[0]
            for i in range(len(mask.channels))
        ]
    )


@given(mask=masks, row=st.integers(0, 6), column=st.integers(0, 6), seed=seeds)
@settings(deadline=None, max_examples=30)
def test_charge_made_inside_is_conserved_and_found_where_the_kernels_say(mask, row, column, seed):
    kernels = kernels_for(mask)
    r = kernels.shape[1] // 2
    mosaic = np.zeros((4 * r, 4 * r + 1))
    y, x = np.random.default_rng(seed).integers(2 * r - 3, 2 * r + 3, 2)
    mosaic[y, x] = 7.0
    spread = crosstalk.diffuse(mosaic, kernels, mask, row, column)
    assert_allclose(spread.sum(), 7.0, rtol=1e-13)
    own = kernels[cfa.channel_index(mask, *mosaic.shape, row, column)[y, x]]
    expected = np.zeros_like(mosaic)
    expected[y - r : y + r + 1, x - r : x + r + 1] = 7.0 * own
    assert_allclose(spread, expected, atol=7e-15)


def test_light_through_red_filters_only_is_found_in_green_and_blue_neighbours_as_the_kernel_says():
    mask = cfa.parse("RGGB")
    kernels = kernels_for(mask)
    r = kernels.shape[1] // 2
    size = 6 * r
    mosaic = np.zeros((size, size))
    mosaic[2 * r : 4 * r : 2, 2 * r : 4 * r : 2] = np.random.default_rng(3).uniform(
        1.0, 2.0, (r, r)
    )  # red pixels, away from the border
    spread = crosstalk.diffuse(mosaic, kernels, mask)
    assert_allclose(spread.sum(), mosaic.sum(), rtol=1e-12)
    down, right = np.mgrid[-r : r + 1, -r : r + 1]
    index = cfa.channel_index(mask, size, size)
    for channel, places in (
        (0, (down % 2 == 0) & (right % 2 == 0)),
        (1, (down + right) % 2 == 1),
        (2, (down % 2 == 1) & (right % 2 == 1)),
    ):
        assert_allclose(spread[index == channel].sum(), mosaic.sum() * kernels[0][places].sum(), rtol=1e-12)


@given(
    mask=masks, shape=st.tuples(st.integers(6, 30), st.integers(6, 30)), row=st.integers(0, 6), column=st.integers(0, 6)
)
@settings(deadline=None, max_examples=40)
def test_uniform_light_of_each_colour_comes_out_the_same_up_to_the_border(mask, shape, row, column):
    kernels = kernels_for(mask)
    index = cfa.channel_index(mask, *shape, row, column)
    levels = np.linspace(1.0, 2.0, len(mask.channels))
    spread = crosstalk.diffuse(levels[index], kernels, mask, row, column)
    mixed = crosstalk.mixing(kernels, mask)
    height, width = mask.period
    whole = spread[: shape[0] // height * height, : shape[1] // width * width]
    for channel in range(len(mask.channels)):
        found = whole[index[: whole.shape[0], : whole.shape[1]] == channel]
        assert_allclose(found.mean(), mixed[channel] @ levels, rtol=1e-13)
    if shape[0] % height == 0 == shape[1] % width:  # whole periods: nothing is gained or lost at the border either
        assert_allclose(spread.sum(), levels[index].sum(), rtol=1e-13)


@given(mask=masks)
@settings(deadline=None)
def test_mixing_keeps_the_charge_of_every_channel(mask):
    mixed = crosstalk.mixing(kernels_for(mask), mask)
    counts = np.array([len(mask.sites(c)) for c in mask.channels])
    assert_allclose(counts @ mixed, counts, rtol=1e-13)
    assert mixed.min() >= 0.0


@given(mask=masks, row=st.integers(0, 6), seed=seeds)
@settings(deadline=None, max_examples=30)
def test_a_window_sees_what_the_whole_sensor_sees_inside_its_border(mask, row, seed):
    kernels = kernels_for(mask, reach=5)
    mosaic = np.random.default_rng(seed).uniform(0.0, 1.0, (40, 41))
    whole = crosstalk.diffuse(mosaic, kernels, mask)
    part = crosstalk.diffuse(mosaic[row:, 3:], kernels, mask, row, 3)
    assert_allclose(part[5:-5, 5:-5], whole[row + 5 : -5, 8:-5], atol=1e-14)


def test_behind_one_filter_the_kernel_tends_to_diffusion_of_the_light_as_pixels_shrink():
    """A kernel knows of a pixel only how much light it had: it blurs by two windows more, which vanish with the
    pitch squared.
    """
    f = np.array([0.02, 0.05, 0.1])
    exact = photodiode.collection_mtf(f, *PAPER)
    errors = []
    for pitch in (1.0, 0.5, 0.25):
        kernel, _ = kernel_of(PAPER, pitch, reach=round(50 / pitch))
        n = np.arange(kernel.shape[0]) - kernel.shape[0] // 2
        errors.append(np.abs(kernel.sum(axis=0) @ np.cos(2 * np.pi * pitch * np.outer(n, f)) - exact).max())
    assert errors[0] < 0.01
    assert errors[1] < 0.4 * errors[0] and errors[2] < 0.4 * errors[1]


def test_float32_is_kept_and_close():
    mask = cfa.parse("X-Trans")
    mosaic = np.random.default_rng(5).uniform(0.0, 1.0, (60, 70)).astype(np.float32)
    spread = crosstalk.diffuse(mosaic, kernels_for(mask), mask)
    assert spread.dtype == np.float32
    assert_allclose(
        spread, crosstalk.diffuse(mosaic.astype(float), kernels_for(mask), mask), atol=1e-6
    )  # of the transforms


@settings(max_examples=20)
@given(masks, st.floats(-0.1, 0.1), seeds)
def test_transfer_functions_between_channels_are_the_transformed_kernels(mask, offset, seed):
    """At any frequency, beyond 1 cycle/pixel too, and of masks of any period; at 0 they are what even light becomes."""
    random, count = np.random.default_rng(seed), len(mask.channels)
    t = crosstalk.times(2.0, 50.0)
    parts = random.dirichlet(np.ones(t.size + 1), count)
    along = [crosstalk.pixel_shares(t, 1.2, 1.5, 40, shift) for shift in (offset, -0.5 * offset)]
    kernel = crosstalk.kernels(parts[:, 0], parts[:, 1:], *along)[0]
    fy, fx = random.uniform(-2, 2, 3), random.uniform(-2, 2, 2)
    found = crosstalk_planes.channel_transfer(parts[:, 0], parts[:, 1:], *along, mask, fy, fx)
    between = crosstalk_planes.plane_kernels(kernel, mask)
    away = np.arange(between.shape[-1]) - between.shape[-1] // 2
    waves = [np.exp(-2j * np.pi * np.outer(away, f)) for f in (fy, fx)]
    assert_allclose(found, np.einsum("csij,im,jn->csmn", between, *waves, optimize=True), rtol=0, atol=1e-12)
    still = crosstalk_planes.channel_transfer(parts[:, 0], parts[:, 1:], *along, mask, np.zeros(1), np.zeros(1))[
        ..., 0, 0
    ]
    assert_allclose(still, crosstalk.mixing(kernel, mask), rtol=0, atol=1e-12)
