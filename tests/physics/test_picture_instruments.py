"""The kernels behind ``etendue measure`` alone: how an edge stands, stars with intervals, noise of a patch, patches
of a chart.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.ndimage import uniform_filter
from scipy.special import ive, ndtr

from etendue_camera.quality.chart_patches import chart_patches, homography, turning
from etendue_camera.quality.patch_noise import patch_noise
from etendue_camera.resolution.edges.edge_shape import edge_shape
from etendue_camera.resolution.star_interval import Bootstrap, count_cycles, star_resolution

FIFTY = math.sqrt(math.log(2) / 2) / math.pi  # MTF50 of a Gaussian of 1 pixel rms


def slanted(angle, bend=0.0, shape=(120, 100)):
    """An edge of 1 pixel rms; ``bend`` pixels from its line in the middle, across the rows, to either side of it."""
    y, x = (np.arange(n) - 0.5 * (n - 1) for n in shape)
    y = y[:, None]
    turn = math.radians(angle)
    return 0.1 + 0.6 * ndtr(x * math.cos(turn) - y * math.sin(turn) - bend * (2 * (y / y.max()) ** 2 - 1))


def star(cycles, sigma=1.0, shape=(220, 224), centre=(110.3, 111.8)):
    """An endless sinusoidal star through a Gaussian: a pair of Bessel functions, exact."""
    y, x = np.arange(shape[0])[:, None] - centre[0], np.arange(shape[1]) - centre[1]
    z = (y**2 + x**2) / (4 * sigma**2)
    held = np.sqrt(np.pi * z / 2) * (ive((cycles - 1) / 2, z) + ive((cycles + 1) / 2, z))
    return 0.4 * (1 + 0.8 * held * np.cos(cycles * np.arctan2(y, x)))


@pytest.mark.parametrize("angle", [0.0, 0.3, 5.0, -20.0, 30.0, 85.0, 90.0])
@pytest.mark.parametrize("bend", [0.0, 2.0])
def test_how_an_edge_stands_is_seen_at_every_angle(angle, bend):
    noise = np.random.default_rng(0).normal(0, 0.006, (120, 100))
    found = edge_shape((slanted(angle, bend) if abs(angle) < 45 else slanted(90 - angle, bend, (100, 120)).T) + noise)
    assert found.vertical == (abs(angle) < 45)
    assert_allclose(found.angle, angle if abs(angle) < 45 else 90 - angle, atol=0.1)
    assert_allclose(found.bend, bend * 4 / 3, atol=0.2)  # 2 v^2 - 1 is 4/3 from its mean at the ends


@pytest.mark.parametrize("cycles", [8, 36, 72, 100])
def test_cycles_of_a_star_are_counted(cycles):
    noisy = star(cycles) + np.random.default_rng(1).normal(0, 0.02, (220, 224))
    assert count_cycles(noisy, (110.0, 112.0), 105.0) == cycles
    assert count_cycles(np.sign(noisy - 0.4), (110.0, 112.0), 105.0) == cycles  # of black and white sectors too


def test_noise_alone_is_no_star():
    with pytest.raises(ValueError, match="no dominant number of cycles"):
        count_cycles(np.random.default_rng(2).normal(0.5, 0.1, (220, 224)), (110.0, 112.0), 105.0)


@pytest.mark.parametrize("sites", ["all", "quincunx", "one in four"])
def test_a_star_has_its_interval_also_on_the_pixels_of_one_colour(sites):
    y, x = np.mgrid[:220, :224]
    mask = {"all": None, "quincunx": (y + x) % 2 == 0, "one in four": (y % 2 == 0) & (x % 2 == 0)}[sites]
    picture = star(72) + np.random.default_rng(3).normal(0, 0.01, (220, 224))
    if mask is not None:
        picture = np.where(mask, picture, -5.0)  # what the others hold says nothing
    found = star_resolution(picture, (110.0, 112.0), 105.0, contrast=0.8, sites=mask, bootstrap=Bootstrap(100))
    assert found.cycles == 72
    # a ring mixes frequencies by 1/(6 cycles^2): 1e-4 of MTF50 here
    assert found.mtf50_low * (1 - 1e-3) <= FIFTY <= found.mtf50_high * (1 + 1e-3)
    assert found.mtf50_high - found.mtf50_low < 0.02 * FIFTY


def test_intervals_of_a_star_grow_with_its_noise():
    widths = []
    for noise in (0.005, 0.02):
        one = star_resolution(
            star(72) + np.random.default_rng(4).normal(0, noise, (220, 224)),
            (110.0, 112.0),
            105.0,
            contrast=0.8,
            bootstrap=Bootstrap(150),
        )
        widths.append(one.mtf50_high - one.mtf50_low)
    assert 3 < widths[1] / widths[0] < 5  # four times the noise, drawn from the same numbers


@settings(max_examples=15)
@given(
    seed=st.integers(0, 1000),
    gain=st.floats(0.1, 1e4),
    tilt=st.floats(-0.2, 0.2),
    rows=st.integers(16, 90),
    columns=st.integers(16, 90),
)
def test_noise_of_a_patch_scales_turns_and_knows_no_slope(seed, gain, tilt, rows, columns):
    plane = 1 + np.random.default_rng(seed).normal(0, 0.02, (rows, columns))
    once = patch_noise(plane)
    louder = patch_noise(gain * plane)
    assert_allclose(louder.sigma.value, gain * once.sigma.value, rtol=1e-9)
    assert_allclose(louder.sigma.low, gain * once.sigma.low, rtol=1e-9, atol=1e-9 * gain)
    assert_allclose([louder.snr.value, louder.snr.high], [once.snr.value, once.snr.high], rtol=1e-9)
    assert_allclose(patch_noise(np.rot90(plane, 2)).sigma.value, once.sigma.value, rtol=1e-9)
    sloping = patch_noise(plane + tilt * np.linspace(-0.5, 0.5, columns) + tilt * np.linspace(-0.5, 0.5, rows)[:, None])
    assert_allclose(sloping.sigma.value, once.sigma.value, rtol=1e-9)
    assert_allclose(sloping.mean.value, once.mean.value, rtol=1e-9)


@pytest.mark.parametrize("kind", ["white", "over 3 x 3", "one colour"])
def test_intervals_of_noise_hold_it(kind):
    """Of 60 seeds at 95 %: less than 50 has a probability of 1e-4."""
    y, x = np.mgrid[:64, :64]
    sites = (y + x) % 2 == 0 if kind == "one colour" else None
    sigma, held = 0.01 / (3 if kind == "over 3 x 3" else 1), 0
    for seed in range(60):
        plane = np.random.default_rng(seed).normal(0, 0.01, (66, 66))
        plane = 0.4 + (uniform_filter(plane, 3) if kind == "over 3 x 3" else plane)[1:-1, 1:-1]
        found = patch_noise(plane, sites).sigma
        held += found.low <= sigma <= found.high
    assert held >= 50


def test_a_patch_without_noise_has_none():
    found = patch_noise(np.full((20, 20), 0.1))
    assert found.sigma.value == 0 and found.snr.value == math.inf and found.mean.value == 0.1


def test_structure_of_a_patch_is_told_from_its_noise():
    fine = np.random.default_rng(5).normal(0, 0.01, (64, 64))
    even, wavy = patch_noise(0.5 + fine), patch_noise(0.5 + fine + 0.05 * np.sin(np.arange(64) / 8))
    assert even.uneven < 2 * even.uneven_white
    assert_allclose(
        wavy.uneven, 0.05 / math.sqrt(2) / 0.5, rtol=0.25
    )  # the plane takes some of two periods, blocks smooth the rest


CORNERS = st.tuples(*[st.floats(-15.0, 15.0)] * 8)


@settings(max_examples=12)
@given(moved=CORNERS)
def test_a_chart_is_read_in_perspective(moved):
    """Patches are drawn through a homography of their own and found through their four corners."""
    corners = np.array([(30, 25), (230, 25), (230, 165), (30, 165)]) + np.reshape(moved, (4, 2))
    back = np.linalg.inv(homography(corners))
    y, x = np.mgrid[:190, :260]
    w = back[2, 0] * x + back[2, 1] * y + back[2, 2]
    u = (back[0, 0] * x + back[0, 1] * y + back[0, 2]) / w * 5.9
    v = (back[1, 0] * x + back[1, 1] * y + back[1, 2]) / w * 3.9
    number = np.clip(np.floor(v), 0, 3) * 6 + np.clip(np.floor(u), 0, 5)
    levels = np.linspace(0.1, 0.9, 24)[::-1]
    picture = np.stack([levels[number.astype(int)], 0.5 * levels[number.astype(int)]])
    found = chart_patches(picture, corners, 4, 6, np.zeros(y.shape, bool))
    assert_allclose(found.mean, np.stack([levels, 0.5 * levels], 1), rtol=1e-12)
    assert turning(corners) == (4, 0)
    assert turning(corners[::-1]) == (0, 4)
    assert turning(corners[[0, 2, 1, 3]]) == (2, 2)
