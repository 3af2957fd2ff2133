"""S-CIELAB: what is left of a colour difference at a distance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from etendue_camera.colour import difference
from etendue_camera.quality import scielab

WHITE = np.array([0.95047, 1.0, 1.08883])
PLAIN = {"76": lambda one, other: np.sqrt(((one - other) ** 2).sum(axis=0)), "2000": difference.delta_e_2000}
reflectances = st.tuples(*[st.floats(0.02, 1.0)] * 3).map(lambda v: np.array(v) * WHITE)


def _noise(seed, shape=(24, 20), size=0.1):
    rng = np.random.default_rng(seed)
    reference = np.full((3, *shape), 0.3) * WHITE[:, None, None]
    return reference + size * rng.standard_normal((3, *shape)) * WHITE[:, None, None], reference


@given(one=reflectances, other=reflectances, samples=st.floats(1, 500), formula=st.sampled_from(["76", "2000"]))
@settings(deadline=None)
def test_uniform_patches_have_the_plain_difference(one, other, samples, formula):
    patches = [np.broadcast_to(colour[:, None, None], (3, 7, 6)) for colour in (one, other)]
    expected = PLAIN[formula](difference.lab(one, WHITE), difference.lab(other, WHITE))
    # roundings of two matrices of condition 6 in front of the cube roots, whose slope is 24 at 0.02: x 500
    assert_allclose(scielab.scielab(*patches, WHITE, samples, formula), expected, atol=1e-9)


@given(seed=st.integers(0, 2**32 - 1), samples=st.floats(5, 200))
@settings(deadline=None, max_examples=25)
def test_the_difference_is_the_same_both_ways_and_none_between_equals(seed, samples):
    picture, reference = _noise(seed)
    there, back = (
        scielab.scielab(picture, reference, WHITE, samples),
        scielab.scielab(reference, picture, WHITE, samples),
    )
    assert_allclose(there, back, rtol=1e-9, atol=1e-9)
    assert not scielab.scielab(picture, picture, WHITE, samples).any()


def test_an_infinitely_fine_pattern_tends_to_its_mean():
    x = np.arange(32) + 0.5
    lines = 0.45 + 0.35 * np.cos(np.pi * 31 / 32 * x)  # the finest lines that go on as their own mirror image
    board = np.broadcast_to(lines, (32, 32)) * (WHITE * [1.0, 0.9, 0.7])[:, None, None]
    mean = np.broadcast_to(board.mean(axis=(1, 2), keepdims=True), board.shape)
    left = [scielab.scielab(board, mean, WHITE, samples).max() for samples in (20, 40, 60, 80)]
    assert left[0] > 10
    assert left == sorted(left, reverse=True)
    # at 80 the narrowest Gaussian is 2.3 samples wide: exp(-11.9) at this frequency, times 24 units of L* per unit of
    # the cube root
    assert left[-1] < 1e-3
    assert scielab.scielab(board, mean, WHITE, np.inf).max() < 1e-9


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=10)
def test_a_larger_distance_never_shows_more_of_a_noise(seed):
    picture, reference = _noise(seed, size=0.03)
    seen = [scielab.scielab(picture, reference, WHITE, samples, "76").mean() for samples in (10, 20, 40, 80, 160, 320)]
    assert np.all(np.diff(seen) < 0)


def _opponent(xyz):
    return np.einsum("ij,jyx->iyx", scielab.XYZ_TO_OPPONENT, xyz)


@pytest.mark.parametrize("plane", [1, 2])
def test_a_bright_point_is_seen_as_the_sum_of_gaussians(plane):
    # far from the border: five spreads of the broad Gaussian, exp(-25); the narrow one is 2.3 samples wide
    samples, n = 60.0, 301
    point = np.zeros((3, n, n))
    point[plane, n // 2, n // 2] = 1
    seen = _opponent(scielab.seen(np.einsum("ij,jyx->iyx", np.linalg.inv(scielab.XYZ_TO_OPPONENT), point), samples))
    r2 = np.add.outer((np.arange(n) - n // 2) ** 2, (np.arange(n) - n // 2) ** 2)
    terms = scielab.FILTERS["published"][plane]
    total = sum(w for w, _ in terms)
    expected = sum(w / total / (np.pi * (s * samples) ** 2) * np.exp(-r2 / (s * samples) ** 2) for w, s in terms)
    # what the narrow one holds beyond the Nyquist frequency of the samples: exp(-(1.5708 x 2.35)^2) of a peak of 0.04
    assert_allclose(seen[plane], expected, atol=1e-6 * expected.max())
    assert np.abs(seen[np.arange(3) != plane]).max() < 1e-15  # the planes do not mix


@given(ky=st.integers(0, 11), kx=st.integers(0, 15), samples=st.floats(1, 300))
@settings(deadline=None, max_examples=30)
def test_a_wave_of_lightness_keeps_its_shape_and_loses_its_share(ky, kx, samples):
    y, x = np.mgrid[:12, :16] + 0.5
    wave = np.cos(np.pi * ky / 12 * y) * np.cos(np.pi * kx / 16 * x)
    xyz = np.linalg.inv(scielab.XYZ_TO_OPPONENT)[:, 0][:, None, None] * wave
    f2 = (ky / 24) ** 2 + (kx / 32) ** 2
    terms = ((0.921, 0.0283), (0.105, 0.133), (-0.108, 4.336))
    share = sum(w * np.exp(-((np.pi * s * samples) ** 2) * f2) for w, s in terms) / 0.918
    assert_allclose(scielab.seen(xyz, samples), share * xyz, atol=1e-14)


def test_weights_and_spreads_are_those_in_print():
    # Zhang and Wandell 1996, table 1; the weights of their program are these scaled to sum 1
    for published, program in zip(scielab.FILTERS["published"], scielab.FILTERS["half_width"], strict=True):
        total = sum(w for w, _ in published)
        assert_allclose([w / total for w, _ in published], [w for w, _ in program], rtol=2e-3)  # printed with 3 digits
        ratios = [wide / narrow for (_, wide), (_, narrow) in zip(program, published, strict=True)]
        assert_allclose(ratios, 2, rtol=0.07)  # read as half widths, they are twice too wide
    assert_allclose(
        scielab.XYZ_TO_OPPONENT, [[0.279, 0.72, -0.107], [-0.449, 0.29, 0.077], [0.086, -0.59, 0.501]], atol=2e-3
    )


def test_the_wide_reading_hides_more():
    picture, reference = _noise(1)
    narrow, wide = (
        scielab.scielab(picture, reference, WHITE, 40, "2000", name).mean() for name in ("published", "half_width")
    )
    assert wide < 0.7 * narrow


def test_single_precision_stays_and_is_near_double():
    picture, _ = _noise(2)
    single = scielab.seen(picture.astype(np.float32), 30)
    assert single.dtype == np.float32
    assert_allclose(single, scielab.seen(picture, 30), atol=3e-7)


def test_a_display_at_arms_length_has_some_thirty_samples_per_degree():
    # 100 dpi at 50 cm: one degree is 8.73 mm, an inch 25.4 mm
    assert_allclose(scielab.samples_per_degree(100 / 25.4, 500), 34.36, atol=0.005)


def test_odd_and_tiny_pictures_are_seen():
    for shape in ((1, 1), (1, 7), (2, 2), (5, 3)):
        xyz = np.random.default_rng(0).uniform(0, 1, (3, *shape))
        seen = scielab.seen(xyz, 20)
        assert_allclose(seen.mean(axis=(1, 2)), xyz.mean(axis=(1, 2)), rtol=1e-13)  # blur keeps the mean


def test_nonsense_is_refused():
    a = np.zeros((3, 4, 4))
    for samples in (0, -1, np.nan):
        with pytest.raises(ValueError, match="samples is"):
            scielab.seen(a, samples)
    with pytest.raises(ValueError, match="allowed: \\(3, y, x\\)"):
        scielab.seen(a[0], 30)
    with pytest.raises(ValueError, match="allowed: equal shapes"):
        scielab.scielab(a, a[:, :2], WHITE, 30)
    with pytest.raises(ValueError, match="formula is '94'"):
        scielab.scielab(a, a, WHITE, 30, "94")
    with pytest.raises(ValueError, match="filters is 'x'"):
        scielab.scielab(a, a, WHITE, 30, filters="x")
    with pytest.raises(ValueError, match="distance is 0"):
        scielab.samples_per_degree(4, 0)
