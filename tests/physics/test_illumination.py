"""Laws of light over the field: overlapping pupils, oblique chief rays, tables."""

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis.strategies import floats
from numpy.testing import assert_allclose

from etendue_camera.field.illumination import chief_ray_angle, cosine_response, overlap_of_discs, table_at, vignetting

radii = floats(-3.0, 4.0)  # decades


@cache
def chords():
    """Nodes on [0, 1], and twice their weights."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    return 0.5 * (nodes + 1), weights


def test_equal_discs_overlap_as_the_transfer_function_of_a_circle():
    v = np.linspace(0.0, 1.0, 101)
    expected = 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v * v))
    assert_allclose(overlap_of_discs(1.0, 1.0, 2 * v), expected, atol=1e-15)  # the naive form cancels near 1


@given(decade=radii, u=floats(0.0, 1.0))
def test_the_overlap_is_the_integral_over_chords(decade, u):
    rim = 10.0**decade
    shift = abs(rim - 1) + u * 2 * min(1.0, rim)
    # chords across the line of centres, Gauss-Legendre in the angle of the smaller circle: a square-root edge stays
    # inside it
    small = min(1.0, rim)
    large = max(1.0, rim)
    crossing = (shift * shift + small**2 - large**2) / (2 * shift) if shift > 0 else -small
    crossing = min(max(crossing, -small), small)
    # of the small disc: beyond the crossing all of it lies inside the large one, on the far side the large circle cuts
    angle = math.acos(crossing / small)
    beyond = small**2 * (angle - math.sin(2 * angle) / 2)
    middle = max(shift - large, -small)
    t, weights = chords()
    x = middle + (crossing - middle) * t**2  # the large circle's chord begins like a square root
    inside = np.sqrt(np.maximum(large**2 - (x - shift) ** 2, 0.0))
    cut = 2 * np.sum(weights * inside * t * (crossing - middle)) if large + small > shift and middle < crossing else 0.0
    # chords of a circle 1e4 times larger lose 4 digits of their length in the square root
    assert_allclose(overlap_of_discs(1.0, rim, shift), (beyond + cut) / np.pi, atol=1e-10, rtol=1e-8)


@given(decade=radii, one=floats(0.0, 3.0), other=floats(0.0, 3.0))
def test_the_overlap_falls_from_one_to_zero_as_the_discs_part(decade, one, other):
    rim = 10.0**decade
    near, far = sorted((one * (1 + rim), other * (1 + rim)))
    share = overlap_of_discs(1.0, rim, np.array([0.0, near, far, 1 + rim, 10 * (1 + rim)]))
    # the larger circle's rounding, over the area of the smaller
    assert np.all(np.diff(share) <= 4e-15 * (1 + min(rim, 1) ** 2))
    assert share[0] == min(1.0, rim * rim) or math.isclose(share[0], min(1.0, rim * rim), rel_tol=1e-15)
    assert share[3] <= 1e-15 and share[4] == 0.0
    assert np.all((share >= 0) & (share <= 1))


@given(a=floats(0.01, 100.0), b=floats(0.01, 100.0), s=floats(0.0, 200.0))
def test_either_disc_may_be_called_the_rim(a, b, s):
    # the same area, as a share of either
    assert_allclose(overlap_of_discs(a, b, s) * a * a, overlap_of_discs(b, a, s) * b * b, rtol=1e-13, atol=1e-300)


def test_overlap_keeps_its_digits_where_the_discs_nearly_part():
    # lens of two equal circles: (4/3) sqrt(a) e^1.5 (1 - 3 e/40 ...) for a gap e of the centres below 2 a
    for gap in (1e-4, 1e-8, 1e-12):
        shift = 2.0 - gap
        e = 2.0 - shift
        # two segments of half angle t with 1 - cos t = e/2: area 2 (t - sin t cos t) = (4/3) t^3 (1 - t^2/5)
        t2 = e * (1 + e / 12)
        assert_allclose(
            overlap_of_discs(1.0, 1.0, shift),
            4 / 3 * t2**1.5 * (1 - t2 / 5) / np.pi,
            rtol=1e-7 if gap > 1e-5 else 1e-12,
        )


def test_a_shift_far_below_the_radii_takes_what_the_first_order_says():
    for shift in (1e-300, 8e-16, 1e-12, 1e-8):
        # two equal circles apart by s share all but 2 s/(pi a) of either
        assert_allclose(1.0 - overlap_of_discs(1.0, 1.0, shift), 2 * shift / np.pi, atol=5e-16)


def test_single_precision_stays_and_holds():
    shift = np.linspace(0.0, 3.0, 301, dtype=np.float32)
    share = overlap_of_discs(1.0, 1.4, shift)
    assert share.dtype == np.float32
    # the shift is rounded to float32 by itself; the slope of the share is below 0.7
    assert_allclose(share, overlap_of_discs(1.0, 1.4, shift.astype(float)), atol=5e-7)


def test_a_rim_at_the_pupil_or_far_too_wide_cuts_nothing():
    t = np.tan(np.radians(np.linspace(0.0, 80.0, 81)))
    assert np.all(vignetting(t, 2.0, 2.0, 0.0) == 1.0)
    assert np.all(vignetting(t, 2.0, 2.0 + 7.0 * t[-1], 7.0) == 1.0)
    assert np.all(vignetting(t, 2.0, np.inf, 7.0) == 1.0)


@given(number=floats(0.5, 64.0), distance=floats(0.1, 50.0), angle=floats(0.0, 80.0), excess=floats(0.0, 5.0))
def test_stopping_down_lets_the_pupil_out_of_the_shadow_of_the_rim(number, distance, angle, excess):
    t = math.tan(math.radians(angle))
    pupil = 10.0 / number
    rim = 20.0 + excess
    open_, stopped = vignetting(t, pupil, rim, distance), vignetting(t, pupil / 4, rim, distance)
    if distance * t < rim:  # the pupil's centre sees out of the rim, and what it sees is convex
        assert stopped >= open_ - 1e-14
    assert 0.0 <= open_ <= 1.0
    onset = (rim - pupil) / distance
    if t <= onset * (1 - 1e-12):
        assert open_ == 1.0
    if t >= (rim + pupil) / distance * (1 + 1e-12):
        assert open_ == 0.0


def test_a_near_object_sees_a_wider_shadow_and_a_far_one_that_of_infinity():
    t = np.tan(np.radians(np.linspace(0.0, 40.0, 9)))
    assert_allclose(vignetting(t, 2.0, 2.5, 3.0, 1e12), vignetting(t, 2.0, 2.5, 3.0), atol=1e-10)
    # by hand: object at 6 mm, rim half way, so twice the rim, displaced by twice 3 mm tan
    assert_allclose(vignetting(t, 2.0, 2.5, 3.0, 6.0), overlap_of_discs(2.0, 5.0, 6.0 * t), rtol=1e-14)


def test_a_rim_that_would_be_the_stop_is_refused():
    with pytest.raises(ValueError, match="aperture stop"):
        vignetting(0.1, 2.0, 1.9, 3.0)
    with pytest.raises(ValueError, match="beyond the rim"):
        vignetting(0.1, 2.0, 5.0, 3.0, 2.0)
    for bad in ((0.0, 1.0), (1.0, 0.0), (np.nan, 1.0)):
        with pytest.raises(ValueError, match="must be above 0"):
            overlap_of_discs(*bad, 0.1)


def test_the_chief_ray_of_a_telecentric_lens_is_perpendicular_everywhere():
    height = np.linspace(0.0, 20.0, 5)
    assert np.all(chief_ray_angle(height, np.inf) == 0.0)
    assert_allclose(chief_ray_angle(10.0, 10.0), 45.0, rtol=1e-15)
    assert_allclose(chief_ray_angle(10.0, -10.0), -45.0, rtol=1e-15)
    with pytest.raises(ValueError, match="must not be 0"):
        chief_ray_angle(1.0, 0.0)


def test_the_response_by_angle_is_even_one_on_the_axis_and_dark_from_the_side():
    angle = np.linspace(-120.0, 120.0, 241)
    for power in (0.5, 1.0, 3.0):
        response = cosine_response(angle, power)
        assert_allclose(response, response[::-1], atol=1e-15)
        assert response[120] == 1.0
        assert np.all(response[np.abs(angle) >= 90] < 1e-7)  # cos(90 deg) is 6e-17 in doubles; its root 8e-9
        assert np.all(np.diff(response[120:]) <= 0)
    assert np.all(cosine_response(angle, 0.0) == 1.0)
    assert_allclose(cosine_response(60.0, 2.0), 0.25, rtol=1e-14)


def test_a_table_is_exact_at_its_rows_straight_between_them_and_holds_beyond():
    nodes, values = np.array([0.0, 1.0, 4.0]), np.array([1.0, 0.7, 0.1])
    assert np.array_equal(table_at(nodes, nodes, values), values)
    assert_allclose(table_at(2.5, nodes, values), 0.4, rtol=1e-15)
    assert table_at(9.0, nodes, values) == 0.1
    assert table_at(np.float32([0.5]), nodes, values).dtype == np.float32
