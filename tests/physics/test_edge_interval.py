"""What noise leaves uncertain in the resolution of an edge, and the edge that is looked for."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.ndimage import uniform_filter
from scipy.special import ndtr

from etendue_camera.resolution.edges.edge_interval import edge_resolution
from etendue_camera.resolution.edges.edge_region import find_edge
from etendue_camera.resolution.edges.slanted_edge import slanted_edge

SIGMA = 0.6
TRUE = np.sqrt(np.log(2) / 2) / (np.pi * SIGMA)


def picture(angle=5.0, shape=(120, 160), sigma=SIGMA):
    """An edge of 0.2 to 0.8 through a Gaussian."""
    turn = np.radians(angle)
    y, x = np.mgrid[: shape[0], : shape[1]]
    distance = (x - 0.5 * shape[1] + 0.2) * np.cos(turn) + (y - 0.5 * shape[0] + 0.7) * np.sin(turn)
    return 0.2 + 0.6 * ndtr(distance / sigma)


def noise(seed, snr, shape=(120, 160)):
    return np.random.default_rng(seed).normal(0, 0.6 / snr, shape)


@pytest.mark.parametrize(
    ("angle", "snr"), [(5, 10), *(pytest.param(*at, marks=pytest.mark.long) for at in ((2, 100), (40, 30)))]
)
def test_the_truth_lies_in_the_interval_as_often_as_it_says(angle, snr):
    """Of 50 pictures with an interval of 95 %, 42 to 50: a binomial leaves that once in 100 times where 92 % hold.

    ``benchmarks/resolution.py`` counts 200 seeds of each against 90 to 98 %.
    """
    clean = picture(angle)
    found = [edge_resolution(clean + noise([seed, angle], snr), rng=seed, draws=200) for seed in range(50)]
    inside = [one.mtf50_low <= TRUE <= one.mtf50_high for one in found]
    assert 42 <= sum(inside) <= 50
    error = np.array([one.mtf50 for one in found]) / TRUE - 1
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(50) + 0.01  # a bias of 1 % at a step of 10 times the noise
    assert_allclose([one.snr for one in found], snr, rtol=0.06)  # 19,200 pixels less the spline's


def test_the_width_of_the_interval_follows_the_noise():
    clean = picture()
    widths = [
        np.mean([_width(edge_resolution(clean + noise(s, snr), draws=200)) for s in range(6)]) for snr in (20, 40, 80)
    ]
    assert_allclose(widths[0] / widths[1], 2, rtol=0.25)  # six draws of each
    assert_allclose(widths[1] / widths[2], 2, rtol=0.25)


def _width(found):
    return found.mtf50_high - found.mtf50_low


def test_intervals_of_two_confidences_are_as_wide_as_those_of_a_normal():
    """What lies outside is shared by both ends: 95 % are 1.96 standard deviations to either side, 68 % are one."""
    image = picture() + noise(1, 50)
    wide, narrow = (edge_resolution(image, confidence=share, draws=2000) for share in (0.95, 0.6827))
    assert 1.8 < (wide.mtf50_high - wide.mtf50_low) / (narrow.mtf50_high - narrow.mtf50_low) < 2.15


@pytest.mark.long
def test_noise_that_hangs_together_over_rows_is_seen_and_allowed_for():
    """Means of 3 x 3: a third of the interval would be missing if rows were taken for independent."""
    clean = picture()
    found = []
    for seed in range(30):
        smooth = uniform_filter(noise(seed, 20, (126, 166)), 3)[3:-3, 3:-3]
        found.append(edge_resolution(clean + smooth, rng=seed, draws=200))
    assert np.mean([one.block > 1 for one in found]) > 0.8
    assert sum(one.mtf50_low <= TRUE <= one.mtf50_high for one in found) >= 24  # where 90 % hold, 97 times of 100
    single = np.mean([edge_resolution(clean + noise(seed, 20), draws=50).block == 1 for seed in range(20)])
    assert single > 0.8


def test_the_same_seed_gives_the_same_interval_and_another_nearly_the_same():
    image = picture() + noise(3, 30)
    first, again = edge_resolution(image, rng=7), edge_resolution(image, rng=7)
    assert (first.mtf50_low, first.mtf50_high) == (again.mtf50_low, again.mtf50_high)
    other = edge_resolution(image, rng=np.random.default_rng(8))
    assert other.mtf50 == first.mtf50
    assert other.mtf50_low != first.mtf50_low
    assert_allclose(_width(other), _width(first), rtol=0.3)  # 400 draws know a percentile to a tenth


def test_without_noise_the_interval_closes_about_the_answer():
    found = edge_resolution(picture())
    assert found.mtf50_low <= found.mtf50 <= found.mtf50_high
    assert _width(found) < 1e-3 * found.mtf50  # what the spline leaves
    assert found.flags == ()
    assert found.mtf50 == slanted_edge(picture()).mtf50
    assert_allclose(found.mtf10, np.sqrt(np.log(10) / 2) / (np.pi * SIGMA), rtol=1e-4)
    assert_allclose(found.mtf_nyquist, np.exp(-2 * (np.pi * 0.5 * SIGMA) ** 2), rtol=1e-3)


def test_flags_say_what_is_wrong_with_the_answer():
    image = picture() + noise(1, 8)
    assert "noisy" in edge_resolution(image).flags
    assert edge_resolution(picture() + noise(1, 200)).flags == ()
    sharp = edge_resolution(picture(sigma=0.3))
    assert sharp.flags == ("above_nyquist",)
    assert sharp.mtf50_limited == 0.5
    assert edge_resolution(picture(sigma=0.3), highest=0.5).flags == ("not_reached", "noisy")
    bright = np.minimum(picture() + noise(1, 50), 0.8)
    assert "clipped" in edge_resolution(bright, limits=(0.0, 0.8)).flags
    assert "clipped" not in edge_resolution(bright, limits=(0.0, 1.0)).flags
    assert "clipped" not in edge_resolution(bright).flags


@pytest.mark.parametrize("angle", [2, 5, 10, 40])
def test_one_colour_of_a_mosaic_is_enough(angle):
    """Every fourth pixel gives what all give; the others are not looked at."""
    clean = picture(angle, (200, 240))
    sites = np.zeros(clean.shape, bool)
    sites[1::2, ::2] = True
    found = edge_resolution(np.where(sites, clean, np.nan), sites=sites)
    assert_allclose(found.mtf50, TRUE, rtol=1e-4)


def test_a_window_is_measured_alone():
    image = picture(shape=(200, 240))
    image[:40] = 0.5
    found = edge_resolution(image, window=(50, 200, 20, 220))
    assert_allclose(found.mtf50, TRUE, rtol=1e-4)
    assert found.window == (50, 200, 20, 220)


def scenery(angle):
    """A turned square beside an upright bar."""
    y, x = np.mgrid[:260, :360]
    turn = np.radians(angle)
    u, v = (x - 150.3) * np.cos(turn) + (y - 130) * np.sin(turn), (y - 130) * np.cos(turn) - (x - 150.3) * np.sin(turn)
    sides = [ndtr((part + 65) / SIGMA) - ndtr((part - 65) / SIGMA) for part in (u, v)]
    return 0.2 + 0.5 * sides[0] * sides[1] + 0.3 * ((x > 300) & (x < 330))


@pytest.mark.parametrize("angle", [5, -12, 30, 40])
def test_the_edge_is_found_among_others_and_measured_alone(angle):
    """One side of the square; the bar is stronger, but stands along the raster."""
    found = edge_resolution(scenery(angle), find=True)
    assert_allclose(found.mtf50, TRUE, rtol=1e-4)
    assert abs(found.angle) == pytest.approx(min(abs(angle), 90 - abs(angle)), abs=1e-3)
    noisy = edge_resolution(scenery(angle) + noise(2, 30, (260, 360)), find=True)
    assert noisy.mtf50 == pytest.approx(TRUE, rel=0.15)


@pytest.mark.parametrize(
    "image", [np.ones((80, 80)), np.kron(np.indices((8, 8)).sum(0) % 2, np.ones((10, 10)))], ids=["even", "board"]
)
def test_where_there_is_no_free_slanted_edge_none_is_found(image):
    with pytest.raises(ValueError, match="no edge that can be measured"):
        find_edge(image)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"draws": 10}, "draws is 10"),
        ({"confidence": 1.0}, r"confidence is 1\.0"),
        ({"window": (0, 200, 0, 50)}, "window is"),
        ({"window": (0, 20, 0, 50)}, "at least 32 x 32"),
        ({"order": 9}, "order is 9"),
        ({"sites": np.ones((3, 3), bool)}, "sites has shape"),
    ],
)
def test_nonsense_is_refused_with_its_name_and_what_is_allowed(arguments, match):
    with pytest.raises(ValueError, match=match):
        edge_resolution(picture(), **arguments)
