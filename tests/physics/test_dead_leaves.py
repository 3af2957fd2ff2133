"""Dead leaves: a chart that belongs to its seed and not to its grid, and the response that is read from its texture."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from etendue_camera.resolution.texture import texture_response
from etendue_camera.scene.dead_leaves import LeafChart, Leaves, dead_leaves, leaves

Y = np.arange(256) - 127.5
FIFTY = np.sqrt(np.log(2) / 2) / np.pi  # MTF50 of a Gaussian of 1 pixel rms
CHART = (320.0, 320.0, 4.0, 60.0, 0.1, 0.9, 3)


def gaussian(sigma):
    return lambda f: np.exp(-2 * (np.pi * f * sigma) ** 2)


# -- the chart --------------------------------------------------------------------------------------------------


def test_one_disc_is_a_disc_and_the_upper_one_hides_the_lower():
    def lone(y, x, radius, level):
        return Leaves(*(np.array(v, float) for v in (y, x, radius, level)), 0.0, 1.0)

    y = np.arange(64) - 31.5
    disc = dead_leaves(y, y, lone([0.0], [0.0], [20.0], [0.9]), 0.0, 1.0, 8)
    distance = np.hypot(y[:, None], y)
    assert_allclose(disc[distance < 18.5], 0.9, atol=1e-6)
    assert_allclose(disc[distance > 21.5], 0.5, atol=1e-6)  # what no disc covers is grey
    assert_allclose((disc - 0.5).sum() / 0.4, np.pi * 400, rtol=1e-4)  # its area, to what coverage by distance leaves
    two = dead_leaves(y, y, lone([0.0, 0.0], [0.0, 8.0], [10.0, 10.0], [0.2, 0.7]), 0.0, 1.0)
    assert two[32, 32] == pytest.approx(0.2, abs=1e-6)
    assert two[32, 32 + 14] == pytest.approx(0.7, abs=1e-6)


def test_softness_is_a_gaussian_of_the_ideal_chart():
    """Its transform over that of a softer one is the ratio of the two Gaussians, at every frequency that is left."""
    chart = leaves(LeafChart(*CHART))
    sharp, soft = (dead_leaves(Y, Y, chart, softness) for softness in (0.8, 1.5))
    found = texture_response(soft, sharp, known=gaussian(0.8))
    good = found.frequency < 0.3
    assert_allclose(found.sfr[good], gaussian(1.5)(found.frequency[good]), atol=6e-3)  # the window mixes neighbours


def test_means_over_cells_are_means_of_finer_cells():
    chart, half = leaves(LeafChart(*CHART)), np.arange(128) - 63.75
    fine = dead_leaves(half * 0.5, half * 0.5, chart, 0.0, 0.5, 8)
    coarse = dead_leaves((half * 0.5).reshape(-1, 2).mean(1), (half * 0.5).reshape(-1, 2).mean(1), chart, 0.0, 1.0, 8)
    assert_allclose(fine.reshape(64, 2, 64, 2).mean((1, 3)), coarse, atol=5e-3)  # 8-fold painting errs by 4e-3 at most
    assert np.std(fine.reshape(64, 2, 64, 2).mean((1, 3)) - coarse) < 3e-4


def test_finer_painting_comes_nearer_in_the_second_order():
    chart, y = leaves(LeafChart(*CHART)), np.arange(60) - 29.5
    best = dead_leaves(y, y, chart, 1.0, oversampling=32)
    error = [np.std(dead_leaves(y, y, chart, 1.0, oversampling=k) - best) for k in (2, 4, 8)]
    assert error[0] / error[1] > 2.5
    assert error[1] / error[2] > 2.5
    assert error[1] < 4e-4


def test_a_window_shows_the_crop_of_the_whole():
    chart = leaves(LeafChart(*CHART))
    whole = dead_leaves(Y, Y, chart, 1.0)
    assert_allclose(
        dead_leaves(Y[40:90], Y[100:200], chart, 1.0), whole[40:90, 100:200], atol=2e-6
    )  # painted in float32


def test_the_same_seed_draws_the_same_leaves_and_another_others():
    first, again, other = leaves(LeafChart(*CHART)), leaves(LeafChart(*CHART)), leaves(LeafChart(*CHART[:-1], 4))
    assert_array_equal(first.radius, again.radius)
    assert not np.array_equal(first.radius[:100], other.radius[:100])
    one, two = (dead_leaves(Y, Y, chart, 1.0) for chart in (first, other))
    assert abs(np.corrcoef(one.ravel(), two.ravel())[0, 1]) < 0.25  # a few large leaves decide: 0.1 rms


@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0, 4.0])
def test_radii_follow_their_power_law(exponent):
    """The share of discs below r is that of the density r^-exponent."""
    radius = leaves(LeafChart(200.0, 200.0, 1.0, 10.0, 0.0, 1.0, 1, exponent)).radius
    r = np.linspace(1.0, 10.0, 20001)
    expected = np.cumsum(r**-exponent) / (r**-exponent).sum()
    found = np.searchsorted(np.sort(radius), r) / radius.size
    assert np.abs(found - expected).max() < 1.95 / np.sqrt(radius.size) + 1e-3  # Kolmogorov, one in a thousand


def test_the_plane_is_covered_and_stays_between_its_levels():
    chart = leaves(LeafChart(100.0, 100.0, 2.0, 20.0, 0.2, 0.21, 5))
    y = np.arange(100) - 49.5
    value = dead_leaves(y, y, Leaves(*chart[:4], 0.0, 10.0), 0.0, 1.0)  # what is not covered would be 5
    assert np.mean(value > 0.22) < 5e-3  # exp(-9) of it
    inside = dead_leaves(y.astype(np.float32), y.astype(np.float32), chart, 1.0)
    assert inside.dtype == np.float32
    assert inside.min() >= np.float32(0.2)
    assert inside.max() <= np.float32(0.21)


# -- the measure ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0.6, 0.9, 1.5])
def test_the_response_is_read_from_the_texture(sigma):
    chart = leaves(LeafChart(*CHART))
    original = dead_leaves(Y, Y, chart, 0.7)
    picture = 100 * dead_leaves(Y - 0.3, Y + 1.2, chart, sigma)
    for method in ("cross", "power"):
        found = texture_response(picture, original, known=gaussian(0.7), method=method)
        assert_allclose(found.mtf50, FIFTY / sigma, rtol=1e-2)  # 5e-3 measured with 256 x 256 pixels
        assert_allclose(found.gain, 100, rtol=1e-2)  # other leaves at the borders
    cross = texture_response(picture, original, known=gaussian(0.7))
    assert_allclose(cross.shift, (0.3, -1.2), atol=0.01)
    good = cross.frequency < 0.45
    assert_allclose(cross.sfr[good], gaussian(sigma)(cross.frequency[good]), atol=0.02)


def test_the_original_does_not_explain_noise_and_the_power_takes_it_for_contrast():
    chart, rng = leaves(LeafChart(*CHART)), np.random.default_rng(5)
    original, picture = dead_leaves(Y, Y, chart, 0.7), dead_leaves(Y, Y, chart, 0.9)
    noisy = picture + rng.normal(0, 0.03, picture.shape)
    cross = texture_response(noisy, original, known=gaussian(0.7))
    assert_allclose(cross.mtf50, FIFTY / 0.9, rtol=0.02)
    assert cross.coherence[0] > 0.99
    assert cross.coherence[-1] < 0.2
    kept = texture_response(noisy, original, known=gaussian(0.7), method="power")
    taken = texture_response(noisy, original, known=gaussian(0.7), method="power", noise=0.03)
    flat = texture_response(
        noisy, original, known=gaussian(0.7), method="power", noise=0.5 + rng.normal(0, 0.03, (128, 128))
    )
    last = cross.frequency > 0.4
    truth = gaussian(0.9)(cross.frequency[last])
    assert kept.sfr[last].mean() > 1.4 * truth.mean()
    for found in (taken, flat):
        assert abs(found.sfr[last].mean() - truth.mean()) < 0.5 * abs(kept.sfr[last].mean() - truth.mean())


def test_a_picture_of_something_else_is_not_explained():
    original = dead_leaves(Y, Y, leaves(LeafChart(*CHART)), 0.7)
    other = dead_leaves(Y, Y, leaves(LeafChart(*CHART[:-1], 9)), 0.7)
    assert texture_response(other, original, gain=1.0).coherence.mean() < 0.1
    assert_allclose(texture_response(original, original).sfr, 1.0, rtol=1e-9)


# -- refused ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({2: 0.0}, "smallest must be"),
        ({3: 3.0}, "smallest must be below largest"),
        ({4: 0.95}, "low and high"),
        ({6: -1}, "seed must be"),
        ({2: 1e-3}, "discs"),
        ({0: 0.0}, "width must be"),
    ],
)
def test_a_chart_that_cannot_be_drawn_is_refused(change, match):
    with pytest.raises(ValueError, match=match):
        leaves(LeafChart(*(change.get(i, value) for i, value in enumerate(CHART))))
    with pytest.raises(ValueError, match="exponent"):
        leaves(LeafChart(*CHART, 20.0))


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"method": "phase"}, "method is 'phase'"),
        ({"gain": 0.0}, "gain is 0"),
        ({"rings": 3}, "rings is 3"),
        ({"noise": -1.0}, "noise is -1"),
        ({"noise": np.ones((3, 3))}, "noise has shape"),
        ({"original": np.ones((64, 64))}, "original has shape"),
        ({"picture": np.ones((8, 8))}, "picture has shape"),
    ],
)
def test_a_measurement_that_makes_no_sense_is_refused(arguments, match):
    given = {"picture": np.ones((128, 128)), "original": np.ones((128, 128))} | arguments
    with pytest.raises(ValueError, match=match):
        texture_response(given.pop("picture"), given.pop("original"), **given)


def test_oversampling_out_of_range_is_refused():
    with pytest.raises(ValueError, match="oversampling must be"):
        dead_leaves(Y, Y, leaves(LeafChart(*CHART)), 1.0, oversampling=0)
